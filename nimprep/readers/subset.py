"""Read some of a dataset's frames as if there were no others."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from nimprep.frame import Frame
from nimprep.modality import MODALITIES
from nimprep.readers.base import DatasetInfo, Reader
from nimprep.splits import SplitName


class SubsetReader:
    """Read another reader's frames, those named alone."""

    def __init__(self, reader: Reader, ids: Iterable[str]) -> None:
        self._reader = reader
        self._ids = tuple(ids)

    @property
    def info(self) -> DatasetInfo:
        """What holds for every frame."""
        return self._reader.info

    @property
    def root(self) -> Path:
        """The dataset's folder."""
        return self._reader.root

    @property
    def ids(self) -> tuple[str, ...]:
        """The frames that were named."""
        return self._ids

    def group(self, frame_id: str) -> str:
        """Return the scene the frame belongs to."""
        return self._reader.group(frame_id)

    def fixed_split(self, frame_id: str) -> SplitName | None:
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
