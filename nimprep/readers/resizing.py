"""Bringing registered images to another size, their outer edges aligned."""

from __future__ import annotations

from typing import Any, cast, get_args

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError
from nimprep.frame import MAX_PIXELS
from nimprep.readers.description import Size, SizeOf

MOST = 1 << 16


def size_from(given: Any) -> Size:
    """Return a size as people write it: "rgb", "depth", "WxH" or (width, height).

    Raises
    ------
    ArrayError
        It is none of these.
    """
    if isinstance(given, str) and given in get_args(SizeOf):
        return cast(SizeOf, given)
    parts = given.lower().split("x") if isinstance(given, str) else given
    try:
        # As text, 1.5 is no whole number.
        width, height = (int(str(part)) for part in parts)
    except (TypeError, ValueError):
        width = height = 0
    if not (1 <= width <= MOST and 1 <= height <= MOST and width * height <= MAX_PIXELS):
        raise ArrayError(f"size: expected rgb, depth or WxH, found {given!r:.80}; give 640x480")
    return width, height


def resized_colors(image: npt.NDArray[Any], height: int, width: int) -> npt.NDArray[Any]:
    """Return a colour image in another size: means of what becomes a pixel, linear where larger."""
    import cv2

    if image.shape[:2] == (height, width):
        return image
    smaller = height <= image.shape[0] and width <= image.shape[1]
    way = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    found: npt.NDArray[Any] = cv2.resize(
        np.ascontiguousarray(image), (width, height), interpolation=way
    )
    return found


def resized_nearest(image: npt.NDArray[Any], height: int, width: int) -> npt.NDArray[Any]:
    """Return an image in another size, each pixel that of the source in which its centre lies."""
    if image.shape[:2] == (height, width):
        return image
    rows = ((np.arange(height) + 0.5) * (image.shape[0] / height)).astype(np.intp)
    columns = ((np.arange(width) + 0.5) * (image.shape[1] / width)).astype(np.intp)
    return np.ascontiguousarray(image[rows[:, None], columns])


def resized_linear(
    image: npt.NDArray[Any], height: int, width: int, fill: float | None
) -> npt.NDArray[Any]:
    """Return a plane of numbers in another size, linear between pixels.

    Where a pixel would be made of `fill` or NaN too, it is the nearest pixel's instead.
    """
    if image.shape[:2] == (height, width):
        return image
    none = np.isnan(image) if np.issubdtype(image.dtype, np.floating) else image == fill
    if fill is not None:
        none = none | (image == fill)
    values = np.where(none, 0, image).astype(np.float32)
    made = resized_colors(values, height, width)
    touched = resized_colors(none.astype(np.float32), height, width) > 0
    if np.issubdtype(image.dtype, np.integer):
        made = np.rint(made)
    return np.where(touched, resized_nearest(image, height, width), made.astype(image.dtype))
