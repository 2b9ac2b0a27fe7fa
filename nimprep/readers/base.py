"""What every reader of a raw dataset offers: `convert` knows nothing else about a dataset."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from nimprep.frame import Frame, LabelClass
from nimprep.modality import MODALITIES
from nimprep.splits import SplitName

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
    """

    name: str
    classes: tuple[LabelClass, ...]
    calibration: CalibrationOrigin
    notes: tuple[str, ...] = ()


class Reader(Protocol):
    """Read a raw dataset, frame by frame; safe to use from several threads at once.

    Attributes
    ----------
    info : DatasetInfo
        What holds for every frame.
    root : Path
        The dataset's folder. A reader never writes into it.
    ids : tuple of str
        Every frame, sorted; each has all its files (checked when the reader is made).
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

    def fixed_split(self, frame_id: str) -> SplitName | None:
        """Return the split the dataset's authors put the frame in; None = free to choose."""
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
        """Return the frame: rgb, depth_m, label where labels are read, camera, group.

        Only the images that `modalities` names are decoded; the others are None.

        Raises
        ------
        DecodeError
            A file is truncated, of another type or size than expected, or holds values that
            cannot be.
        """
        ...
