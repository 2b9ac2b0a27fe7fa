"""HHA by the definition: one window at a time, least squares by NumPy."""

from __future__ import annotations

import math

import numpy as np


def normals(depth_m, camera, missing, radius):
    """Return the normals (H, W, 3), NaN where the window's points lie on one line."""
    height, width = depth_m.shape
    counts = (depth_m > 0) & ~missing
    out = np.full((height, width, 3), np.nan)
    for v in range(height):
        for u in range(width):
            rows, columns, inverse = [], [], []
            for i in range(max(0, v - radius), min(height, v + radius + 1)):
                for j in range(max(0, u - radius), min(width, u + radius + 1)):
                    if counts[i, j]:
                        rows.append((j - camera.cx) / camera.fx)
                        columns.append((i - camera.cy) / camera.fy)
                        inverse.append(1 / depth_m[i, j])
            out[v, u] = _plane(np.array(rows), np.array(columns), np.array(inverse), v, u, camera)
    return out


def _plane(x, y, inverse, v, u, camera):
    if len(x) < 3:
        return math.nan
    spread = np.linalg.svd(np.stack([x - x.mean(), y - y.mean()]), compute_uv=False)
    if spread[1] < 1e-9:
        return math.nan
    normal = np.linalg.lstsq(np.stack([x, y, np.ones_like(x)], axis=1), inverse, rcond=None)[0]
    normal /= np.linalg.norm(normal)
    if normal[2] < 0:
        normal = -normal
    ray = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0
    return -normal if normal @ ray < 0 else normal


def gravity(depth_m, camera, missing):
    """Return the direction of gravity, (3,)."""
    found = normals(depth_m, camera, missing, 10).reshape(-1, 3)
    found = found[~np.isnan(found[:, 0])]
    direction = np.array([0.0, 1.0, 0.0])
    for degrees in [45] * 5 + [15] * 5:
        walls_less_floors = np.zeros((3, 3))
        for normal in found:
            angle = math.degrees(math.acos(min(1.0, abs(normal @ direction))))
            if angle < degrees:
                walls_less_floors -= np.outer(normal, normal)
            if 90 - angle < degrees:
                walls_less_floors += np.outer(normal, normal)
        vector = np.linalg.eigh(walls_less_floors)[1][:, 0]
        direction = vector if vector @ direction >= 0 else -vector
    return direction


def encode_hha(depth_m, camera, missing, down):
    """Return HHA (H, W, 3) uint8 for a known direction of gravity; depth in double."""
    found = normals(depth_m, camera, missing, 3)
    heights = np.full(depth_m.shape, np.inf)
    for v, u in zip(*np.nonzero(depth_m), strict=True):
        ray = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0
        heights[v, u] = -100 * depth_m[v, u] * (down @ ray)
    lowest = heights.min()
    if lowest > -90:
        lowest = -130
    out = np.zeros((*depth_m.shape, 3), np.uint8)
    for v, u in zip(*np.nonzero(depth_m), strict=True):
        angle = 180.0
        if not np.isnan(found[v, u, 0]):
            angle = math.degrees(math.acos(max(-1.0, min(1.0, found[v, u] @ down))))
        channels = 31000 / max(100 * depth_m[v, u], 100), heights[v, u] - lowest, angle + 38
        out[v, u] = [min(max(round(channel), 0), 255) for channel in channels]
    return out
