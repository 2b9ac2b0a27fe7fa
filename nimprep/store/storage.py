"""Where a store's files lie: keys such as "rgb/c/0/0/0/0", each whole or absent."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.files import open_plain, read_file, replace_file
from nimprep.store.checksums import MEND


@runtime_checkable
class Storage(Protocol):
    """Keep bytes under keys; safe to use from several threads and, pickled, processes.

    What is written is whole or absent, and stays once `write` returns. Errors are `StoreError`s
    that name the key.

    Attributes
    ----------
    root : Path, optional
        The folder with the files; None = they are in none.
    parallel : int
        How many reads at once are worth while, however few the cores.
    """

    @property
    def root(self) -> Path | None: ...

    @property
    def parallel(self) -> int: ...

    def read(self, key: str, limit: int | None = None) -> bytes | None:
        """Return what is kept under a key; None = nothing. More than `limit` bytes are an error."""
        ...

    def read_many(self, keys: Sequence[str], limit: int | None = None) -> dict[str, bytes | None]:
        """Return what `read` returns, for several keys."""
        ...

    def read_tail(self, key: str, length: int) -> tuple[bytes, int]:
        """Return the last bytes under a key, and how many there are in all."""
        ...

    def read_ranges(self, key: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return the bytes at these offsets, rising, of these lengths; fewer are an error."""
        ...

    def read_into(self, key: str, offset: int, out: npt.NDArray[np.uint8]) -> int:
        """Read as many bytes as `out` has into it; return how many were there.

        Fast, and without a look at where the key leads: `read_tail` has been asked for it before.
        """
        ...

    def write(self, key: str, parts: Sequence[bytes]) -> None:
        """Keep the parts, one after another, under a key, in place of what was there."""
        ...

    def move(self, key: str, other: str) -> None:
        """Keep what is under `key` under `other` from now on."""
        ...

    def remove(self, key: str) -> None:
        """Keep nothing under a key any more, nor under the keys below it."""
        ...

    def keys(self, prefix: str = "") -> list[str]:
        """Return the keys that lie below a prefix, sorted."""
        ...

    def folders(self) -> list[str]:
        """Return the first parts of the keys that have several, sorted."""
        ...

    def sizes(self, keys: Sequence[str]) -> dict[str, int]:
        """Return how many bytes are under each of the keys that are there."""
        ...

    def __str__(self) -> str: ...


def check_part(data: bytes, offset: int, length: int, where: str) -> bytes:
    """Return the part of a file or an object that was asked for.

    Raises
    ------
    StoreError
        It is longer or shorter.
    """
    if len(data) != length:
        raise StoreError(
            f"{where}: expected {length} bytes from byte {offset} on, found {len(data)}; {MEND}"
        )
    return data


def _read_part(file: BinaryIO, offset: int, length: int, where: str) -> bytes:
    file.seek(offset)
    return check_part(file.read(length), offset, length, where)


class LocalStorage:
    """Keep files in a folder, which is made when the first is written.

    The folder may be a link; within it, links and names that lead out of it are errors: a store
    from somebody else must not make its reader read, or write, other files of his.
    """

    parallel = 1

    def __init__(self, root: Path) -> None:
        self.root = root

    def locate(self, key: str) -> Path:
        """Return a file's path.

        Raises
        ------
        StoreError
            It leads out of the folder.
        """
        path = self.root / key
        real = os.path.realpath(path)
        if not real.startswith(os.path.join(os.path.realpath(self.root), "")):  # noqa: PTH118
            raise StoreError(
                f"{path}: expected a file within the store, found one that leads to {real}; "
                "put the file itself there"
            )
        return path

    def __str__(self) -> str:
        return str(self.root)

    def _error(self, key: str, error: OSError) -> StoreError:
        path = self.root / key
        return StoreError(f"{path}: expected a file in reach, found {error.strerror}")

    def read(self, key: str, limit: int | None = None) -> bytes | None:
        """Return a file's bytes; None = there is none."""
        try:
            return read_file(
                self.locate(key), sys.maxsize if limit is None else limit, error=StoreError
            )
        except StoreError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return None
            raise

    def read_many(self, keys: Sequence[str], limit: int | None = None) -> dict[str, bytes | None]:
        """Return several files' bytes."""
        return {key: self.read(key, limit) for key in keys}

    def read_tail(self, key: str, length: int) -> tuple[bytes, int]:
        """Return a file's last bytes, and its size."""
        with open_plain(self.locate(key), "a shard", StoreError) as (file, size):
            start = max(0, size - length)
            return _read_part(file, start, size - start, f"{self}/{key}"), size

    def read_ranges(self, key: str, spans: Sequence[tuple[int, int]]) -> list[bytes]:
        """Return bytes from several places within a file."""
        with open_plain(self.locate(key), error=StoreError) as (file, _):
            return [_read_part(file, *span, f"{self}/{key}") for span in spans]

    def read_into(self, key: str, offset: int, out: npt.NDArray[np.uint8]) -> int:
        """Read bytes from within a file straight to where they are to be."""
        path = f"{self.root}/{key}"
        try:
            descriptor = os.open(path, os.O_RDONLY)
            try:
                return os.preadv(descriptor, [out.data], offset)
            finally:
                os.close(descriptor)
        except OSError as error:
            raise StoreError(f"{path}: expected a shard, found {error.strerror}; {MEND}") from error

    def write(self, key: str, parts: Sequence[bytes]) -> None:
        """Write a file beside its place, then move it there."""
        replace_file(self.locate(key), parts, StoreError)

    def move(self, key: str, other: str) -> None:
        """Rename a file over another."""
        try:
            place = self.locate(other)
            place.parent.mkdir(parents=True, exist_ok=True)
            (self.root / key).replace(place)
        except OSError as error:
            raise self._error(key, error) from error

    def remove(self, key: str) -> None:
        """Remove a file or a folder with all that is in it."""
        path = self.root / key
        try:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except OSError as error:
            raise self._error(key, error) from error

    def keys(self, prefix: str = "") -> list[str]:
        """Return the files below a folder; those not yet in their place are left out."""
        below = self.root / prefix
        paths = (p for p in below.rglob("*") if p.is_file() and not p.name.startswith("."))
        return sorted(p.relative_to(self.root).as_posix() for p in paths)

    def folders(self) -> list[str]:
        """Return the names of the folders here."""
        return sorted(path.name for path in self.root.glob("*/"))

    def sizes(self, keys: Sequence[str]) -> dict[str, int]:
        """Return the sizes of those files that are there."""
        paths = {key: self.locate(key) for key in keys}
        return {key: path.stat().st_size for key, path in paths.items() if path.is_file()}

    def remove_partial(self) -> None:
        """Remove what writers that were killed left of files not yet in their place."""
        for path in self.root.rglob(".*.partial"):
            self.remove(path.relative_to(self.root).as_posix())
