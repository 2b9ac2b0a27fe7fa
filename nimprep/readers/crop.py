"""Cut the same margins off every frame of a dataset; the camera moves along."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES
from nimprep.parallel import map_in_order
from nimprep.readers.base import Reader, WrappedReader


@dataclass(frozen=True)
class Margins:
    """Count the pixels to cut off each side of an image."""

    top: int
    bottom: int
    left: int
    right: int

    def __str__(self) -> str:
        return f"{self.top},{self.bottom},{self.left},{self.right}"

    def window(self, height: int, width: int) -> tuple[int, int]:
        """Return (height, width) of what is left.

        Raises
        ------
        LayoutError
            Nothing is left, or a margin is negative.
        """
        left_over = height - self.top - self.bottom, width - self.left - self.right
        if min(left_over) <= 0 or min(self.top, self.bottom, self.left, self.right) < 0:
            raise LayoutError(
                f"--crop {self}: expected top,bottom,left,right that leave something of "
                f"{width}x{height} pixels, found {left_over[1]}x{left_over[0]} left"
            )
        return left_over


class CroppedReader(WrappedReader):
    """Read another reader's frames with margins cut off."""

    def __init__(self, reader: Reader, margins: Margins) -> None:
        super().__init__(reader)
        self.margins = margins

    def shape(self, frame_id: str) -> tuple[int, int]:
        """Return (height, width) after cropping."""
        return self.margins.window(*self._reader.shape(frame_id))

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame's window, its camera moved along."""
        frame = self._reader.read(frame_id, modalities)
        height, width = self.margins.window(*frame.camera.shape)
        top, left = self.margins.top, self.margins.left
        window = np.s_[top : top + height, left : left + width]
        return replace(
            frame,
            camera=frame.camera.crop(top, left, height, width),
            rgb=None if frame.rgb is None else np.ascontiguousarray(frame.rgb[window]),
            depth_m=None if frame.depth_m is None else np.ascontiguousarray(frame.depth_m[window]),
            label=None if frame.label is None else np.ascontiguousarray(frame.label[window]),
            others={n: np.ascontiguousarray(i[window]) for n, i in frame.others.items()},
        )


def find_invalid_sides(
    reader: Reader,
    workers: int,
    done: Callable[[], None] = lambda: None,
    *,
    skip_bad: bool = False,
) -> Margins:
    """Return the sides that have depth in no frame of the dataset: whole rows and columns.

    Reads every frame's depth. GMRP's authors advise to cut these sides before training.

    Parameters
    ----------
    done : callable
        Called after each frame, for a progress bar.
    skip_bad : bool
        Pass over frames that cannot be decoded.

    Raises
    ------
    LayoutError
        The frames differ in size, so that they have no sides in common.
    """
    shapes = frame_shapes(reader, skip_bad=skip_bad)
    if len(shapes) > 1:
        raise LayoutError(
            f"{reader.root}: expected frames of one size for --crop auto, found {len(shapes)} "
            "sizes; give the margins as --crop top,bottom,left,right"
        )

    def valid_sides(frame_id: str) -> tuple[Any, Any]:
        try:
            depth_m = reader.read(frame_id, ("depth",)).depth_m
        except DecodeError as error:
            error.frame_id = frame_id
            if not skip_bad:
                raise
            return False, False
        finally:
            done()
        if depth_m is None:
            raise LayoutError(f"{reader.root}: expected depth for --crop auto, found none")
        return (depth_m > 0).any(axis=1), (depth_m > 0).any(axis=0)

    height, width = next(iter(shapes))
    rows, columns = np.zeros(height, dtype=bool), np.zeros(width, dtype=bool)
    for frame_rows, frame_columns in map_in_order(valid_sides, reader.ids, workers):
        rows |= frame_rows
        columns |= frame_columns
    return Margins(*_ends(rows), *_ends(columns))


def frame_shapes(reader: Reader, *, skip_bad: bool = False) -> dict[tuple[int, int], list[str]]:
    """Return the different (height, width) that frames have, by their headers, and who has each.

    Parameters
    ----------
    skip_bad : bool
        Pass over frames whose header cannot be read.

    Raises
    ------
    DecodeError
        A header cannot be read; or none can.
    """
    shapes: dict[tuple[int, int], list[str]] = {}
    bad: DecodeError | None = None
    for frame_id in reader.ids:
        try:
            shapes.setdefault(reader.shape(frame_id), []).append(frame_id)
        except DecodeError as error:
            error.frame_id = frame_id
            if not skip_bad:
                raise
            bad = error
    if not shapes and bad is not None:
        raise bad
    return shapes


def _ends(valid: npt.NDArray[np.bool_]) -> tuple[int, int]:
    where = np.flatnonzero(valid)
    return int(where[0]), int(len(valid) - 1 - where[-1])
