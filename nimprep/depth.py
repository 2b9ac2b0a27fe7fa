"""The checks every function of depth or disparity makes before its kernel runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import LEAST_DEPTH_M, unmasked
from nimprep.camera import Camera
from nimprep.errors import ArrayError
from nimprep.kernels.depth_values import bit_range, keep_some

Plane = npt.NDArray[np.float32]

_INFINITY_BITS = 0x7F800000
_SIGN_BIT = 0x80000000


def checked_depth(depth_m: Any, camera: Camera | None = None) -> Plane:
    """Return depth as C-contiguous float32 metres, 0 = none; see `checked_plane`.

    Depth below `LEAST_DEPTH_M` is none.
    """
    return checked_plane(depth_m, "depth_m", "metres", camera, LEAST_DEPTH_M)


def checked_plane(
    values: Any, name: str, unit: str, camera: Camera | None = None, least: float = 0.0
) -> Plane:
    """Return depth or disparity as C-contiguous float32, 0 = none.

    Parameters
    ----------
    values : (H, W) floating array
        0, NaN, infinity of either sign, and what is masked = none.
    name, unit : str
        What it is called in errors, and what it counts.
    camera : Camera, optional
        Its size must be the array's.
    least : float
        Positive values below it are none.

    Returns
    -------
    (H, W) float32
        Finite, 0 or at least `least`. The input itself where nothing had to change; never written
        to by the kernels.

    Raises
    ------
    ArrayError
        Not a two-dimensional floating array of at least one pixel, another size than the camera's,
        or holding negative finite values.
    """
    plane = unmasked(values, 0)
    if plane.ndim != 2 or plane.size == 0:
        raise ArrayError(f"{name}: expected a non-empty (H, W) array, found shape {plane.shape}")
    if not np.issubdtype(plane.dtype, np.floating):
        raise ArrayError(
            f"{name}: expected floating-point {unit}, found {plane.dtype}; "
            f"divide raw values by their units per {'metre' if unit == 'metres' else 'pixel'} first"
        )
    if camera is not None and plane.shape != camera.shape:
        raise ArrayError(
            f"{name}: expected the camera's size {camera.shape}, found {plane.shape}; "
            "crop or resize the camera along with the image"
        )
    # What is beyond float32 becomes infinite there, which is none.
    with np.errstate(over="ignore", under="ignore"):
        single = np.ascontiguousarray(plane, dtype=np.float32)
    floor = np.float32(least) if least > 0 else np.finfo(np.float32).smallest_subnormal
    lowest, highest = bit_range(single.reshape(-1).view(np.uint32))
    # One fast pass says that nothing has to change, as with nearly all images.
    if highest < _INFINITY_BITS and lowest >= floor.view(np.uint32) - 1:
        return single
    some = np.empty_like(single)
    negative = keep_some(single.reshape(-1), floor, some.reshape(-1))
    # Of other types, negative numbers may have become -0 or negative infinity.
    if negative or (highest >= _SIGN_BIT and plane.dtype.newbyteorder("=") != np.float32):
        _refuse_negative(plane, name, unit)
    return some


def _refuse_negative(plane: npt.NDArray[Any], name: str, unit: str) -> None:
    """Raise `ArrayError` where a value is negative and finite."""
    wrong = (plane < 0) & np.isfinite(plane)
    if wrong.any():
        v, u = np.argwhere(wrong)[0].tolist()
        raise ArrayError(
            f"{name}: expected {unit} >= 0, found {plane[v, u]:g} at pixel (u, v) = ({u}, {v}), "
            f"one of {wrong.sum()} negative; where there is none, put 0 or NaN"
        )
