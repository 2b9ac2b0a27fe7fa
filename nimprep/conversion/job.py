"""All that a unit's encoding needs to know: plain data, which goes to other processes as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.sources import FileState
from nimprep.readers import Reader, open_reader
from nimprep.readers.crop import CroppedReader, Margins
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreLayout


@dataclass(frozen=True)
class Base:
    """Name the store that frames are appended to, as far as encoding them depends on it.

    Attributes
    ----------
    frames : int
        So many it has: the first unit is to fill its last shard.
    height, width : int
        Of its padded images.
    digest : str
        Of its sources.
    """

    frames: int
    height: int
    width: int
    digest: str


@dataclass(frozen=True)
class Job:
    """Describe a conversion to whoever encodes a part of it.

    Attributes
    ----------
    source : Path
    options : ConvertOptions
    margins : Margins, optional
        Cut off every frame.
    layout : StoreLayout
        Its number of frames is that of the source; fewer are stored where some are skipped.
    states : mapping of frame id to file states
        In the reader's order.
    storage : Storage
        Where the store is written.
    base : Base, optional
        The store that the frames will be appended to.
    """

    source: Path
    options: ConvertOptions
    margins: Margins | None
    layout: StoreLayout
    states: Mapping[str, tuple[FileState, ...]]
    storage: Storage
    base: Base | None = None

    def open_reader(self) -> Reader:
        """Open the source as the plan did."""
        reader = open_reader(self.source, self.options.reader, self.options.reading)
        return reader if self.margins is None else CroppedReader(reader, self.margins)

    def units(self) -> list[list[str]]:
        """Return each unit's frame ids: see `units_of`."""
        frames = self.base.frames if self.base else 0
        return units_of(list(self.states), self.layout.shard_length, frames)


def units_of(ids: Sequence[str], length: int, before: int) -> list[list[str]]:
    """Return each unit's frame ids: a shard's length, less in the last.

    The first has as many as the last shard of the `before` frames that there are already has room
    for, so that shards fall together.
    """
    first = length - before % length
    return [list(ids[:first]), *(list(ids[i : i + length]) for i in range(first, len(ids), length))]
