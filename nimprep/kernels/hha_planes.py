"""Planes fitted to the inverse depth of square windows (Gupta et al., ECCV 2014).

1/Z of a plane is linear in the pixel coordinates u and v, so the fit needs nine sums per window:
of 1/Z, u/Z, v/Z and of 1, u, v, u², uv, v² over the pixels that count. Column sums run down the
image and window sums along the row: the cost does not depend on the radius. All in double; the sums
of coordinates are integers below 2^53 and therefore exact, which tells windows whose points lie on
one line (determinant 0) from all others without a tolerance.
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel

# Callers' arrays may be read-only; these types take both kinds.
_DEPTH = types.Array(float32, 2, "C", readonly=True)
_MASK = types.Array(boolean, 2, "C", readonly=True)
_CAMERA = types.UniTuple(float64, 4)


@kernel(float64(float32))
def decimal_depth(depth):
    """Read float32 metres as the multiple of 0.1 mm they were made from, where they were.

    Depth files hold integers of 1 or 0.1 mm. Their rounding to float32 alone turned 8 of 307,200
    pixels of the reference frame's HHA by one level; this undoes it. Values that are no float32 of
    such a multiple are kept, so nothing moves by more than that rounding.
    """
    decimal = np.rint(np.float64(depth) * 1e4) / 1e4
    return decimal if np.float32(decimal) == depth else np.float64(depth)


@kernel(void(_DEPTH, _MASK, int64, int64, float64[:, ::1], int64[::1]))
def inverse_depth(depth, missing, first, last, out, near_far):
    """Write 1/Z of rows first..last-1 (0 where no point counts) and count the depths.

    ``near_far`` gets the number of pixels with depth, below 5 cm and beyond 100 m.
    """
    known = near = far = 0
    for v in range(first, last):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            known += z > 0
            near += (z > 0) & (z < np.float32(0.05))
            far += z > np.float32(100)
            out[v, u] = 1 / decimal_depth(z) if z > 0 and not missing[v, u] else 0.0
    near_far[0] = known
    near_far[1] = near
    near_far[2] = far


@kernel()
def _add_row(inverse, v, sign, columns):
    """Add one row (sign 1), or take it away (-1), to the column sums of w, vw, 1, v, v²."""
    for u in range(inverse.shape[0]):
        w = inverse[u]
        one = sign if w > 0 else 0.0
        columns[0, u] += sign * w
        columns[1, u] += sign * v * w
        columns[2, u] += one
        columns[3, u] += one * v
        columns[4, u] += one * v * v


@kernel()
def _sum_windows(columns, radius, sums):
    """Run along the columns: sums of w, uw, vw, 1, u, u², v, uv, v² of every window of a row."""
    width = columns.shape[1]
    w0 = wu = wv = n0 = nu = nuu = nv = nuv = nvv = 0.0
    for u in range(min(radius, width)):
        w, n, m = columns[0, u], columns[2, u], columns[3, u]
        w0 += w
        wu += u * w
        wv += columns[1, u]
        n0 += n
        nu += u * n
        nuu += u * u * n
        nv += m
        nuv += u * m
        nvv += columns[4, u]
    for u in range(width):
        if u + radius < width:
            # Doubles, since products of integers would have to be turned into them.
            enter = np.float64(u + radius)
            w, n, m = columns[0, u + radius], columns[2, u + radius], columns[3, u + radius]
            w0 += w
            wu += enter * w
            wv += columns[1, u + radius]
            n0 += n
            nu += enter * n
            nuu += enter * enter * n
            nv += m
            nuv += enter * m
            nvv += columns[4, u + radius]
        last = u - radius - 1
        if last >= 0:
            leave = np.float64(last)
            w, n, m = columns[0, last], columns[2, last], columns[3, last]
            w0 -= w
            wu -= leave * w
            wv -= columns[1, last]
            n0 -= n
            nu -= leave * n
            nuu -= leave * leave * n
            nv -= m
            nuv -= leave * m
            nvv -= columns[4, last]
        sums[0, u], sums[1, u], sums[2, u] = w0, wu, wv
        sums[3, u], sums[4, u], sums[5, u] = n0, nu, nuu
        sums[6, u], sums[7, u], sums[8, u] = nv, nuv, nvv


@kernel()
def _solve_row(sums, dv, v, camera, out_x, out_y, out_z):
    """Solve each window's normal equations for the plane's unit normal.

    With coordinates counted from the window's centre, 1/Z = (a du + b dv + c) / (n det). In the
    camera's x/z = (u - cx)/fx and y/z = (v - cy)/fy the coefficients are the normal's components,
    up to a factor; c has the sign of n·P at the centre pixel, where du = dv = 0.
    """
    fx, fy, cx, cy = camera
    for u in range(out_x.shape[0]):
        w = sums[0, u]
        wu = sums[1, u] - u * w
        wv = sums[2, u] - dv * w
        n = sums[3, u]
        nu = sums[4, u] - u * n
        nv = sums[6, u] - dv * n
        nuu = sums[5, u] - u * (sums[4, u] + nu)
        nuv = sums[7, u] - u * sums[6, u] - dv * nu
        nvv = sums[8, u] - dv * (sums[6, u] + nv)
        muu = n * nuu - nu * nu
        muv = n * nuv - nu * nv
        mvv = n * nvv - nv * nv
        bu = n * wu - nu * w
        bv = n * wv - nv * w
        det = muu * mvv - muv * muv
        a = mvv * bu - muv * bv
        b = muu * bv - muv * bu
        c = w * det - nu * a - nv * b
        x = n * a * fx
        y = n * b * fy
        z = c + n * a * (cx - u) + n * b * (cy - v)
        # All three are 0 where rounding has left nothing of very small inverse depths.
        square = x * x + y * y + z * z
        scale = 1 / np.sqrt(square) if (det > 0) & (square > 0) else 0.0
        if c < 0 or (c == 0 and z < 0):
            scale = -scale
        out_x[u] = x * scale
        out_y[u] = y * scale
        out_z[u] = z * scale


@kernel(void(float64[:, ::1], int64, int64, int64, _CAMERA, float64[:, :, ::1], int64))
def plane_block(inverse, first, last, radius, camera, out, out_first):
    """Write the unit normals of rows first..last-1 to out[:, first - out_first ...].

    Normals point away from the camera, n·P >= 0; (0, 0, 0) where no plane is determined.
    ``camera`` holds fx, fy, cx, cy.
    """
    height, width = inverse.shape
    columns = np.zeros((5, width))
    sums = np.empty((9, width))
    for row in range(max(0, first - radius), min(height, first + radius)):
        _add_row(inverse[row], row - first, 1.0, columns)
    for v in range(first, last):
        if v + radius < height:
            _add_row(inverse[v + radius], v + radius - first, 1.0, columns)
        if v > first and v - radius - 1 >= 0:
            _add_row(inverse[v - radius - 1], v - radius - 1 - first, -1.0, columns)
        _sum_windows(columns, radius, sums)
        row = v - out_first
        _solve_row(sums, v - first, v, camera, out[0, row], out[1, row], out[2, row])
