"""Depth as another camera sees it: each pixel a small surface, the nearest of them is seen.

A pixel's surface is the quadrilateral of its corners; a corner's inverse depth is the mean of the
pixels around it that belong to the same surface. Inverse depth is linear in an image of a plane, so
that planes come out exactly, without holes where the other image has more pixels.
"""

from __future__ import annotations

import numpy as np
from numba import float32, float64, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_NUMBERS = types.Array(float64, 1, "C", readonly=True)
_TRANSFORM = types.Array(float64, 2, "C", readonly=True)

_STEP = 0.05
"""Neighbours that differ by more of a pixel's inverse depth lie on surfaces of their own, unless
they go on as the one on its other side does: near the horizon, a road's rows are further apart."""

_MARGIN = 0.05
"""Pixels by which a surface is drawn larger: neighbours' corners may differ by that little."""

_WIDEST = 256
"""A surface that covers more pixels of a row or column is none: depth next to the lens."""


@kernel()
def _inverse_at(depth, v, u):
    """Return a pixel's inverse depth; 0 where it has none or lies outside."""
    if 0 <= v < depth.shape[0] and 0 <= u < depth.shape[1] and depth[v, u] > 0:
        return 1.0 / depth[v, u]
    return 0.0


@kernel()
def _inverse_at_corner(depth, v, u, down, right):
    """Return the inverse depth of a pixel's corner, down and right of its centre or not (1, -1)."""
    own = 1.0 / depth[v, u]
    total, count = own, 1
    for i in range(1, 4):
        rows, columns = down * (i & 1), right * (i >> 1)
        other = _inverse_at(depth, v + rows, u + columns)
        if other > 0:
            opposite = _inverse_at(depth, v - rows, u - columns)
            on = opposite > 0 and abs(other + opposite - 2 * own) <= _STEP * own / 4
            if on or abs(other - own) <= _STEP * own:
                total += other
                count += 1
    return total / count


@kernel()
def _outside(ax, ay, bx, by, px, py, turn):
    """Return how far a point lies outside an edge, pixels; negative = inside."""
    length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
    across = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
    return -turn * across / max(length, 1e-12)


@kernel()
def _draw(corners, a, b, c, out):
    """Write a triangle's inverse depth to the pixels that it covers, where it is the nearest."""
    ax, ay, bx, by = corners[a, 0], corners[a, 1], corners[b, 0], corners[b, 1]
    cx, cy = corners[c, 0], corners[c, 1]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    left, right = min(ax, bx, cx) - _MARGIN, max(ax, bx, cx) + _MARGIN
    top, bottom = min(ay, by, cy) - _MARGIN, max(ay, by, cy) + _MARGIN
    height, width = out.shape
    seen = right >= 0 and bottom >= 0 and left <= width - 1 and top <= height - 1
    if not seen or abs(area) < 1e-12 or max(right - left, bottom - top) > _WIDEST:
        return
    turn = 1.0 if area > 0 else -1.0
    for v in range(max(0, int(np.ceil(top))), min(height - 1, int(np.floor(bottom))) + 1):
        for u in range(max(0, int(np.ceil(left))), min(width - 1, int(np.floor(right))) + 1):
            off = max(
                _outside(ax, ay, bx, by, u, v, turn),
                _outside(bx, by, cx, cy, u, v, turn),
                _outside(cx, cy, ax, ay, u, v, turn),
            )
            if off > _MARGIN:
                continue
            of_b = ((u - ax) * (cy - ay) - (v - ay) * (cx - ax)) / area
            of_c = ((bx - ax) * (v - ay) - (by - ay) * (u - ax)) / area
            inverse = (1 - of_b - of_c) * corners[a, 2] + of_b * corners[b, 2]
            inverse += of_c * corners[c, 2]
            out[v, u] = max(out[v, u], np.float32(inverse))


@kernel(void(_DEPTH, _NUMBERS, _TRANSFORM, _NUMBERS, float32[:, ::1]))
def draw_inverse_depth(depth, camera, transform, target, out):
    """Write the inverse depth that another camera sees of a depth image, 1/metre; 0 = none.

    ``camera`` and ``target`` are fx, fy, cx, cy, pixels; ``transform`` (3, 4) goes from the one's
    frame to the other's, metres.
    """
    out[:] = 0
    corners = np.empty((4, 3))
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if not depth[v, u] > 0:
                continue
            seen = True
            for i in range(4):
                # In a circle: up left, up right, down right, down left.
                right, down = 1 if i in (1, 2) else -1, 1 if i >= 2 else -1
                z = 1.0 / _inverse_at_corner(depth, v, u, down, right)
                x = (u + 0.5 * right - camera[2]) / camera[0] * z
                y = (v + 0.5 * down - camera[3]) / camera[1] * z
                t = transform
                there = t[2, 0] * x + t[2, 1] * y + t[2, 2] * z + t[2, 3]
                if not there > 1e-6:
                    seen = False
                    break
                across = t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3]
                along = t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3]
                corners[i, 0] = target[0] * across / there + target[2]
                corners[i, 1] = target[1] * along / there + target[3]
                corners[i, 2] = 1.0 / there
            if seen:
                _draw(corners, 0, 1, 2, out)
                _draw(corners, 0, 2, 3, out)
