"""The checks every function of depth or disparity makes before its kernel runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import ArrayError

_INFINITY_BITS = 0x7F800000


def checked_depth(depth_m: Any, camera: Camera | None = None) -> npt.NDArray[np.float32]:
    """Return depth as C-contiguous float32 metres, NaN read as 0; see `checked_plane`."""
    return checked_plane(depth_m, "depth_m", "metres", camera)


def checked_plane(
    values: Any, name: str, unit: str, camera: Camera | None = None
) -> npt.NDArray[np.float32]:
    """Return depth or disparity as C-contiguous float32, NaN read as 0.

    Parameters
    ----------
    values : (H, W) floating array
        0 or NaN = none.
    name, unit : str
        What it is called in errors, and what it counts.
    camera : Camera, optional
        Its size must be the array's.

    Returns
    -------
    (H, W) float32
        The input itself where nothing had to change; never written to by the kernels.

    Raises
    ------
    ArrayError
        Not a two-dimensional floating array of at least one pixel, another size than the camera's,
        or holding negative or infinite values.
    """
    plane = np.asarray(values)
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
    plane = np.ascontiguousarray(plane, dtype=np.float32)
    # Finite and not negative = below infinity's bits: one fast pass says so for nearly all images.
    if plane.view(np.uint32).max() < _INFINITY_BITS:
        return plane
    lowest, highest = plane.min(), plane.max()
    if np.isnan(lowest):
        plane = np.nan_to_num(plane, nan=0.0, posinf=np.inf, neginf=-np.inf)
        lowest, highest = plane.min(), plane.max()
    if lowest < 0 or np.isinf(highest):
        bad = "a negative" if lowest < 0 else "an infinite"
        raise ArrayError(f"{name}: expected finite {unit} >= 0, found {bad} value")
    return plane
