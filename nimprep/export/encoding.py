"""How a modality's numbers stand in a PNG, which has whole numbers from 0 on, of 8 or 16 bits.

What a store keeps is kept as it is, moved up where it can be negative: value = (PNG - subtract) *
scale + offset. Nothing is rounded, so that a PNG says as much as the store does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.modality import Modality

FOLDERS: dict[tuple[str, float], str] = {("depth", 1000): "depth_u16"}
"""Where a folder is not called as its modality, by that and its steps: GMRP's own, millimetres."""

FILE = "encodings.json"
"""Says how each folder's numbers are to be read (schemas/encodings.schema.json)."""


def folder_of(modality: Modality) -> str:
    """Return the folder of a modality's files.

    Depth in another unit than GMRP's does not stand where GMRP's reader would take it for that.
    """
    return FOLDERS.get((modality.name, modality.steps), modality.name)


def encode_image(image: npt.NDArray[np.integer], modality: Modality) -> npt.NDArray[Any]:
    """Return an image as a PNG holds it: (H, W) or (H, W, 3), uint8 or uint16.

    Vectors that are none are (0, 0, 0), which no other vector becomes.

    Parameters
    ----------
    image : (H, W) or (H, W, 3)
        As a store holds it.
    modality : Modality
    """
    shift = _subtract(modality)
    moved = image.astype(np.int32) + shift
    encoded: npt.NDArray[Any] = moved.astype(f"uint{8 * image.dtype.itemsize}")
    if modality.values == "vectors":
        encoded[~image.any(axis=2)] = 0
    return encoded


def describe_encoding(modality: Modality) -> dict[str, Any]:
    """Return a modality's entry in encodings.json."""
    measured = modality.values == "measures"
    subtract = _subtract(modality)
    scale = modality.step
    offset = modality.offset if measured else 0
    said = f"png - {subtract}" if subtract else "png"
    if measured:
        times = f" * {scale:g}" if scale != 1 else ""
        rest = f" + {offset:g}" if offset else ""
    else:
        times, rest = _divided(modality), ""
    return {
        "files": f"{folder_of(modality)}/{{id}}.png",
        "holds": modality.long_name,
        "bits": 8 * np.dtype(modality.dtype).itemsize,
        "channels": list(modality.channels),
        "units": modality.units,
        "value": (f"({said})" if subtract and times else said) + times + rest,
        "subtract": subtract,
        "scale": scale,
        "offset": offset,
        "none": _none(modality, subtract),
    }


def _divided(modality: Modality) -> str:
    """Return how a number is made of integers that are no measures, as text."""
    if modality.scale != 1:
        return f" * {modality.scale:.12g}"
    return f" / {modality.steps}" if modality.steps != 1 else ""


def _subtract(modality: Modality) -> int:
    """Return what is added to stored numbers: half the range where they are signed."""
    return -int(np.iinfo(modality.dtype).min)


def _none(modality: Modality, subtract: int) -> int | list[int] | None:
    """Return what a PNG holds where there is no value; None = there always is one."""
    if modality.values in ("vectors", "levels"):
        return [0, 0, 0]
    if modality.values == "colors" or (modality.values == "measures" and not modality.has_none):
        return None
    return modality.fill + subtract
