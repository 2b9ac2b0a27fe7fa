"""The benchmark's image files: confidence maps, ground truths, and PNGs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.images import read_array, read_header, read_label

_PNG_LEVEL = 2
"""zlib's level for PNGs written here: levels 3 to 6 take up to twice as long for 3 to 12 % less."""


@dataclass(frozen=True)
class GroundTruth:
    """Hold one ground truth.

    Attributes
    ----------
    positive : (H, W) bool
        Road, or the lane.
    evaluated : (H, W) bool
        Inside the evaluated area; what is outside takes part in no score.
    """

    positive: npt.NDArray[np.bool_]
    evaluated: npt.NDArray[np.bool_]


def read_confidence(path: Path) -> npt.NDArray[np.uint8]:
    """Return a confidence map, (H, W) uint8, 0 = surely not road.

    PNG: one channel of 8 bits. NumPy: floating probabilities, (H, W) in [0, 1], which become the
    nearest of 0/255 to 255/255.

    Raises
    ------
    DecodeError
        It has colour, another depth, NaN or values outside [0, 1], or is damaged.
    """
    header = read_header(path)
    if path.suffix == ".npy":
        return _confidence_from_probability(path)
    if header.bits != 8 or header.kind != "grey":
        raise DecodeError(
            f"{path}: expected a confidence map, 8-bit grey, "
            f"found {header.bits}-bit {header.kind}; write one channel of 0-255"
        )
    return read_label(path)


def _confidence_from_probability(path: Path) -> npt.NDArray[np.uint8]:
    array = read_array(path)
    if array.ndim != 2 or array.size == 0 or not np.issubdtype(array.dtype, np.floating):
        raise DecodeError(
            f"{path}: expected probabilities as a floating (H, W) array, "
            f"found {array.dtype} {array.shape}"
        )
    low, high = float(array.min()), float(array.max())
    if not (low >= 0 and high <= 1):
        raise DecodeError(f"{path}: expected probabilities in [0, 1], found {low:g} to {high:g}")
    return np.rint(array.astype(np.float64) * 255).astype(np.uint8)


def read_ground_truth(path: Path) -> GroundTruth:
    """Read a ground truth: blue > 0 = road (or lane), red > 0 = inside the evaluated area.

    Raises
    ------
    DecodeError
        It is no 8-bit RGB image, is damaged, or has no evaluated pixel.
    """
    image = read_label(path)
    if image.ndim != 3:
        raise DecodeError(
            f"{path}: expected a ground truth, 8-bit RGB with red = evaluated and blue = road, "
            "found one channel"
        )
    truth = GroundTruth(positive=image[:, :, 2] > 0, evaluated=image[:, :, 0] > 0)
    if not truth.evaluated.any():
        raise DecodeError(f"{path}: expected evaluated pixels (red > 0), found none")
    return truth


def png_bytes(image: npt.NDArray[Any]) -> bytes:
    """Return an image as PNG: grey uint8 or uint16, or (H, W, 3) R, G, B; the same bytes always."""
    import cv2

    stored = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, ::-1])
    _, data = cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])
    return data.tobytes()
