"""What every reader of a raw dataset offers: `convert` knows nothing else about a dataset."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from nimprep.depth_unit import UNKNOWN_NUMBERS, DepthNumbers
from nimprep.derive.methods import Ground
from nimprep.frame import Frame, LabelClass
from nimprep.images import read_header
from nimprep.modality import MODALITIES, Modality
from nimprep.readers.reference import Reference
from nimprep.splits import SplitName, SplitRule

OfficialSplit = SplitName | Literal["none"]
"""What the dataset's authors chose for a frame; "none": that it is in no split."""

CalibrationOrigin = Literal["file", "nominal", "user"]


@dataclass(frozen=True)
class DatasetInfo:
    """Describe a raw dataset as a whole.

    Attributes
    ----------
    name : str
        The reader's name ("gmrp", "kitti-road") or the one a folder description gives.
    classes : tuple of LabelClass
        What the label values mean; empty where the dataset is read without labels.
    calibration : {"file", "nominal", "user"}
        Where the cameras came from: the dataset's files, a data sheet, or the user's options.
    notes : tuple of str
        One line each, for the user to read: assumptions that were made.
    split_by : SplitRule or None
        The rule that is usual for the dataset; None = no other than the default.
    planes : tuple of Modality
        What frames have in `others` beside the modalities that the tool knows: see `nimprep.plane`.
    has_depth : bool
        Whether frames have depth at all.
    hha_ground : {"floor", "lowest"}, optional
        Where HHA's heights are counted from, unless the user says so; None = the floor.
    reference : Reference, optional
        Whose the dataset is.
    depth : DepthNumbers
        What is known of its numbers before a frame is decoded.
    """

    name: str
    classes: tuple[LabelClass, ...]
    calibration: CalibrationOrigin
    notes: tuple[str, ...] = ()
    split_by: SplitRule | None = None
    planes: tuple[Modality, ...] = ()
    has_depth: bool = True
    hha_ground: Ground | None = None
    reference: Reference | None = None
    depth: DepthNumbers = UNKNOWN_NUMBERS


class Reader(Protocol):
    """Read a raw dataset, frame by frame; safe to use from several threads at once.

    Attributes
    ----------
    info : DatasetInfo
        What holds for every frame.
    root : Path
        The dataset's folder. A reader never writes into it.
    ids : tuple of str
        Every frame, sorted. Of one that lacks a file, `sources`, `shape` and `read` are a
        `DecodeError`, which says so.
    """

    @property
    def info(self) -> DatasetInfo: ...

    @property
    def root(self) -> Path: ...

    @property
    def ids(self) -> tuple[str, ...]: ...

    def group(self, frame_id: str) -> str:
        """Return the scene the frame belongs to; "" = none known."""
        ...

    def fixed_split(self, frame_id: str) -> OfficialSplit | None:
        """Return the split the dataset's authors put the frame in; None = free to choose.

        "none" is a split, too: the frame takes part in none.
        """
        ...

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files `read` opens for the frame, in a fixed order."""
        ...

    def metadata(self, frame_id: str) -> dict[str, Any]:
        """Return what else the dataset says of the frame, by name, as JSON can hold it."""
        ...

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) of the frame's images as `read` gives them, from headers alone."""
        ...

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame: rgb, depth_m, label where labels are read, planes, camera, group.

        Only the images that `modalities` names are decoded; the others are None.

        Raises
        ------
        DecodeError
            A file is truncated, of another type or size than expected, or holds values that
            cannot be.
        """
        ...


class ReaderBase:
    """Answer as most readers do; a subclass has `info`, `root`, `ids`, `sources` and `read`."""

    def group(self, frame_id: str) -> str:
        """Return "": no scene is known."""
        return ""

    def fixed_split(self, frame_id: str) -> OfficialSplit | None:
        """Return None: the frame may go into any split."""
        return None

    def metadata(self, frame_id: str) -> dict[str, Any]:
        """Return nothing: images and cameras are all there is."""
        return {}

    def shape(self: Reader, frame_id: str) -> tuple[int, int]:
        """Return (height, width) from the header of the first of the frame's sources."""
        header = read_header(self.sources(frame_id)[0])
        return header.height, header.width


class WrappedReader:
    """Answer as another reader does; a subclass says what differs."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self.info, self.root, self.ids = reader.info, reader.root, reader.ids

    def group(self, frame_id: str) -> str:
        """Return the scene the frame belongs to."""
        return self._reader.group(frame_id)

    def fixed_split(self, frame_id: str) -> OfficialSplit | None:
        """Return the split the dataset's authors put the frame in."""
        return self._reader.fixed_split(frame_id)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files `read` opens for the frame."""
        return self._reader.sources(frame_id)

    def metadata(self, frame_id: str) -> dict[str, Any]:
        """Return what else the dataset says of the frame."""
        return self._reader.metadata(frame_id)

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) of the frame's images."""
        return self._reader.shape(frame_id)

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame."""
        return self._reader.read(frame_id, modalities)
