"""Whether points of a synthetic scene lie inside something: no rays, no roots, no windows."""

from __future__ import annotations

import numpy as np

from nimprep.synthetic.ground import Kerb, Pothole, Stretch, Strip
from nimprep.synthetic.scene import Scene
from nimprep.synthetic.solids import Ball, Box


def is_solid(scene: Scene, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Tell for points, each (n,) in the scene frame, whether the ground or a solid holds them."""
    solid = np.zeros(x.shape, dtype=bool)
    for piece in scene.ground:
        if isinstance(piece, Strip):
            here = (x > piece.left_m) & (x < piece.right_m) & _within(piece.stretch, z)
            solid |= here & (_above_road(piece.stretch, y, z) < piece.raised_m)
    for piece in scene.ground:
        if isinstance(piece, Pothole):
            squared = ((x - piece.x_m) / piece.radius_x_m) ** 2
            squared += ((z - piece.z_m) / piece.radius_z_m) ** 2
            here = (squared < 1) & _within(piece.stretch, z)
            above = _above_road(piece.stretch, y, z)
            solid &= ~(here & (above > -piece.depth_m * (1 - squared)))
        else:
            assert isinstance(piece, Strip | Kerb)
    for thing in scene.solids:
        centred = np.stack([x, y, z]) - np.array(thing.pose.centre)[:, None]
        a, b, c = np.array(thing.pose.axes) @ centred
        if isinstance(thing, Box):
            half = thing.half
            solid |= (abs(a) < half[0]) & (abs(b) < half[1]) & (abs(c) < half[2])
        elif isinstance(thing, Ball):
            solid |= a**2 + b**2 + c**2 < thing.radius_m**2
        else:
            solid |= (a**2 + c**2 < thing.radius_m**2) & (abs(b) < thing.half_length_m)
    return solid


def _within(stretch: Stretch, z: np.ndarray) -> np.ndarray:
    return (z >= stretch.near_m) & (z < stretch.far_m)


def _above_road(stretch: Stretch, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return stretch.offset_m + stretch.gradient * z - y
