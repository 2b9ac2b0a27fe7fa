"""The road's plane from a coarser image: some thousand pixels tell its height to 1 %."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.elevation import find_road_plane

PLANE_PIXELS = 2048
"""About so many pixels are looked at."""

_LEAST_PIXELS = 100

_UPRIGHT = 0.7
"""The least that a road's normal points up in the image: what is steeper to the view is a wall."""


def coarse_road_plane(
    depth_m: npt.NDArray[np.float32], camera: Camera
) -> npt.NDArray[np.float64] | None:
    """Return the road's plane, (4,) as of `estimate_road_plane`; None = there is none.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        Checked; 0 = none.
    """
    step = max(1, math.isqrt(depth_m.size // PLANE_PIXELS))
    first = step // 2
    part = np.ascontiguousarray(depth_m[first::step, first::step])
    if np.count_nonzero(part) < _LEAST_PIXELS:
        return None
    coarse = Camera(
        camera.fx / step,
        camera.fy / step,
        (camera.cx - first) / step,
        (camera.cy - first) / step,
        part.shape[1],
        part.shape[0],
    )
    plane = find_road_plane(part, coarse)
    return plane if plane is not None and plane[1] < -_UPRIGHT else None
