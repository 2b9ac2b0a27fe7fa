"""Depth as another camera sees it, by the definition: every ray against every triangle."""

from __future__ import annotations

import numpy as np


def triangles(depth_m, camera, transform):
    """Return two triangles per pixel with depth, (n, 3, 3), in the other camera's frame."""
    found, depth = [], np.pad(depth_m.astype(float), 1)

    def inverse(v, u):
        return 1 / depth[v + 1, u + 1] if depth[v + 1, u + 1] > 0 else 0.0

    for v, u in np.argwhere(depth_m > 0):
        corners = []
        for dv, du in ((-1, -1), (-1, 1), (1, 1), (1, -1)):
            own, around = inverse(v, u), [inverse(v, u)]
            for step in ((dv, 0), (0, du), (dv, du)):
                other = inverse(v + step[0], u + step[1])
                opposite = inverse(v - step[0], u - step[1])
                on = opposite > 0 and abs(other + opposite - 2 * own) <= 0.05 * own / 4
                if other > 0 and (on or abs(other - own) <= 0.05 * own):
                    around.append(other)
            z = 1 / np.mean(around)
            x = (u + du / 2 - camera.cx) / camera.fx * z
            y = (v + dv / 2 - camera.cy) / camera.fy * z
            corners.append(transform[:3, :3] @ (x, y, z) + transform[:3, 3])
        found += [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
    return np.array(found)


def warped_depth(depth_m, camera, transform, target):
    """Return the depth of the first triangle that each pixel's ray meets; 0 = none."""
    a, b, c = triangles(depth_m, camera, transform).transpose(1, 0, 2)
    out = np.zeros((target.height, target.width))
    normal = np.cross(b - a, c - a)
    for v in range(target.height):
        for u in range(target.width):
            ray = np.array([(u - target.cx) / target.fx, (v - target.cy) / target.fy, 1])
            z = np.einsum("ij,ij->i", normal, a) / (normal @ ray)
            point = z[:, None] * ray
            sides = [
                np.einsum("ij,ij->i", normal, np.cross(q - p, point - p))
                for p, q in ((a, b), (b, c), (c, a))
            ]
            hit = (np.min(sides, axis=0) >= 0) & (z > 0)
            if hit.any():
                out[v, u] = z[hit].min()
    return out
