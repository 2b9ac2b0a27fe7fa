"""Colour images of a described dataset, as (H, W, 3) uint8."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_start
from nimprep.images import jpeg, png, read_plane, read_rgb
from nimprep.images.layout import PLAIN
from nimprep.readers.description import ColorSource
from nimprep.readers.matching import Place

_BITS_AT = 24
"""Where in a PNG the bits per channel stand."""


def color_image(place: Place, source: ColorSource) -> npt.NDArray[np.uint8]:
    """Read a colour image as (H, W, 3) uint8, channels R, G, B.

    Grey is repeated, alpha passed over. With a range, its ends become 0 and 255, what lies between
    the nearest number, what lies beyond one of the two.

    Raises
    ------
    DecodeError
        It is damaged, has more than 8 bits and the description does not say their range, or NaN.
    """
    if _is_plain(place, source):
        return read_rgb(place.path, source.orientation)
    image = _three_channels(read_plane(place.path, source.layout, place.index), place.path)
    if source.channels == "BGR":
        image = image[:, :, ::-1]
    if source.range is not None:
        image = _scaled(image, source.range, place.path)
    elif image.dtype != np.uint8:
        raise _no_range(image, place.path)
    return np.ascontiguousarray(image)


def color_notes(source: ColorSource) -> tuple[str, ...]:
    """Return what is to be said of how colour is read."""
    if source.range is None:
        return ()
    least, most = source.range
    return (f"colour is scaled to 8 bits: {least:g} becomes 0 and {most:g} becomes 255",)


def _is_plain(place: Place, source: ColorSource) -> bool:
    """Tell whether a file is a JPEG or PNG of 8 bits, which OpenCV reads in colour at once."""
    plain = replace(source.layout, orientation=PLAIN.orientation) == PLAIN
    if not plain or source.range is not None or source.channels != "RGB":
        return False
    start = read_start(place.path, png.HEADER_BYTES)
    if start.startswith(png.SIGNATURE):
        return len(start) <= _BITS_AT or start[_BITS_AT] <= 8
    return start.startswith(jpeg.SIGNATURE)


def _three_channels(image: npt.NDArray[Any], path: Path) -> npt.NDArray[Any]:
    if image.ndim == 2:
        image = image[:, :, None]
    # One or two: grey, and grey with alpha.
    if image.shape[2] <= 2:
        return np.repeat(image[:, :, :1], 3, axis=2)
    if image.shape[2] > 4:
        raise DecodeError(
            f"{path}: expected 1 to 4 channels of colour, found {image.shape[2]}; name the one "
            "that counts as 'channel', or what its axes are as 'axes'"
        )
    return image[:, :, :3]


def _scaled(
    image: npt.NDArray[Any], ends: tuple[float, float], path: Path
) -> npt.NDArray[np.uint8]:
    """Return an image in whole 0 to 255, by the range of its numbers."""
    if image.dtype in (np.uint8, np.uint16):
        values = np.arange(np.iinfo(image.dtype).max + 1, dtype=np.float64)
        return _in_range(values, ends).take(image)
    if image.dtype.kind == "f" and np.isnan(image).any():
        raise DecodeError(f"{path}: expected colour everywhere, found NaN; write 0 there")
    return _in_range(image.astype(np.float64), ends)


def _in_range(values: npt.NDArray[np.float64], ends: tuple[float, float]) -> npt.NDArray[np.uint8]:
    least, most = ends
    with np.errstate(over="ignore"):
        share = (np.clip(values, least, most) - least) * (255 / (most - least))
    return np.rint(share).astype(np.uint8)


def _no_range(image: npt.NDArray[Any], path: Path) -> DecodeError:
    """Return the error for colour of other than 8 bits; it shows a range."""
    most = np.nanmax(image) if image.size else 0
    known = (1.0, 255.0, 1023.0, 4095.0, 16383.0, 65535.0)
    likely = next((end for end in known if most <= end), float(most))
    if image.dtype.kind in "ui":
        likely = max(likely, 255.0)
    return DecodeError(
        f"{path}: expected an 8-bit colour image, found {image.shape[1]}x{image.shape[0]} "
        f"{image.dtype} of at most {most:g}; say what becomes 0 and 255, "
        f'"rgb": {{"files": ..., "range": [0, {likely:g}]}}'
    )
