"""Roads with exact depth: a plane below the camera, with upright boards standing on it."""

from __future__ import annotations

import numpy as np

from nimprep import Camera

CAMERA = Camera(fx=180.0, fy=170.0, cx=118.4, cy=88.7, width=240, height=180)

ROADS = {
    "flat": (0.0, 8.0, 1.6),
    "downhill": (0.0, -4.0, 1.2),
    "uphill": (0.0, 25.0, 0.6),
    "rolled": (9.0, 10.0, 1.0),
    "rolled far": (-24.0, 14.0, 0.8),
}
"""Roll and pitch, degrees, and height, metres, of the camera over the road."""


def plane_of(roll_deg, pitch_deg, height_m):
    """Return the road's plane: its upward normal in the camera frame, and the camera's height.

    A roll turns the camera's right side down, a pitch turns it to look down.
    """
    roll, pitch = np.radians(roll_deg), np.radians(pitch_deg)
    down = [np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch), np.sin(pitch)]
    return np.array([*(-x for x in down), height_m])


def rays(camera):
    """Return P / Z of every pixel, (H, W, 3)."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=-1)


def road_depth(plane, camera=CAMERA, farthest_m=60.0):
    """Return the road's depth, (H, W) float64; 0 above the horizon and beyond the farthest."""
    inverse = -(rays(camera) @ plane[:3]) / plane[3]
    return np.where(inverse > 1 / farthest_m, 1 / np.maximum(inverse, 1e-9), 0)


def with_boards(depth, share, seed=0, camera=CAMERA):
    """Put boards that face the camera on the road until they hide this share of its pixels.

    It may become a tenth more. Returns the depth, and which of the road's pixels are hidden.
    """
    rng = np.random.default_rng(seed)
    road = depth > 0
    scene, hidden = depth.copy(), np.zeros(depth.shape, bool)
    v, u = np.mgrid[: camera.height, : camera.width]
    while hidden[road].mean() < share:
        foot_v, foot_u = (int(rng.integers(n)) for n in depth.shape)
        foot = depth[foot_v, foot_u]
        if foot == 0:
            continue
        high, wide = rng.uniform(0.1, 1.8) * camera.fy, rng.uniform(0.2, 1.5) * camera.fx
        board = (v <= foot_v) & (v > foot_v - high / foot) & (np.abs(u - foot_u) < wide / foot / 2)
        board &= (scene == 0) | (scene > foot)
        if (hidden | board)[road].mean() < share + 0.1:
            scene[board] = foot
            hidden |= board
    return scene, hidden & road
