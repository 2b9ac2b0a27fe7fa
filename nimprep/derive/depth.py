"""The checks every function of depth makes before its kernel runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import ArrayError

_INFINITY_BITS = 0x7F800000


def checked_depth(depth_m: Any, camera: Camera | None = None) -> npt.NDArray[np.float32]:
    """Return depth as C-contiguous float32 metres, NaN read as 0.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0 or NaN = no depth.
    camera : Camera, optional
        Its size must be the array's.

    Returns
    -------
    (H, W) float32, metres
        The input itself where nothing had to change; never written to by the kernels.

    Raises
    ------
    ArrayError
        Not a two-dimensional floating array of at least one pixel, another size than the camera's,
        or holding negative or infinite values.
    """
    depth = np.asarray(depth_m)
    if depth.ndim != 2 or depth.size == 0:
        raise ArrayError(f"depth_m: expected a non-empty (H, W) array, found shape {depth.shape}")
    if not np.issubdtype(depth.dtype, np.floating):
        raise ArrayError(
            f"depth_m: expected floating-point metres, found {depth.dtype}; "
            "divide raw values by their units per metre first"
        )
    if camera is not None and depth.shape != camera.shape:
        raise ArrayError(
            f"depth_m: expected the camera's size {camera.shape}, found {depth.shape}; "
            "crop or resize the camera along with the image"
        )
    depth = np.ascontiguousarray(depth, dtype=np.float32)
    # Finite and not negative = below infinity's bits: one fast pass says so for nearly all depth.
    if depth.view(np.uint32).max() < _INFINITY_BITS:
        return depth
    lowest, highest = depth.min(), depth.max()
    if np.isnan(lowest):
        depth = np.nan_to_num(depth, nan=0.0, posinf=np.inf, neginf=-np.inf)
        lowest, highest = depth.min(), depth.max()
    if lowest < 0 or np.isinf(highest):
        bad = "a negative" if lowest < 0 else "an infinite"
        raise ArrayError(f"depth_m: expected finite metres >= 0, found {bad} value")
    return depth
