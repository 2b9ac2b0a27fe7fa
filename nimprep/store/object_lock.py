"""A lock in an object store: one object, put only where there is none, renewed while it is held.

Nobody there knows whether a process lives. So the holder writes the object anew every `BEAT_S`
seconds, and who finds it watches it: one that changes is held; one that stays as it is for
`STALE_S` seconds was left by the dead and is taken over, by a put that only succeeds on that very
version of it.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
import warnings
from contextlib import suppress
from types import TracebackType

from nimprep.errors import StoreError
from nimprep.store.connection import RequestError
from nimprep.store.objects import ObjectStorage, Version

BEAT_S = 5.0
"""How often a lock is renewed."""

STALE_S = 30.0
"""A lock that is not renewed for so long may be taken over."""

ANCIENT_S = 1200.0
"""One written so long ago is taken over at once; clocks may differ by less (S3: 15 minutes)."""


class ObjectLock:
    """Hold a lock for as long as the context lasts.

    Parameters
    ----------
    storage : ObjectStorage
    key : str
    what : str
        What is locked, for messages.

    Raises
    ------
    StoreError
        On entering: somebody else holds it, or the store cannot be written.
    """

    def __init__(self, storage: ObjectStorage, key: str, what: str) -> None:
        self._storage = storage
        self._key = key
        self._what = what
        self._token = secrets.token_hex(8)
        self._beats = 0
        self._lost = False
        self._renewing = threading.Lock()
        self._released = threading.Event()
        self._heart = threading.Thread(target=self._beat, name="nimprep-lock", daemon=True)

    def __enter__(self) -> ObjectLock:
        self._version = self._taken()
        self._renewed = time.monotonic()
        self._heart.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._released.set()
        # A renewal under way does not bring the lock back: it needs the version it knows.
        self._heart.join(timeout=1.0)
        # Where requests fail, one more would only take its time; the lock goes stale by itself.
        if not self._lost and not isinstance(error, RequestError):
            with suppress(RequestError):
                self._storage.remove(self._key)

    def check(self) -> None:
        """Make sure that the lock is held still.

        Raises
        ------
        StoreError
            Somebody took it over: this process stood still, or the store was out of reach.
        """
        if time.monotonic() - self._renewed > STALE_S - BEAT_S:
            self._renew()
        if self._lost:
            raise StoreError(
                f"{self._what}: expected to hold its lock, found that another command took it "
                f"over after {STALE_S:.0f} s without a sign of life; that one goes on"
            )

    def _note(self) -> bytes:
        self._beats += 1
        note = {
            "owner": self._token,
            "host": socket.gethostname(),
            "process": os.getpid(),
            "beat": self._beats,
        }
        return json.dumps(note).encode()

    def _mine(self, data: bytes) -> bool:
        return self._token.encode() in data

    def _taken(self) -> Version:
        """Return the version of the lock that was put, after waiting for a dead holder's."""
        watched: Version | None = None
        since = time.monotonic()
        while True:
            version = self._storage.create(self._key, self._note())
            found = self._storage.look(self._key)
            if found is None and time.monotonic() - since < STALE_S:
                time.sleep(0.1)
                continue  # released at this moment
            if found is None:
                raise StoreError(
                    f"{self._what}: expected to read the lock that was put, found none"
                )
            data, there, written = found
            # By the token: the answer to a put may have got lost, or its condition overlooked.
            if self._mine(data):
                return version or there
            if watched is not None and there != watched:
                raise self._held(data)
            stale = time.monotonic() - since > STALE_S or time.time() - written > ANCIENT_S
            if stale and (version := self._storage.replace(self._key, self._note(), there)):
                return version
            if watched is None and not stale:
                warnings.warn(
                    f"{self._what}: an earlier command, {_holder(data)}, left its lock or is at "
                    f"work; watching it for up to {STALE_S:.0f} s",
                    stacklevel=5,
                )
            watched = there
            time.sleep(min(1.0, BEAT_S / 5))

    def _held(self, data: bytes) -> StoreError:
        return StoreError(
            f"{self._what}: expected nobody else to change it, found one at work, "
            f"{_holder(data)}; wait for it, or choose another name"
        )

    def _beat(self) -> None:
        while not self._released.wait(BEAT_S) and not self._lost:
            try:
                self._renew()
            except StoreError:
                continue  # out of reach; what is written meanwhile fails too, and says so

    def _renew(self) -> None:
        with self._renewing:
            version = self._storage.replace(self._key, self._note(), self._version)
            if version is None:
                # A renewal whose answer got lost looks like somebody else's.
                found = self._storage.look(self._key)
                if found is None or not self._mine(found[0]):
                    self._lost = True
                    return
                version = found[1]
            self._version, self._renewed = version, time.monotonic()


def _holder(data: bytes) -> str:
    try:
        note = json.loads(data)
        return f"process {int(note['process'])} on {str(note['host'])[:60]}"
    except (ValueError, KeyError, TypeError):
        return "by whom it does not say"
