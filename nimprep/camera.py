"""A pinhole camera, and what cropping, resizing and flipping its image does to it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import floats
from nimprep.errors import ArrayError, CameraError

RANGES: dict[str, tuple[float, float]] = {
    "fx": (1e-3, 1e6),
    "fy": (1e-3, 1e6),
    "cx": (-1e6, 1e6),
    "cy": (-1e6, 1e6),
    "width": (1, 1 << 26),
    "height": (1, 1 << 26),
}
"""The least and the most that each of a camera's numbers can be, pixels: what
schemas/camera.schema.json says. Within them no ray and no plane leaves floating point."""

MAX_BASELINE_M = 1000.0
"""The largest stereo baseline, as there; the least lies beyond 0."""

D415_HORIZONTAL_FOV_DEG = 69.4
"""Nominal horizontal field of view of the RealSense D415's colour camera, degrees (datasheet)."""


@dataclass(frozen=True)
class Camera:
    """Describe a pinhole camera without distortion.

    The camera frame is x right, y down, z forward. Pixel (0, 0) is the centre of the top-left
    pixel: X = (u - cx) * Z / fx.

    Parameters
    ----------
    fx, fy : float
        Focal lengths, pixels, 0.001 to 1e6.
    cx, cy : float
        Principal point, pixels, -1e6 to 1e6; it may lie outside the image.
    width, height : int
        Image size, pixels, 1 to 2^26.

    Raises
    ------
    CameraError
        Something is no number or out of its range, or a size is not whole.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        for name, (least, most) in RANGES.items():
            value, whole = _number(getattr(self, name)), name in ("width", "height")
            if not least <= value <= most or (whole and not value.is_integer()):
                expected = "a whole number of" if whole else "a number of"
                raise CameraError(
                    f"camera: expected {expected} {least:g} to {most:g} pixels for {name}, "
                    f"found {getattr(self, name)!s:.80}"
                )
            object.__setattr__(self, name, int(value) if whole else value)

    @classmethod
    def from_fov(cls, horizontal_fov_deg: float, width: int, height: int) -> Camera:
        """Build the camera with square pixels, the image's centre and this field of view."""
        if not 0 < horizontal_fov_deg < 180:
            raise CameraError(
                f"camera: expected a field of view in (0, 180) deg, found {horizontal_fov_deg:g}"
            )
        focal = width / 2 / math.tan(math.radians(horizontal_fov_deg) / 2)
        return cls(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)

    @classmethod
    def from_matrix(cls, matrix: npt.ArrayLike, width: int, height: int) -> Camera:
        """Build from K, (3, 3), pixels; skew must be 0 and the last row (0, 0, 1)."""
        try:
            k = floats(matrix, "camera")
        except ArrayError as error:
            raise CameraError(f"camera: expected a (3, 3) matrix, found {matrix!r:.60}") from error
        if k.shape != (3, 3):
            raise CameraError(f"camera: expected a (3, 3) matrix, found shape {k.shape}")
        if k[0, 1] != 0 or k[1, 0] != 0 or not np.array_equal(k[2], (0, 0, 1)):
            raise CameraError(
                f"camera: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {k.tolist()}"
            )
        return cls(k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)

    @property
    def matrix(self) -> npt.NDArray[np.float64]:
        """K as (3, 3) float64, pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), as an image array of this camera has it."""
        return self.height, self.width

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name, as a camera file holds them."""
        names = ("fx", "fy", "cx", "cy", "width", "height")
        return {name: getattr(self, name) for name in names}

    def crop(self, top: int, left: int, height: int, width: int) -> Camera:
        """Return the camera of the window that starts at pixel (left, top)."""
        inside = 0 <= top <= top + height <= self.height and 0 <= left <= left + width <= self.width
        if not inside or height <= 0 or width <= 0:
            raise CameraError(
                f"camera: expected a window inside {self.width}x{self.height}, "
                f"found {width}x{height} at ({left}, {top})"
            )
        return replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def resize(self, height: int, width: int) -> Camera:
        """Return the camera of the image resized to (height, width), outer edges aligned."""
        new = replace(self, width=width, height=height)
        sx, sy = new.width / self.width, new.height / self.height
        return Camera(
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
            width=width,
            height=height,
        )

    def flip(self) -> Camera:
        """Return the camera of the image mirrored left to right."""
        return replace(self, cx=self.width - 1 - self.cx)


def unit_gravity(given: Any) -> npt.NDArray[np.float64]:
    """Return a direction of gravity, of any length, as a unit vector.

    Parameters
    ----------
    given : (3,) array_like
        In the camera frame (x right, y down, z forward), pointing down: (0, 1, 0) where the camera
        is level. An accelerometer at rest measures the opposite.

    Raises
    ------
    ArrayError
        It is none: not three finite numbers, or all of them 0.
    """
    vector = floats(given, "gravity")
    if vector.shape != (3,):
        raise ArrayError(f"gravity: expected 3 numbers, found shape {vector.shape}")
    largest = float(np.abs(vector).max())
    if not 0 < largest < np.inf:
        raise ArrayError(f"gravity: expected a direction, found {vector.tolist()}")
    # Of the largest and the smallest numbers there are, the squares are infinite or 0.
    vector = vector if 1e-100 < largest < 1e100 else vector / largest
    return np.asarray(vector / np.linalg.norm(vector))


def _number(value: Any) -> float:
    """Return a number as a float, NaN for what is none: texts, truth values, what is masked."""
    none = isinstance(value, (str, bytes, bool, np.bool_, complex, np.complexfloating))
    if none or np.ndim(value) > 0 or np.ma.is_masked(value):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan
