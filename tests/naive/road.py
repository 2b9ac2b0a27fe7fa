"""The road's vote and its profile, point by point, straight from the definitions."""

from __future__ import annotations

import math

import numpy as np


def vote(point, plane, bottom):
    """Return what a point (x, y, w) says of a plane (a, b, c)."""
    x, y, w = point
    a, b, c = plane
    road = a + b * x + c * y
    if road <= 0:
        return 0.0
    tolerance = 0.03 * road + 0.01 * (a + c * bottom)
    if abs(w - road) < tolerance:
        return 1 - ((w - road) / tolerance) ** 2
    return -0.25 if w < road else 0.0


def best_plane(x, y, w, triples, step, bottom, max_tilt):
    """Return the plane with most votes, and its score."""
    points = list(zip(x, y, w, strict=True))
    best, best_score = None, -1.0
    for triple in triples:
        chosen = np.array([points[i] for i in triple])
        corners = np.column_stack([np.ones(3), chosen[:, :2]])
        if abs(np.linalg.det(corners)) < 1e-15:
            continue
        plane = np.linalg.solve(corners, chosen[:, 2])
        a, b, c = plane
        if not (c > 0 and a + c * bottom > 0 and abs(b) <= max_tilt * c and a <= 4 * c):
            continue
        votes = [vote(point, plane, bottom) for point in points[::step]]
        if np.mean(votes) > best_score:
            best, best_score = plane, np.mean(votes)
    return best, best_score


def road_level(s, profile):
    """Return the road's disparity at s."""
    c0, c1, c2 = profile.coefficients
    for end, beyond in (
        (profile.span[0], s < profile.span[0]),
        (profile.span[1], s > profile.span[1]),
    ):
        if beyond:
            level = c0 + c1 * end + c2 * end**2 + (c1 + 2 * c2 * end) * (s - end)
            return max(level, 0)
    return max(c0 + c1 * s + c2 * s**2, 0)


def transformed(disparity, profile):
    """Return disparity less the road's; NaN where there is none."""
    roll = math.radians(profile.roll_deg)
    out = np.full(disparity.shape, np.nan)
    for v, u in np.argwhere(disparity > 0):
        s = v * math.cos(roll) + u * math.sin(roll)
        out[v, u] = disparity[v, u] - road_level(s, profile)
    return out
