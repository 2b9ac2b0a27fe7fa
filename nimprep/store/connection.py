"""Connections to object stores, and requests that fail: made again, or explained in one line.

After a fork nothing here may be used: see `nimprep.store.request_process`.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
import weakref
from collections.abc import Callable
from datetime import timedelta
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, Protocol, TypeVar

from nimprep.errors import StoreError
from nimprep.store.request_process import request_process

if TYPE_CHECKING:
    from obstore.store import ObjectStore


class Connected(Protocol):
    """What makes requests: the URL it names in errors, and its connections once it has some."""

    url: str
    opened: ObjectStore | None


S = TypeVar("S", bound=Connected)
P = ParamSpec("P")
R = TypeVar("R")

RETRIES = 8
"""Times a request is made again after a connection fault, a 5xx answer or a timeout."""

RETRY_S = 180.0
"""After so many seconds a request that fails is not made again."""

REQUEST_S = 60.0
"""How long one request may take, its body included."""

BACKOFF_S = 0.1
"""How long to wait before a request is made again; twice as long each time after."""

AGAIN = 4
"""Times a request is made that obstore does not retry: see `requesting`."""


class RequestError(StoreError):
    """A request was refused, or failed each time it was made again."""


live: weakref.WeakSet[Connected] = weakref.WeakSet()
"""The storages that have connections."""

_kept: list[Any] = []
_forked = False


def _after_fork() -> None:
    global _forked
    if "obstore" in sys.modules:
        _forked = True
        # Closing a connection here would close it for the process that this one came from.
        _kept.extend(storage.opened for storage in live)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


_loading = threading.Lock()


def load_obstore() -> None:
    """Import all of obstore, one thread at a time.

    Its modules import each other: threads that begin at different ones would wait for one another,
    and find it half imported.
    """
    with _loading:
        import obstore.exceptions
        import obstore.store  # noqa: F401


def requesting(
    method: Callable[Concatenate[S, P], R],
) -> Callable[Concatenate[S, P], R]:
    """Let a method run where requests can be made; what goes wrong is a `RequestError`."""

    @wraps(method)
    def run(self: S, /, *arguments: P.args, **named: P.kwargs) -> R:
        if _forked:
            value: R = request_process().call(self, method.__name__, arguments, named)
            return value
        load_obstore()
        from obstore.exceptions import BaseError

        key = f"/{arguments[0]}" if arguments and isinstance(arguments[0], str) else ""
        for attempt in range(1, AGAIN + 1):
            try:
                return method(self, *arguments, **named)
            except (BaseError, OSError) as error:
                if attempt == AGAIN or not _worth_again(str(error)):
                    raise RequestError(f"{self.url}{key}: {_explained(error)}") from error
            time.sleep(BACKOFF_S * 2**attempt)
        raise AssertionError("not reached")

    return run


_DETAILS = "\n\nDebug source"
"""Begins what obstore adds to its errors for its own authors."""


def _worth_again(error: str) -> bool:
    """Return whether a request failed on its way, and obstore did not make it again.

    It does not when the connection breaks within the answer to some kinds of request, nor for puts
    under a condition. Here whoever makes those tells by what was put whether it was done already.
    """
    said = error.partition(_DETAILS)[0]
    return "HTTP error" in said and "max_retries" not in said


def connect(url: str, options: dict[str, Any]) -> ObjectStore:
    """Return what makes requests; nothing is asked for yet.

    Raises
    ------
    StoreError
        The URL or the settings make no sense to obstore.
    """
    from obstore.exceptions import BaseError
    from obstore.store import from_url

    named = (
        url,
        options.get("endpoint"),
        *map(os.environ.get, ("AWS_ENDPOINT_URL", "AWS_ENDPOINT")),
    )
    plain = any(str(address).startswith("http://") for address in named)
    client: Any = {
        "connect_timeout": timedelta(seconds=5),
        "timeout": timedelta(seconds=REQUEST_S),
        # Whoever names an http:// address means it.
        **({"allow_http": True} if plain else {}),
        **options.get("client_options", {}),
    }
    retry: Any = {
        "max_retries": RETRIES,
        "retry_timeout": timedelta(seconds=RETRY_S),
        "backoff": {
            "init_backoff": timedelta(seconds=BACKOFF_S),
            "max_backoff": timedelta(seconds=5),
            "base": 2,
        },
        **options.get("retry_config", {}),
    }
    rest = {k: v for k, v in options.items() if k not in ("client_options", "retry_config")}
    try:
        return from_url(url, client_options=client, retry_config=retry, **rest)
    except (BaseError, ValueError, TypeError) as error:
        found = _shortened(str(error))
        raise StoreError(f"{url}: expected settings to reach it with, found: {found}") from error


_CREDENTIALS = (
    "check AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_REGION, or the like of another "
    "provider; AWS_SKIP_SIGNATURE=true reads what is public"
)


def _explained(error: Exception) -> str:
    """Return in one line what a request's failure means; the server's answer is XML in prose."""
    text = str(error)
    code = re.search(r"<Code>(.*?)</Code>", text, re.S)
    said = re.search(r"<Message>(.*?)</Message>", text, re.S)
    status = re.search(r"status code: (\d{3}[^:\n]*)", text)
    answer = ": ".join(m[1].strip() for m in (status, code, said) if m)
    if "NoSuchBucket" in text:
        return "expected a bucket, found none of that name; make it first"
    if isinstance(error, FileNotFoundError):
        return "expected an object, found none"
    kind = type(error).__name__
    if kind in ("PermissionDeniedError", "UnauthenticatedError"):
        return f"expected access, found it denied ({answer or kind}); {_CREDENTIALS}"
    if "169.254.169.254" in text or "metadata.google" in text:
        return f"expected credentials, found none; {_CREDENTIALS}"
    server = re.search(r"performing \w+ (\w+://[^/\s]+)", text)
    found = answer or _shortened(text)
    tries = re.search(r"after (\d+) retries", text)
    many = f" after {tries[1]} retries" if tries else ""
    return f"expected an answer{f' of {server[1]}' if server else ''}, found {found}{many}"


def _shortened(text: str) -> str:
    said = " ".join(text.partition(_DETAILS)[0].split())
    # What precedes the dash says which request it was, which the key does already.
    return re.sub(r"^Generic \w+ error: ", "", said.rpartition(" - ")[2])[:300]
