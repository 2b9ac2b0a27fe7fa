"""Raw numbers of one plane, unpacked from the channels, bytes and bits they were put into."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.readers.description import DepthSource

_LETTERS = "RGBA"
MOST_RAW = 1 << 32
"""Whole numbers beyond are no depth in any unit."""


def unpacked_depth(image: npt.NDArray[Any], source: DepthSource, path: Path) -> npt.NDArray[Any]:
    """Return a depth file's numbers as (H, W), made of its channels, bytes and bits.

    Raises
    ------
    DecodeError
        It has several channels or 8 bits that the description does not explain.
    """
    if source.bytes is not None:
        image = _from_bytes(image, source, path)
    plane = _one_channel(image, path)
    if plane.dtype.itemsize == 1 and source.in_metres:
        raise DecodeError(
            f"{path}: expected 16-bit or floating-point depth, found 8-bit; "
            "8-bit depth images are for looking at only, use the raw ones"
        )
    if source.rotate_right:
        plane = _rotated(plane, source.rotate_right, path)
    if plane.dtype.kind in "iu" and plane.dtype.itemsize > 4 and plane.max() > MOST_RAW:
        raise DecodeError(
            f"{path}: expected raw depth of at most {MOST_RAW}, found {plane.max()}; "
            "look whether its byte order is another"
        )
    return plane


def _one_channel(image: npt.NDArray[Any], path: Path) -> npt.NDArray[Any]:
    """Return an image's only channel; several of more than 8 bits that are equal count as one."""
    if image.ndim == 2:
        return image
    first, count = image[:, :, 0], image.shape[2]
    colors = image[:, :, : min(count, 3)]
    if image.dtype.itemsize > 1:
        # An alpha channel beside them says nothing of depth.
        if count in (3, 4) and (colors == first[:, :, None]).all():
            return np.ascontiguousarray(first)
        raise DecodeError(
            f"{path}: expected depth of one channel, found {count} channels of {image.dtype} "
            "that differ; name the one that counts as 'channel'"
        )
    raise DecodeError(
        f"{path}: expected depth of one channel, found {count} channels of {image.dtype}; "
        "use the dataset's raw depth if this is a picture of it, or describe how they make a "
        "number: 'bytes': 'RGB' as CARLA has it, or 'channel'"
    )


def _from_bytes(image: npt.NDArray[Any], source: DepthSource, path: Path) -> npt.NDArray[Any]:
    """Return the numbers that some channels' bytes make, the lowest first."""
    letters = source.bytes or ""
    channels = [_LETTERS.index(letter) for letter in letters]
    if image.ndim != 3 or image.dtype.itemsize != 1 or max(channels) >= image.shape[2]:
        count = 1 if image.ndim == 2 else image.shape[2]
        raise DecodeError(
            f"{path}: expected channels {letters} of 8 bits, found {count} of {image.dtype}; "
            "mend 'bytes' in the description"
        )
    parts = np.zeros((*image.shape[:2], 4), np.uint8)
    parts[:, :, : len(channels)] = image[:, :, channels]
    whole = parts.view("<u4")[:, :, 0].astype(np.uint32, copy=False)
    if source.bytes_as == "float32":
        return whole.view(np.float32)
    # Two bytes are told as those of any 16-bit number are, where their order is wrong.
    return whole.astype(np.uint16) if len(channels) == 2 else whole


def _rotated(plane: npt.NDArray[Any], bits: int, path: Path) -> npt.NDArray[np.uint16]:
    """Return 16-bit numbers whose bits are rotated to the right."""
    if plane.dtype not in (np.uint16, np.int16):
        raise DecodeError(
            f"{path}: expected 16-bit numbers to rotate by {bits} bits, found {plane.dtype}; "
            "leave 'rotate_right' out"
        )
    words = plane.view(np.uint16)
    return (words >> np.uint16(bits)) | (words << np.uint16(16 - bits))


def named_none(raw: npt.NDArray[Any], source: DepthSource) -> npt.NDArray[np.bool_]:
    """Return which raw numbers mean that there is none: 0, and those that the description names."""
    none: npt.NDArray[np.bool_] = raw == 0
    # A bound that the type cannot hold, 1e6 of float16, is infinity there.
    with np.errstate(over="ignore"):
        for value in source.invalid:
            if not isinstance(value, tuple):
                if value != 0:
                    none |= raw == value
                continue
            low, high = value
            inside = np.ones(raw.shape, np.bool_)
            if low is not None:
                inside &= raw >= low
            if high is not None:
                inside &= raw <= high
            none |= inside
    if np.issubdtype(raw.dtype, np.floating):
        none |= ~np.isfinite(raw)
    return none
