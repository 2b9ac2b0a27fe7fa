"""All that a unit's encoding needs to know: plain data, which goes to other processes as it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nimprep.conversion.encode import EncodedFrame, encode_frame
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.records import DEPTHS, SkippedFrame, UnitRecord
from nimprep.conversion.sources import FileState
from nimprep.errors import NimprepError
from nimprep.readers import Reader, open_reader
from nimprep.readers.crop import CroppedReader, Margins
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreLayout, StoreWriter


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

    def encode(self, reader: Reader, frame_id: str) -> EncodedFrame | SkippedFrame:
        """Encode one frame; where bad frames are to be skipped, say why it was.

        Raises
        ------
        NimprepError
            The frame is bad, and none may be; the error's note names it.
        """
        state = self.states[frame_id]
        try:
            return encode_frame(reader, frame_id, self.layout, self.options.recipe, state)
        except NimprepError as error:
            if self.options.on_error == "skip":
                reason = " ".join(str(error).split()).replace(f"{reader.root}/", "")
                return SkippedFrame(frame_id, reason)
            error.frame_id = frame_id
            raise


def units_of(ids: Sequence[str], length: int, before: int) -> list[list[str]]:
    """Return each unit's frame ids: a shard's length, less in the last.

    The first has as many as the last shard of the `before` frames that there are already has room
    for, so that shards fall together.
    """
    first = length - before % length
    return [list(ids[:first]), *(list(ids[i : i + length]) for i in range(first, len(ids), length))]


class UnitBuilder:
    """Collect a unit's frames, in order, until its shards can be written."""

    def __init__(self, number: int, job: Job) -> None:
        self.number = number
        self._job = job
        self._frames: list[EncodedFrame] = []
        self._skipped: list[SkippedFrame] = []

    def add(self, frame: EncodedFrame | SkippedFrame) -> None:
        """Take in the next frame."""
        if isinstance(frame, SkippedFrame):
            self._skipped.append(frame)
        else:
            self._frames.append(frame)

    def write(self) -> UnitRecord:
        """Write the unit's shard of every modality and return what is to be kept of it."""
        writer = StoreWriter(self._job.storage, self._job.layout)
        counts = np.zeros(DEPTHS, dtype=np.int64)
        for frame in self._frames:
            counts += frame.depth_counts
        for modality in self._job.layout.modalities if self._frames else ():
            chunks = [frame.chunks[modality] for frame in self._frames]
            writer.write_shard(modality, self.number, chunks)
        facts = tuple(frame.facts for frame in self._frames)
        return UnitRecord(self.number, facts, tuple(self._skipped), counts)


def encode_unit(
    job: Job, reader: Reader, number: int, before_writing: Callable[[], None] = lambda: None
) -> UnitRecord:
    """Encode and write one unit on the calling thread alone."""
    builder = UnitBuilder(number, job)
    for frame_id in job.units()[number]:
        builder.add(job.encode(reader, frame_id))
    before_writing()
    return builder.write()
