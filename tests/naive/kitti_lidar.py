"""Project a laser scan point by point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def sparse_depth(
    points: npt.NDArray[np.float32],
    velo_to_cam: npt.NDArray[np.float64],
    k: npt.NDArray[np.float64],
    height: int,
    width: int,
) -> npt.NDArray[np.float32]:
    depth = np.zeros((height, width), np.float32)
    for x, y, z in points[:, :3].astype(float):
        a, b, c = velo_to_cam @ [x, y, z, 1]
        if c <= 0:
            continue
        u = round(k[0, 0] * a / c + k[0, 2])
        v = round(k[1, 1] * b / c + k[1, 2])
        if 0 <= u < width and 0 <= v < height and (depth[v, u] == 0 or c < depth[v, u]):
            depth[v, u] = c
    return depth
