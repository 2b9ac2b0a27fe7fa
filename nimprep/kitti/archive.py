"""A zip that is there whole or not at all, and whose bytes depend on its content alone."""

from __future__ import annotations

import zipfile
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from nimprep.errors import LayoutError
from nimprep.files import whole_file

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""The earliest time a zip can hold: every entry gets it, so that the same input gives the same
bytes."""


class ZipWhole:
    """Write a zip as `nimprep.files.whole_file` writes a file; on an error, leave nothing.

    Entries carry no time of day and one set of permissions, so that the bytes depend on what is
    added alone.

    Parameters
    ----------
    path : Path
    *sources : Path
        What is read, and never written into.
    overwrite : bool
        Replace a file that is there.

    Raises
    ------
    LayoutError
        It cannot be written, or must not be.
    """

    def __init__(self, path: Path, *sources: Path, overwrite: bool = False) -> None:
        self._path = path
        self._whole = whole_file(path, *sources, overwrite=overwrite)
        self._open = ExitStack()

    def __enter__(self) -> ZipWhole:
        with ExitStack() as opening:
            partial = opening.enter_context(self._whole)
            self._zip = opening.enter_context(zipfile.ZipFile(partial, "w"))
            self._open = opening.pop_all()
        return self

    def add(self, name: str, data: bytes) -> None:
        """Add one entry at the zip's root, stored as it is: PNGs compress no further."""
        if not name or not name.isprintable() or not {"/", "\\", ":"}.isdisjoint(name):
            raise LayoutError(f"{self._path}: expected an entry's plain name, found {name!a}")
        entry = zipfile.ZipInfo(name, date_time=_EPOCH)
        # Unix, a plain file for all to read: the defaults differ between systems.
        entry.create_system = 3
        entry.external_attr = 0o100644 << 16
        self._zip.writestr(entry, data, compress_type=zipfile.ZIP_STORED)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.__exit__(kind, error, trace)
