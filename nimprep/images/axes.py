"""Which axis of an array is what, and one frame of it as (H, W) or (H, W, C)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.images.header import ImageHeader, check_header

MOST_CHANNELS = 16
"""More than an image has: a third axis that is longer is none of channels."""


def checked_axes(shape: Sequence[int], axes: str | None, path: Path) -> str:
    """Return what an array's axes are; where that is not given, HW or HWC.

    Raises
    ------
    DecodeError
        They are not as many as given, or cannot be an image's.
    """
    found = f"shape {tuple(shape)}"
    if axes is None:
        axes = {2: "HW", 3: "HWC"}.get(len(shape), "")
        if not axes or (len(shape) == 3 and shape[2] > MOST_CHANNELS):
            raise DecodeError(
                f"{path}: expected an image's array, (H, W) or (H, W, C), found {found}; "
                "describe its 'axes', such as NHW"
            )
    if len(set(axes)) != len(axes) or not {"H", "W"} <= set(axes):
        raise DecodeError(
            f"{path}: expected axes with one H and one W, found {axes!r}; mend the description"
        )
    if len(axes) != len(shape):
        raise DecodeError(f"{path}: expected the axes {axes}, found {found}; mend 'axes'")
    sizes = dict(zip(axes, shape, strict=True))
    if sizes.get("C", 1) > MOST_CHANNELS:
        raise DecodeError(
            f"{path}: expected at most {MOST_CHANNELS} channels, found {found} for the axes "
            f"{axes}; mend 'axes'"
        )
    return axes


def array_header(shape: Sequence[int], dtype: np.dtype[Any], axes: str, path: Path) -> ImageHeader:
    """Return what an array says of the images in it.

    Raises
    ------
    DecodeError
        One of them would take more memory than should be spent.
    """
    sizes = dict(zip(axes, shape, strict=True))
    header = ImageHeader(
        sizes["H"],
        sizes["W"],
        8 * dtype.itemsize,
        f"array of {dtype}",
        sizes.get("C", 1),
        frames=sizes.get("N"),
    )
    check_header(header, path)
    return header


def check_index(frames: int | None, index: int | None, path: Path) -> None:
    """Raise `DecodeError` where a frame is wanted of a file of one, or one that is not there."""
    if (frames is None) != (index is None):
        found = "one that has no axis N" if frames is None else f"one of {frames} frames"
        wanted = "many frames" if frames is None else "one frame"
        raise DecodeError(f"{path}: expected a file of {wanted}, found {found}; mend 'axes'")
    if frames is not None and index is not None and not 0 <= index < frames:
        raise DecodeError(f"{path}: expected frame {index}, found {frames} frames; convert anew")


def as_image(array: npt.NDArray[Any], axes: str) -> npt.NDArray[Any]:
    """Return an array without frames as (H, W), or as (H, W, C) of several channels.

    Parameters
    ----------
    array : array
    axes : str
        H, W and perhaps C, in the array's order.
    """
    order = [axes.index(axis) for axis in "HWC" if axis in axes]
    image = array.transpose(order)
    return np.ascontiguousarray(image[:, :, 0] if image.shape[2:] == (1,) else image)
