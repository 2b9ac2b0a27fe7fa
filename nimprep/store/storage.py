"""Where a store's files lie: keys such as "rgb/c/0/0/0/0", each whole or absent."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from nimprep.errors import StoreError
from nimprep.store.metadata import write_file


class Storage(Protocol):
    """Keep bytes under keys; safe to use from several threads and, pickled, processes.

    What is written is whole or absent, and stays once `write` returns. Errors are `StoreError`s
    that name the key.
    """

    def read(self, key: str) -> bytes | None:
        """Return what is kept under a key; None = nothing."""
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

    def zarr(self) -> Any:
        """Return what zarr-python opens as a group."""
        ...

    def __str__(self) -> str: ...


class LocalStorage:
    """Keep files in a folder, which is made when the first is written."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def __str__(self) -> str:
        return str(self.root)

    def _error(self, key: str, error: OSError) -> StoreError:
        path = self.root / key
        return StoreError(f"{path}: expected a file in reach, found {error.strerror}")

    def read(self, key: str) -> bytes | None:
        """Return a file's bytes; None = there is none."""
        try:
            return (self.root / key).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._error(key, error) from error

    def write(self, key: str, parts: Sequence[bytes]) -> None:
        """Write a file beside its place, then move it there."""
        write_file(self.root / key, parts)

    def move(self, key: str, other: str) -> None:
        """Rename a file over another."""
        try:
            (self.root / other).parent.mkdir(parents=True, exist_ok=True)
            (self.root / key).replace(self.root / other)
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

    def remove_partial(self) -> None:
        """Remove what writers that were killed left of files not yet in their place."""
        for path in self.root.rglob(".*.partial"):
            self.remove(path.relative_to(self.root).as_posix())

    def zarr(self) -> Path:
        """Return the folder."""
        return self.root
