"""A zip that is there whole or not at all, and whose bytes depend on its content alone."""

from __future__ import annotations

import zipfile
from contextlib import suppress
from pathlib import Path

from nimprep.errors import LayoutError

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest time a zip can hold: every entry gets it, so that the same input gives the same
bytes."""


class ZipWhole:
    """Write a zip beside its place and move it there when all is in; on an error, leave nothing.

    Entries carry no time of day and one set of permissions, so that the bytes depend on what is
    added alone.

    Raises
    ------
    LayoutError
        It cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._temporary = path.with_name(f".{path.name}.partial")

    def __enter__(self) -> ZipWhole:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._zip = zipfile.ZipFile(self._temporary, "w")
        except OSError as error:
            raise self._unwritable(error) from error
        return self

    def add(self, name: str, data: bytes) -> None:
        """Add one entry at the zip's root, stored as it is: PNGs compress no further."""
        if not name or not name.isprintable() or not {"/", "\\", ":"}.isdisjoint(name):
            raise LayoutError(f"{self._path}: expected an entry's plain name, found {name!a}")
        entry = zipfile.ZipInfo(name, date_time=_EPOCH)
        # Unix, a plain file for all to read: the defaults differ between systems.
        entry.create_system = 3
        entry.external_attr = 0o100644 << 16
        try:
            self._zip.writestr(entry, data, compress_type=zipfile.ZIP_STORED)
        except OSError as error:
            raise self._unwritable(error) from error

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._zip.close()
            if kind is None:
                self._temporary.replace(self._path)
        except OSError as error:
            if kind is None:
                raise self._unwritable(error) from error
        finally:
            with suppress(OSError):
                self._temporary.unlink(missing_ok=True)

    def _unwritable(self, error: OSError) -> LayoutError:
        return LayoutError(f"{self._path}: expected to write it, found {error.strerror or error}")
