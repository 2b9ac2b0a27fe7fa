"""Turn points and normals into the three channels of HHA (Gupta et al., ECCV 2014).

Lengths in centimetres, as the channels count them.
"""

from __future__ import annotations

import numpy as np
from numba import float32, float64, int64, types, uint8, void

from nimprep.compilation.decorator import kernel
from nimprep.kernels.hha_planes import decimal_depth

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_CAMERA = types.UniTuple(float64, 4)
_VECTOR = types.UniTuple(float64, 3)
_FLOOR_LEVEL = np.uint8(38)


@kernel(float64(_DEPTH, int64, int64, _CAMERA, _VECTOR))
def lowest_block(depth, first, last, camera, down):
    """Return the least height, -down·P in cm, of rows first..last-1; +inf without any depth."""
    fx, fy, cx, cy = camera
    # One minimum per column: LLVM makes vectors of it, but not of one minimum over all.
    lowest = np.full(depth.shape[1], np.inf)
    for v in range(first, last):
        rest = (v - cy) / fy * down[1] + down[2]
        for u in range(depth.shape[1]):
            z = decimal_depth(depth[v, u]) * 100
            height = -z * ((u - cx) / fx * down[0] + rest)
            if z > 0 and height < lowest[u]:
                lowest[u] = height
    return lowest.min()


@kernel(
    void(
        _DEPTH,
        float64[:, :, ::1],
        int64,
        int64,
        _CAMERA,
        _VECTOR,
        _VECTOR,
        float64,
        int64[::1],
    )
)
def floor_depths_block(depth, normals, first, last, camera, gravity, down, floor_above, counts):
    """Count by whole centimetres how far the floor's pixels of rows first..last-1 lie below.

    Floor is what has a normal with |n·gravity| > floor_above, and lies below the camera: down·P in
    cm from 0 to less than counts.size - 1; the last place counts all the pixels with depth.
    """
    fx, fy, cx, cy = camera
    gx, gy, gz = gravity
    for v in range(first, last):
        rest = (v - cy) / fy * down[1] + down[2]
        for u in range(depth.shape[1]):
            z = decimal_depth(depth[v, u]) * 100
            if not z > 0:
                continue
            counts[counts.size - 1] += 1
            x, y = normals[0, v, u], normals[1, v, u]
            cosine = abs(x * gx + y * gy + normals[2, v, u] * gz)
            below = z * ((u - cx) / fx * down[0] + rest)
            if cosine > floor_above and 0 < below < counts.size - 1:
                counts[int(below)] += 1


@kernel()
def _point_row(depth, v, camera, down, lowest, out_disparity, out_height):
    """Write the channels of the points of one row."""
    fx, fy, cx, cy = camera
    rest = (v - cy) / fy * down[1] + down[2]
    for u in range(depth.shape[0]):
        z = decimal_depth(depth[u]) * 100
        height = -z * ((u - cx) / fx * down[0] + rest)
        out_disparity[u] = np.rint(31000 / max(z, 100.0))
        out_height[u] = np.rint(height - lowest)


@kernel()
def _angle_row(x, y, z, gravity, table, thresholds, cosines, out):
    """Write the angle's channel of one row.

    An arc cosine per pixel would cost as much as the rest of the encoding: the table gives the
    level at the upper end of a narrow bin of cosines, and one comparison the level itself.
    """
    for u in range(out.shape[0]):
        cosine = x[u] * gravity[0] + y[u] * gravity[1] + z[u] * gravity[2]
        some = x[u] * x[u] + y[u] * y[u] + z[u] * z[u] > 0
        # Told so that NaN becomes -1: what comes of this is an index.
        cosines[u] = min(cosine, 1.0) if some & (cosine > -1.0) else -1.0
    bins = (table.shape[0] - 1) / 2
    for u in range(out.shape[0]):
        level = table[int((cosines[u] + 1) * bins)]
        out[u] = level + 1 if cosines[u] < thresholds[level] else level


@kernel(
    void(
        _DEPTH,
        float64[:, :, ::1],
        int64,
        int64,
        _CAMERA,
        _VECTOR,
        _VECTOR,
        float64,
        types.Tuple((uint8[::1], float64[::1])),
        uint8[:, :, ::1],
    )
)
def encode_block(depth, normals, first, last, camera, gravity, down, lowest, angle_levels, out):
    """Write HHA of rows first..last-1, whose normals are given; (0, 0, 0) where depth is 0.

    ``down`` is the direction that heights are counted against, ``lowest`` the height that becomes
    0, ``angle_levels`` a table of levels over cosines -1..1 and the cosines where the level rises.
    """
    width = depth.shape[1]
    table, thresholds = angle_levels
    disparity, height, cosines = np.empty(width), np.empty(width), np.empty(width)
    angle = np.empty(width, np.uint8)
    for v in range(first, last):
        x, y, z = normals[0, v - first], normals[1, v - first], normals[2, v - first]
        _point_row(depth[v], v, camera, down, lowest, disparity, height)
        _angle_row(x, y, z, gravity, table, thresholds, cosines, angle)
        for u in range(width):
            known = depth[v, u] > 0
            out[v, u, 0] = uint8(min(disparity[u], 255.0)) if known else uint8(0)
            out[v, u, 1] = uint8(min(max(height[u], 0.0), 255.0)) if known else uint8(0)
            out[v, u, 2] = angle[u] + _FLOOR_LEVEL if known else uint8(0)
