"""The numbers of a camera file, whatever its format, and how texts and matrices say them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from nimprep.errors import CameraError
from nimprep.readers.distortion import Distortion

Intrinsics = tuple[float, float, float, float]

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_SHAPES = {9: (3, 3), 12: (3, 4), 16: (4, 4)}


@dataclass(frozen=True)
class CameraNumbers:
    """Hold what a camera file says.

    Attributes
    ----------
    intrinsics : (fx, fy, cx, cy), pixels
    format : str
        What the file is, for people.
    size : (height, width), optional
    baseline_m : float
        NaN = none.
    distortion : Distortion, optional
    rectified : (fx, fy, cx, cy), pixels, optional
        Of the images after rectification, where the file says it.
    pixel_origin : {0, 1}
        Coordinate of the centre of the top-left pixel.
    cam_to_road : 12 numbers, optional
        Transform from the camera frame to the road frame, (3, 4) row by row, metres.
    gravity : 3 numbers, optional
        Direction in the camera frame, pointing down, of any length.
    """

    intrinsics: Intrinsics
    format: str
    size: tuple[int, int] | None = None
    baseline_m: float = math.nan
    distortion: Distortion | None = None
    rectified: Intrinsics | None = None
    pixel_origin: int = 0
    cam_to_road: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None


def number_of(value: Any) -> float:
    """Return a number, or a text that is one, as a finite float; NaN for anything else."""
    if isinstance(value, bool):
        return math.nan
    try:
        if isinstance(value, (int, float)):
            number = float(value)
        else:
            text = value.strip() if isinstance(value, str) else ""
            number = float(text) if _NUMBER.fullmatch(text) and len(text) <= 40 else math.nan
    except OverflowError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def numbers_in(value: Any) -> tuple[float, ...]:
    """Return the numbers of a list, of lists, of a matrix by OpenCV; () = it is none of these."""
    if isinstance(value, Mapping):
        value = value.get("data")
    if not isinstance(value, (list, tuple)) or len(value) > 64:
        return ()
    flat = [x for row in value for x in (row if isinstance(row, (list, tuple)) else [row])]
    numbers = tuple(map(number_of, flat))
    return () if any(map(math.isnan, numbers)) else numbers


def numbers_of_text(text: str) -> tuple[float, ...] | None:
    """Return the numbers of a text that holds nothing else, brackets and commas apart."""
    words = re.sub(r"[\[\](),;]", " ", text).split()
    numbers = tuple(map(number_of, words))
    return None if any(map(math.isnan, numbers)) or not numbers else numbers


def intrinsics_of_matrix(numbers: Sequence[float], where: str) -> Intrinsics:
    """Return (fx, fy, cx, cy) of K as 9 numbers, or of a larger matrix it begins, as 12 or 16.

    Rows come first; 9 numbers with the principal point in the last row are columns first.

    Raises
    ------
    CameraError
        It is no K: it has skew, or another last row than (0, 0, 1).
    """
    rows, columns = _SHAPES.get(len(numbers), (0, 0))
    m = [list(numbers[r * columns : (r + 1) * columns]) for r in range(rows)]
    if rows == columns == 3 and m[0][2] == m[1][2] == 0 and (m[2][0] or m[2][1]):
        m = [list(column) for column in zip(*m, strict=True)]
    k = [row[:3] for row in m[:3]]
    skew = max(abs(k[0][1]), abs(k[1][0])) > 1e-9 * abs(k[0][0]) if rows else True
    ends = rows == 4 and (m[3] != [0, 0, 0, 1] or m[2][3] != 0)
    if skew or k[2] != [0, 0, 1] or ends:
        raise CameraError(
            f"{where}: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found "
            f"{k or list(numbers)}; give fx, fy, cx and cy in JSON"
        )
    return k[0][0], k[1][1], k[0][2], k[1][2]


def is_matrix(numbers: Sequence[float]) -> bool:
    """Return whether 9, 12 or 16 numbers are a camera's matrix: no rotation, no pose."""
    try:
        fx, fy, cx, cy = intrinsics_of_matrix(numbers, "")
    except CameraError:
        return False
    return fx > 0 and fy > 0 and (fx, fy, cx, cy) != (1, 1, 0, 0)


def size_of(width: Any, height: Any) -> tuple[int, int] | None:
    """Return (height, width) of two numbers; None = they say none, as 0 by 0 does."""
    w, h = number_of(width), number_of(height)
    whole = w >= 1 and h >= 1 and w.is_integer() and h.is_integer() and max(w, h) <= 1 << 26
    return (int(h), int(w)) if whole else None
