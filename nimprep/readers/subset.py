"""Read some of a dataset's frames as if there were no others."""

from __future__ import annotations

from collections.abc import Iterable

from nimprep.readers.base import Reader, WrappedReader


class SubsetReader(WrappedReader):
    """Read another reader's frames, those named alone."""

    def __init__(self, reader: Reader, ids: Iterable[str]) -> None:
        super().__init__(reader)
        self.ids = tuple(ids)
