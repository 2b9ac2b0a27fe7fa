"""The benchmark's image files: confidence maps, ground truths, and PNGs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.images import read_array, read_array_header, read_header, read_label
from nimprep.kitti.names import PREDICTED, Target
from nimprep.schema import check_json, read_json

_PNG_LEVEL = 2
"""zlib's level for PNGs written here: levels 3 to 6 take up to twice as long for 3 to 12 % less."""

_ROUNDING = 1e-6
"""So far outside [0, 1] a probability may lie."""


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


def read_confidence(path: Path, *, mask: bool = False) -> npt.NDArray[np.uint8]:
    """Return a confidence map, (H, W) uint8, 0 = surely not road.

    PNG: one channel of 8 or 16 bits, the highest number being surely road; 16 bits become the
    nearest of 8. NumPy: floating probabilities, (H, W) in [0, 1], which become the nearest of
    0/255 to 255/255; or a plane for each class, (C, H, W), of the folder that `nimprep predict`
    made: which plane is the road's stands in its predictions.json.

    Parameters
    ----------
    mask : bool
        A PNG's 1 means surely road, as in a mask of 0 and 1.

    Raises
    ------
    DecodeError
        It has colour, another depth, NaN or values outside [0, 1], or is damaged.
    """
    if path.suffix.lower() == ".npy":
        return _confidence_from_probability(path)
    image = read_grey(path)
    if image is None:
        header = read_header(path)
        raise DecodeError(
            f"{path}: expected a confidence map, 8-bit or 16-bit grey, "
            f"found {header.bits}-bit {header.kind}; write one channel of 0-255"
        )
    if mask:
        return np.where(image > 0, np.uint8(255), np.uint8(0))
    if image.dtype != np.uint16:
        return image.astype(np.uint8, copy=False)
    highest = int(image.max())
    if 1 < highest <= 255:
        raise DecodeError(
            f"{path}: expected 16-bit confidences up to 65535, found at most {highest}, as 8 bits "
            "hold; write them as 8-bit grey"
        )
    return ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)


def read_grey(path: Path) -> npt.NDArray[Any] | None:
    """Return a grey image's numbers, (H, W), uint8 or uint16; None where it is of another kind.

    Images of 1 bit are 0 and 255.

    Raises
    ------
    DecodeError
        It is damaged.
    """
    header = read_header(path)
    if header.kind != "grey" or header.bits not in (1, 8, 16):
        return None
    image = read_label(path)
    return image * np.uint8(255) if header.bits == 1 else image


def _confidence_from_probability(path: Path) -> npt.NDArray[np.uint8]:
    reason = reason_against_array(path)
    if reason:
        raise DecodeError(f"{path}: {reason}")
    array = read_array(path)
    if array.ndim == 3:
        array = array[_road_plane(path, len(array))]
    low, high = float(array.min()), float(array.max())
    # A softmax in float32 may pass 1 by its rounding.
    if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
        raise DecodeError(
            f"{path}: expected probabilities in [0, 1], found {low:g} to {high:g}; "
            "put logits through a sigmoid or softmax first"
        )
    return np.rint(array.astype(np.float64) * 255).astype(np.uint8)


def reason_against_array(path: Path) -> str:
    """Return why a .npy file is no map of probabilities, from its header; empty = it may be one.

    Raises
    ------
    DecodeError
        It is no such file.
    """
    header = read_array_header(path)
    of_class = len(header.shape) == 3 and _road_plane(path, header.shape[0]) is not None
    plane = (len(header.shape) == 2 or of_class) and 0 not in header.shape
    if plane and np.issubdtype(header.dtype, np.floating):
        return ""
    found = f"{header.shape} of {header.dtype}"
    advice = "write one plane, that of the road" if not plane else "write them as float32, 0 to 1"
    return f"expected probabilities as a floating (H, W) array, found {found}; {advice}"


def _road_plane(path: Path, planes: int) -> int | None:
    """Return which of a file's planes is the road's; None = nothing says so.

    `nimprep predict` says what its planes stand for, in the folder above scores/, in which a
    frame's file may lie in a folder of its half.
    """
    for folder in list(path.absolute().parents)[:3]:
        if (folder / PREDICTED).is_file():
            said = read_json(folder / PREDICTED)
            check_json(said, "predictions", str(folder / PREDICTED))
            names = [known["name"] for known in said["classes"]]
            places = [place for place, name in enumerate(names) if name in get_args(Target)]
            return places[0] if len(places) == 1 and len(names) == planes else None
    return None


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


def confidence_shape(path: Path) -> tuple[int, int]:
    """Return height and width of a confidence map, from its header."""
    if path.suffix.lower() == ".npy":
        height, width = read_array_header(path).shape[-2:]
        return height, width
    header = read_header(path)
    return header.height, header.width
