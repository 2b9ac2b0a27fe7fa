"""Stores in object stores: S3 and what speaks its language, Google's, Azure's, web servers.

Requests are made by obstore, Python's binding of Rust's object_store: it signs, pools connections,
retries, and lets other threads run meanwhile; its calls may come from many threads at once, as a
loader's do; it needs no other package. fsspec's s3fs, the other choice, runs all requests on one
thread of Python and pins one release of botocore, which other packages seldom agree with.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.store.connection import connect, live, requesting
from nimprep.store.location import location_from
from nimprep.store.storage import check_part

if TYPE_CHECKING:
    from obstore.store import ObjectStore

PART_BYTES = 5 << 20
"""A larger object goes up in parts of this size, each of them retried by itself."""

PARALLEL = 16
"""Requests made at once: one takes longer than what is done with the answer."""

READ_ALONG = 1 << 20
"""Bytes between two places that come along with both, which takes no longer than a request more."""

Version = dict[str, Any]
"""What tells one state of an object from another."""


class ObjectStorage:
    """Keep objects below a URL.

    Safe between threads, after a fork, and to pickle: connections are made when first needed, in
    each process for itself.

    Parameters
    ----------
    url : str
        Such as s3://bucket/out.zarr.
    **options
        Of `obstore.store.from_url`, over the environment's: region, endpoint, credential_provider,
        client_options, retry_config, and so on.

    Attributes
    ----------
    before_write : callable, optional
        Called before anything is written or removed; this process's alone.

    Raises
    ------
    StoreError
        The URL is of no kind that can be reached, or the extra `cloud` is missing.
    """

    root = None
    parallel = PARALLEL

    def __init__(self, url: str, **options: Any) -> None:
        from importlib.util import find_spec

        self.url = str(location_from(url))
        self.options = options
        self.before_write: Callable[[], None] | None = None
        self.opened: ObjectStore | None = None
        if find_spec("obstore") is None:
            raise StoreError(
                f"{self.url}: expected the package obstore, which reaches URLs, found none; "
                "pip install 'nimprep[cloud]'"
            )

    def __str__(self) -> str:
        return self.url

    def __repr__(self) -> str:
        return f"ObjectStorage({self.url!r})"

    def __getstate__(self) -> tuple[str, dict[str, Any]]:
        return self.url, self.options

    def __setstate__(self, state: tuple[str, dict[str, Any]]) -> None:
        self.url, self.options = state
        self.before_write, self.opened = None, None

    def sibling(self, name: str) -> ObjectStorage:
        """Return the place of another name beside this one."""
        return ObjectStorage(f"{self.url.rpartition('/')[0]}/{name}", **self.options)

    @property
    def name(self) -> str:
        """The last part of the URL; "" where that is the bucket."""
        return self.url.partition("://")[2].partition("/")[2].rpartition("/")[2]

    def _store(self) -> ObjectStore:
        # Two threads may both open it: one of the two goes on being used.
        if self.opened is None:
            self.opened = connect(self.url, self.options)
            live.add(self)
        return self.opened

    @property
    def _lists(self) -> bool:
        """Whether keys can be listed: not on a web server."""
        return type(self._store()).__name__ != "HTTPStore"

    def _refuse_web_server(self) -> None:
        if not self._lists:
            raise StoreError(f"{self.url}: expected a place to write, found a web server")

    def _begin_writing(self) -> None:
        self._refuse_web_server()
        if self.before_write is not None:
            self.before_write()

    @requesting
    def read(self, key: str, limit: int | None = None) -> bytes | None:
        """Return an object's bytes; None = there is none. One request."""
        try:
            found = self._store().get(key)
            if limit is not None and found.meta["size"] > limit:
                raise StoreError(
                    f"{self.url}/{key}: expected at most {limit} bytes, found {found.meta['size']}"
                )
            return found.bytes().to_bytes()
        except FileNotFoundError as error:
            _refuse_lost_bucket(error)
            return None

    def read_many(self, keys: Sequence[str], limit: int | None = None) -> dict[str, bytes | None]:
        """Return what `read` returns, for several keys at once."""
        with ThreadPoolExecutor(PARALLEL) as pool:
            found = pool.map(lambda key: self.read(key, limit), keys)
            return dict(zip(keys, found, strict=True))

    @requesting
    def read_tail(self, key: str, length: int) -> tuple[bytes, int]:
        """Return an object's last bytes, and how many it has in all. One request."""
        from obstore.exceptions import NotSupportedError

        store = self._store()
        try:
            found = store.get(key, options={"range": {"suffix": length}})
            data, size = found.bytes().to_bytes(), found.meta["size"]
        except NotSupportedError:
            size = store.head(key)["size"]  # Azure counts from the beginning only
            data = store.get_range(key, start=max(0, size - length), end=size).to_bytes()
        start = max(0, size - length)
        return check_part(data, start, size - start, f"{self.url}/{key}"), size

    @requesting
    def read_range(self, key: str, offset: int, length: int) -> bytes:
        """Return bytes from within an object. One request."""
        data = self._store().get_range(key, start=offset, length=length).to_bytes()
        return check_part(data, offset, length, f"{self.url}/{key}")

    def read_ranges(self, key: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return bytes from several places within an object.

        One request for places with less than `READ_ALONG` between one and the next.
        """

        def read(run: list[tuple[int, int]]) -> list[bytes]:
            first = run[0][0]
            data = self.read_range(key, first, sum(run[-1]) - first)
            return [data[offset - first : offset - first + length] for offset, length in run]

        # Not obstore's own `get_ranges`, which panics where a server answers with less.
        with ThreadPoolExecutor(PARALLEL) as pool:
            return [part for parts in pool.map(read, _runs(spans)) for part in parts]

    def read_into(self, key: str, offset: int, out: npt.NDArray[np.uint8]) -> int:
        """Copy bytes from within an object. One request."""
        out[:] = np.frombuffer(self.read_range(key, offset, len(out)), np.uint8)
        return len(out)

    @requesting
    def write(self, key: str, parts: Sequence[bytes]) -> None:
        """Put an object, in place of what was there."""
        self._begin_writing()
        if sum(map(len, parts)) <= PART_BYTES:
            self._store().put(key, b"".join(parts), use_multipart=False)
        else:
            self._store().put(key, iter(parts), chunk_size=PART_BYTES, max_concurrency=4)

    @requesting
    def create(self, key: str, data: bytes) -> Version | None:
        """Put an object where there is none and return its version; None = there is one."""
        from obstore.exceptions import AlreadyExistsError

        self._refuse_web_server()
        try:
            return dict(self._store().put(key, data, mode="create"))
        except AlreadyExistsError:
            return None

    @requesting
    def replace(self, key: str, data: bytes, version: Version) -> Version | None:
        """Put an object in place of this version of it; None = it is another, or gone."""
        from obstore.exceptions import PreconditionError

        expected: Any = {name: part for name, part in version.items() if part is not None}
        try:
            return dict(self._store().put(key, data, mode=expected))
        except (PreconditionError, FileNotFoundError):
            return None

    @requesting
    def look(self, key: str) -> tuple[bytes, Version, float] | None:
        """Return an object's bytes, version and time of writing (the server's); None = none."""
        try:
            found = self._store().get(key)
        except FileNotFoundError as error:
            _refuse_lost_bucket(error)
            return None
        version = {"e_tag": found.meta["e_tag"], "version": found.meta["version"]}
        return found.bytes().to_bytes(), version, found.meta["last_modified"].timestamp()

    def move(self, key: str, other: str) -> None:
        """Copy an object within the store, then delete it."""
        self._begin_writing()
        self._copy(key, other)
        self._delete([key])

    @requesting
    def _copy(self, key: str, other: str) -> None:
        self._store().copy(key, other)

    def remove(self, key: str) -> None:
        """Delete an object, and those below it."""
        self._begin_writing()
        self._delete([*([key] if key else []), *self.keys(key)])

    def remove_each(self, keys: Sequence[str]) -> None:
        """Delete objects, and none below them."""
        self._begin_writing()
        self._delete(keys)

    @requesting
    def _delete(self, keys: Sequence[str]) -> None:
        # Google's and Azure's say so where there was none; S3 does not.
        with suppress(FileNotFoundError):
            if keys:
                self._store().delete(keys)

    @requesting
    def keys(self, prefix: str = "") -> list[str]:
        """Return the keys that lie below a prefix, sorted. One request per thousand."""
        return sorted(found["path"] for found in self._listed(prefix))

    def _listed(self, prefix: str) -> Iterable[Any]:
        if not self._lists:
            raise StoreError(f"{self.url}: expected a place that can be listed, found a web server")
        return self._store().list(prefix or None).collect()

    @requesting
    def has_keys(self) -> bool:
        """Return whether there is any object here. One request."""
        return any(self._store().list(chunk_size=1))

    @requesting
    def folders(self) -> list[str]:
        """Return the first parts of keys with several; none where they cannot be listed."""
        if not self._lists:
            return []
        found: Any = self._store().list_with_delimiter()
        return sorted(found["common_prefixes"])

    @requesting
    def sizes(self, keys: Sequence[str]) -> dict[str, int]:
        """Return the bytes under those of the keys that are there.

        One request per thousand objects below what the keys have in common, or one per key where
        they cannot be listed.
        """
        if self._lists:
            common = posixpath.commonpath(keys).rpartition("/")[0]
            found = {item["path"]: item["size"] for item in self._listed(common)}
            return {key: found[key] for key in keys if key in found}
        with ThreadPoolExecutor(PARALLEL) as pool:
            measured = zip(keys, pool.map(self._size, keys), strict=True)
            return {key: size for key, size in measured if size is not None}

    def _size(self, key: str) -> int | None:
        try:
            return self._store().head(key)["size"]
        except FileNotFoundError:
            return None

    def zarr(self) -> Any:
        """Return what zarr-python opens as a group."""
        from zarr.storage import ObjectStore

        return ObjectStore(self._store())


def _runs(spans: Iterable[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """Return offsets and lengths, in rising order, in groups that one request brings."""
    runs: list[list[tuple[int, int]]] = []
    for offset, length in spans:
        if runs and 0 <= offset - sum(runs[-1][-1]) < READ_ALONG:
            runs[-1].append((offset, length))
        else:
            runs.append([(offset, length)])
    return runs


def _refuse_lost_bucket(error: FileNotFoundError) -> None:
    if "NoSuchBucket" in str(error):
        raise error
