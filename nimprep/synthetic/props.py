"""Things that stand on the ground: obstacles, street furniture, walls."""

from __future__ import annotations

import math

import numpy as np

from nimprep.synthetic.scene import BACKGROUND, Solid
from nimprep.synthetic.shapes import Rotation, Vector, unit
from nimprep.synthetic.solids import Ball, Box, Cylinder, Pose
from nimprep.synthetic.texture import Colour, Finish, Pattern

SUNK_M = 0.02
"""Things reach this far into the ground, so that no light passes below them."""

UPRIGHT: Vector = (0.0, -1.0, 0.0)

PAINTS: tuple[Colour, ...] = (
    (0.46, 0.30, 0.16),
    (0.80, 0.25, 0.04),
    (0.08, 0.18, 0.55),
    (0.70, 0.70, 0.68),
    (0.55, 0.05, 0.05),
    (0.10, 0.40, 0.15),
    (0.75, 0.60, 0.08),
    (0.05, 0.05, 0.06),
)
"""Cardboard, traffic orange, blue, white, red, green, yellow, tyre black."""


def obstacle(
    rng: np.random.Generator, base: Vector, upward: Vector, size_m: float, label: int
) -> Solid:
    """Draw a box, a ball, or a cylinder, upright or lying, of about this half size.

    Parameters
    ----------
    rng : numpy.random.Generator
        Decides kind, shape, heading and colour.
    base : Vector
        Where it touches the ground, scene frame, metres.
    upward : Vector
        The ground's unit normal there.
    size_m : float
        Half of its largest extent, about.
    label : int
        Its class.
    """
    axes = _axes(upward, rng.uniform(0, 2 * math.pi))
    kind = int(rng.integers(0, 4))
    finish = _paint(rng, size_m)
    if kind == 0:
        half = (size_m, size_m * rng.uniform(0.3, 1.0), size_m * rng.uniform(0.4, 1.0))
        return Box(Pose(_above(base, upward, half[1] - SUNK_M), axes), half, finish, label)
    if kind == 1:
        radius = 0.7 * size_m
        return Ball(Pose(_above(base, upward, radius - SUNK_M), axes), radius, finish, label)
    if kind == 2:
        centre = _above(base, upward, size_m - SUNK_M)
        return Cylinder(Pose(centre, axes), size_m * rng.uniform(0.25, 0.6), size_m, finish, label)
    radius = size_m * rng.uniform(0.2, 0.4)
    lying = (axes[1], axes[0], axes[2])
    pose = Pose(_above(base, upward, radius - SUNK_M), lying)
    return Cylinder(pose, radius, size_m, finish, label)


def roadside(rng: np.random.Generator, base: Vector, label: int) -> list[Solid]:
    """Draw a post, a bin, or a tree; they stand upright wherever the ground is above SUNK_M."""
    axes = _axes(UPRIGHT, rng.uniform(0, 2 * math.pi))
    kind = int(rng.integers(0, 3))
    if kind == 0:
        height = rng.uniform(0.8, 3.5)
        finish = _paint(rng, 0.3)
        return [Cylinder(Pose(base, axes), rng.uniform(0.04, 0.09), height, finish, label)]
    if kind == 1:
        half = (rng.uniform(0.2, 0.4), rng.uniform(0.4, 0.9), rng.uniform(0.2, 0.4))
        return [
            Box(Pose(_above(base, UPRIGHT, half[1] - 0.1), axes), half, _paint(rng, 0.5), label)
        ]
    bark = Finish(Pattern.LEAVES, (0.09, 0.06, 0.04), (0.20, 0.15, 0.10))
    leaves = Finish(Pattern.LEAVES, (0.04, 0.10, 0.02), (0.14, 0.22, 0.05))
    trunk, crown = rng.uniform(0.08, 0.18), rng.uniform(0.6, 1.2)
    top = rng.uniform(1.8, 2.6)
    return [
        Cylinder(Pose(base, axes), trunk, top, bark, label),
        Ball(Pose(_above(base, UPRIGHT, top + 0.7 * crown), axes), crown, leaves, label),
    ]


def wall(
    rng: np.random.Generator,
    foot: tuple[float, float],
    half: tuple[float, float],
    ground_m: float,
) -> Box:
    """Draw a wall of brick or plaster, or a hedge.

    Parameters
    ----------
    rng : numpy.random.Generator
        Decides height and look.
    foot, half : (x, z), metres
        Centre and half sizes of its outline.
    ground_m : float
        The y of the ground; the wall also reaches 8 m below it, as the road may sink.
    """
    height, sunk = rng.uniform(1.0, 5.0), 8.0
    kind = int(rng.integers(0, 3))
    if kind == 0:
        finish = Finish(Pattern.BRICKS, (0.36, 0.17, 0.11), (0.45, 0.42, 0.38), 0.24)
    elif kind == 1:
        shade = rng.uniform(0.35, 0.7)
        plaster = (shade, shade * rng.uniform(0.85, 1.0), shade * rng.uniform(0.7, 0.95))
        finish = Finish(Pattern.PLAIN, plaster, plaster)
    else:
        finish = Finish(Pattern.LEAVES, (0.03, 0.08, 0.02), (0.12, 0.18, 0.05))
        height = min(height, 2.5)
    centre = (foot[0], ground_m + (sunk - height) / 2, foot[1])
    axes = _axes(UPRIGHT, 0.0)
    return Box(Pose(centre, axes), (half[0], (sunk + height) / 2, half[1]), finish, BACKGROUND)


def _paint(rng: np.random.Generator, size_m: float) -> Finish:
    """Draw one colour, or bands of two."""
    colour, accent = (PAINTS[int(rng.integers(0, len(PAINTS)))] for _ in range(2))
    pattern = Pattern.BANDS if rng.random() < 0.3 else Pattern.PLAIN
    return Finish(pattern, colour, accent, size_m * rng.uniform(0.25, 0.6))


def _axes(upward: Vector, heading: float) -> Rotation:
    """Return axes of which y points down along the ground's normal, turned about it."""
    down = (-upward[0], -upward[1], -upward[2])
    # Ground never leans sideways, so that the scene's x is level on it.
    ahead = unit((0.0, -down[2], down[1]))
    c, s = math.cos(heading), math.sin(heading)
    right = (c, -s * ahead[1], -s * ahead[2])
    return right, down, (s, c * ahead[1], c * ahead[2])


def _above(base: Vector, upward: Vector, height_m: float) -> Vector:
    x, y, z = (b + height_m * n for b, n in zip(base, upward, strict=True))
    return x, y, z
