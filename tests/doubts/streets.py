"""Depth of a street that is known exactly: a flat road, and a wall across it."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera

CAMERA = Camera(110.0, 110.0, 63.5, 47.5, 128, 96)


def street(
    camera: Camera = CAMERA, *, height_m: float = 1.2, pitch_deg: float = 8.0, wall_m: float = 9.0
) -> npt.NDArray[np.float32]:
    """Return (H, W) depth, metres, seen by a camera this high that looks down by so much."""
    v = np.arange(camera.height)
    down, pitch = (v - camera.cy) / camera.fy, math.radians(pitch_deg)
    below = down * math.cos(pitch) + math.sin(pitch)
    ahead = math.cos(pitch) - down * math.sin(pitch)
    road = np.where(below > 1e-9, height_m / np.maximum(below, 1e-9), np.inf)
    depth = np.minimum(road, wall_m / ahead)
    return np.repeat(depth[:, None], camera.width, axis=1).astype(np.float32)


def rough_street(scale: float = 1000.0, seed: int = 0) -> npt.NDArray[np.uint16]:
    """Return the street's raw values, `scale` to a metre, with a sensor's noise of 1 %."""
    depth = street()
    noise = np.random.default_rng(seed).normal(0, 0.01, depth.shape)
    return np.rint(depth * (1 + noise) * scale).astype(np.uint16)
