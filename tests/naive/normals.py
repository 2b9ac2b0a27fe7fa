"""NIM's normals pixel by pixel, straight from the equations, in float64."""

from __future__ import annotations

import math

import numpy as np

LEFT, RIGHT, UP, DOWN = (-1, 0), (1, 0), (0, -1), (0, 1)


def point(depth, camera, u, v):
    """Return P = (X, Y, Z) of pixel (u, v)."""
    z = float(depth[v, u])
    return ((u - camera.cx) * z / camera.fx, (v - camera.cy) * z / camera.fy, z)


def has_depth(depth, u, v):
    height, width = depth.shape
    return 0 <= u < width and 0 <= v < height and depth[v, u] > 0


def inverse_depth_difference(depth, u, v, before, after):
    """Return g along one axis: central, or one-sided and doubled, or 0."""
    here = 1 / float(depth[v, u])
    one = has_depth(depth, u + before[0], v + before[1])
    other = has_depth(depth, u + after[0], v + after[1])
    back = 1 / float(depth[v + before[1], u + before[0]]) if one else here
    front = 1 / float(depth[v + after[1], u + after[0]]) if other else here
    return (front - back) * (1 if one and other else 2)


def candidates(depth, camera, u, v):
    """Return the unit candidates of pixel (u, v), as the equations leave them: not oriented."""
    n_x = camera.fx * inverse_depth_difference(depth, u, v, LEFT, RIGHT)
    n_y = camera.fy * inverse_depth_difference(depth, u, v, UP, DOWN)
    found = []
    if n_x == 0 and n_y == 0:
        return found
    x, y, z = point(depth, camera, u, v)
    for du, dv in (LEFT, RIGHT, UP, DOWN):
        if not has_depth(depth, u + du, v + dv):
            continue
        x_i, y_i, z_i = point(depth, camera, u + du, v + dv)
        if z_i == z:
            continue
        n_z = -(n_x * (x_i - x) + n_y * (y_i - y)) / (z_i - z)
        length = math.sqrt(n_x**2 + n_y**2 + n_z**2)
        found.append((n_x / length, n_y / length, n_z / length))
    return found


def with_majority_sign(found):
    """Keep the candidates whose n_z has the majority's sign; all where none has a sign."""
    positive = [n for n in found if n[2] > 0]
    negative = [n for n in found if n[2] < 0]
    if not positive and not negative:
        return found
    return positive if len(positive) >= len(negative) else negative


def estimate_normals(depth, camera, sign_filter=False):
    """Return (H, W, 3) float64 normals of (H, W) depth in metres, 0 = none."""
    height, width = depth.shape
    out = np.zeros((height, width, 3))
    for v in range(height):
        for u in range(width):
            if not has_depth(depth, u, v):
                continue
            if not any(has_depth(depth, u + du, v + dv) for du, dv in (LEFT, RIGHT, UP, DOWN)):
                continue
            found = candidates(depth, camera, u, v)
            if sign_filter:
                found = with_majority_sign(found)
            total = np.sum(found, axis=0) if found else np.array([0.0, 0.0, -1.0])
            if np.dot(total, point(depth, camera, u, v)) > 0:
                total = -total
            out[v, u] = total / np.linalg.norm(total)
    return out
