"""Filling by the definition: every pixel against every known one."""

from __future__ import annotations

import itertools
import math

import numpy as np


def fill_nearest(depth_m):
    """Return the filled depth; of several equally near the left-most, then the upper."""
    known = np.argwhere(depth_m > 0)
    out = depth_m.copy()
    for v, u in np.argwhere(depth_m == 0):
        i, j = min(known, key=lambda p: ((p[0] - v) ** 2 + (p[1] - u) ** 2, p[1], p[0]))
        out[v, u] = depth_m[i, j]
    return out


def delaunay_triangles(points):
    """Return every triangle (a, b, c), counter-clockwise, whose circle holds no other point."""
    found = []
    for a, b, c in itertools.combinations(range(len(points)), 3):
        area = turn(points[a], points[b], points[c])
        if area == 0:
            continue
        corners = (a, b, c) if area > 0 else (a, c, b)
        if not inside_circle(*points[list(corners)], points).any():
            found.append(corners)
    return found


def turn(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def inside_circle(a, b, c, points):
    """Tell for each point whether it lies strictly inside the circle of a, b, c."""
    rows = [corner - points for corner in (a, b, c)]
    x, y = zip(*((row[:, 0], row[:, 1]) for row in rows), strict=True)
    square = [i * i + j * j for i, j in zip(x, y, strict=True)]
    return (
        square[0] * (x[1] * y[2] - y[1] * x[2])
        + square[1] * (x[2] * y[0] - y[2] * x[0])
        + square[2] * (x[0] * y[1] - y[0] * x[1])
    ) > 0


def linear_values(depth_m):
    """Return, per unknown pixel in a triangle, the values of all triangles it may be filled from.

    Points on one circle can be triangulated in several ways; each is a correct answer.
    """
    points = np.argwhere(depth_m > 0)
    values = {}
    for a, b, c in delaunay_triangles(points):
        pa, pb, pc = points[a], points[b], points[c]
        area = turn(pa, pb, pc)
        for pixel in np.argwhere(depth_m == 0):
            weights = turn(pb, pc, pixel), turn(pc, pa, pixel), turn(pa, pb, pixel)
            if min(weights) >= 0:
                depths = (depth_m[tuple(p)] for p in (pa, pb, pc))
                value = sum(w * float(z) for w, z in zip(weights, depths, strict=True)) / area
                values.setdefault(tuple(pixel), []).append(value)
    return values


def fill_colorization(depth_m, gray, alpha=1.0):
    """Return the filled depth from one dense system over all pixels; grey from 0 to 1."""
    height, width = depth_m.shape
    matrix = np.zeros((height * width, height * width))
    right = np.zeros(height * width)
    for v, u in np.ndindex(height, width):
        around = [
            (i, j)
            for i in range(max(0, v - 1), min(height, v + 2))
            for j in range(max(0, u - 1), min(width, u + 2))
            if (i, j) != (v, u)
        ]
        differences = np.array([(gray[p] - gray[v, u]) ** 2 for p in around])
        spread = 0.6 * np.var([gray[p] for p in [*around, (v, u)]])
        spread = max(spread, -differences.min() / math.log(0.01), 0.000002)
        weights = np.exp(-differences / spread)
        row = v * width + u
        for (i, j), weight in zip(around, weights / weights.sum(), strict=True):
            matrix[row, i * width + j] = -weight
        matrix[row, row] = 1
        if depth_m[v, u] > 0:
            matrix[row, row] += alpha
            right[row] = alpha * depth_m[v, u]
    solved = np.linalg.solve(matrix, right).reshape(height, width)
    return np.where(depth_m > 0, depth_m, solved)
