"""What the reference makes of windows whose points all lie on one line.

Such a window determines no plane. The reference does not notice: it normalises what the rounding
of its sums has left, and the direction of that vector goes into the picture. Only the same
operations in the same order give the same pixels, so this module keeps to them.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, types, void

from nimprep.compilation.decorator import kernel
from nimprep.kernels.hha_planes import decimal_depth

_DEPTH = types.Array(types.float32, 2, "C", readonly=True)
_CAMERA = types.UniTuple(float64, 4)
_RADIUS = 3


@kernel()
def _centimetres(depth):
    # The reference's port goes to centimetres, back to metres and to centimetres again.
    return decimal_depth(depth) * 100 / 100 * 100


@kernel()
def _point_terms(z, v, u, camera, out):
    """Write the nine terms that one point adds to AᵀA (upper triangle) and Aᵀb."""
    fx, fy, cx, cy = camera
    x = (u - cx) * z / fx
    y = (v - cy) * z / fy
    x_z = x / z
    y_z = y / z
    z_z = z * z
    out[0], out[1], out[2] = x_z * x_z, x_z * y_z, x_z
    out[3], out[4], out[5] = y_z * y_z, y_z, 1.0
    out[6], out[7], out[8] = x / z_z, y / z_z, 1 / z


@kernel()
def _count_columns(inverse, v, counts):
    """Count the points of each column in the rows of the windows around row v."""
    counts[:] = 0
    for row in range(max(0, v - _RADIUS), min(inverse.shape[0], v + _RADIUS + 1)):
        for u in range(inverse.shape[1]):
            counts[u] += inverse[row, u] > 0


@kernel()
def _sum_window(depth, inverse, v, u, camera, terms, sums):
    """Sum the terms of the window around (v, u) row by row."""
    height, width = inverse.shape
    sums[:] = 0
    for row in range(max(0, v - _RADIUS), min(height, v + _RADIUS + 1)):
        for column in range(max(0, u - _RADIUS), min(width, u + _RADIUS + 1)):
            if inverse[row, column] > 0:
                _point_terms(_centimetres(depth[row, column]), row, column, camera, terms)
                for term in range(9):
                    sums[term] += terms[term]


@kernel()
def _solve(sums):
    """Return adj(AᵀA) Aᵀb, not normalised."""
    a0, a1, a2, a3, a4, a5 = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    b0, b1, b2 = sums[6], sums[7], sums[8]
    i0 = a3 * a5 - a4 * a4
    i1 = -a1 * a5 + a2 * a4
    i2 = a1 * a4 - a2 * a3
    i3 = a0 * a5 - a2 * a2
    i4 = -a0 * a4 + a1 * a2
    i5 = a0 * a3 - a1 * a1
    return (
        i0 * b0 + i1 * b1 + i2 * b2,
        i1 * b0 + i3 * b1 + i4 * b2,
        i2 * b0 + i4 * b1 + i5 * b2,
    )


@kernel()
def _towards_scene(x, y, n, z, v, u, camera):
    """Normalise and point away from the camera: first by n_z, then by n·P."""
    fx, fy, cx, cy = camera
    length = np.sqrt(x * x + y * y + n * n)
    if not length > 0:
        return 0.0, 0.0, 0.0
    x, y, n = x / length, y / length, n / length
    if n < 0:
        x, y, n = -x, -y, -n
    if x * ((u - cx) * z / fx) + y * ((v - cy) * z / fy) + n * z < 0:
        x, y, n = -x, -y, -n
    return x, y, n


@kernel(void(_DEPTH, float64[:, ::1], int64, int64, _CAMERA, float64[:, :, ::1]))
def reference_normals(depth, inverse, first, last, camera, normals):
    """Replace the missing ones (0, 0, 0) among the radius-3 normals of rows first..last-1."""
    width = depth.shape[1]
    terms, sums = np.empty(9), np.empty(9)
    counts = np.empty(width, np.int64)
    for v in range(first, last):
        row = v - first
        _count_columns(inverse, v, counts)
        # Most windows without a plane have no point at all: the count tells them at once.
        count = counts[:_RADIUS].sum()
        for u in range(width):
            if u + _RADIUS < width:
                count += counts[u + _RADIUS]
            if u > _RADIUS:
                count -= counts[u - _RADIUS - 1]
            x, y, n = normals[0, row, u], normals[1, row, u], normals[2, row, u]
            if count == 0 or x != 0 or y != 0 or n != 0 or not depth[v, u] > 0:
                continue
            _sum_window(depth, inverse, v, u, camera, terms, sums)
            x, y, n = _solve(sums)
            z = _centimetres(depth[v, u])
            x, y, n = _towards_scene(x, y, n, z, v, u, camera)
            normals[0, row, u], normals[1, row, u], normals[2, row, u] = x, y, n
