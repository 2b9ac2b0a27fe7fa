"""What stands on the ground: boxes, balls and cylinders, each exact.

A solid has its own frame: its centre as origin, and three axes of length 1 given in the scene
frame. Rays keep their parameter in it, so that a hit is still a z-depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nimprep.synthetic.shapes import (
    Array,
    Points,
    Rotation,
    Vector,
    points_from_vector,
    rotate,
    transposed,
)
from nimprep.synthetic.texture import Finish

CAMERA: Points = points_from_vector((0.0, 0.0, 0.0))
TOUCH_M = 1e-7
"""A ray that starts this near a surface does not meet it: shadows start on surfaces."""


@dataclass(frozen=True)
class Pose:
    """Place a solid: centre in the scene frame, metres, and its x, y (down) and z axes."""

    centre: Vector
    axes: Rotation

    def inward(self, origin: Points, direction: Points) -> tuple[Points, Points]:
        """Return rays of the scene frame in the solid's frame."""
        x, y, z = (origin[i] - self.centre[i] for i in range(3))
        return rotate(self.axes, (x, y, z)), rotate(self.axes, direction)

    def outward(self, directions: Points) -> Points:
        """Return directions of the solid's frame in the scene frame."""
        return rotate(transposed(self.axes), directions)

    def corners(self, half: Vector) -> list[Vector]:
        """Return the corners of the box of these half sizes, in the scene frame."""
        ends = [(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
        inside = np.array(ends, dtype=np.float64) * half
        x, y, z = self.outward((inside[:, 0], inside[:, 1], inside[:, 2]))
        corners = zip(x.tolist(), y.tolist(), z.tolist(), strict=True)
        cx, cy, cz = self.centre
        return [(cx + a, cy + b, cz + c) for a, b, c in corners]


@dataclass(frozen=True)
class Box:
    """Describe a box by its half sizes along its axes, metres."""

    pose: Pose
    half: Vector
    finish: Finish
    label: int

    def corners(self) -> list[Vector]:
        """Return eight points that enclose it."""
        return self.pose.corners(self.half)

    def distance(self, direction: Points, origin: Points = CAMERA) -> Array:
        """Return where rays enter; inf elsewhere."""
        start, ahead = self.pose.inward(origin, direction)
        spans = [_slab(start[i], ahead[i], self.half[i]) for i in range(3)]
        enter = np.maximum(np.maximum(spans[0][0], spans[1][0]), spans[2][0])
        leave = np.minimum(np.minimum(spans[0][1], spans[1][1]), spans[2][1])
        return np.where((enter <= leave) & (enter > TOUCH_M), enter, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals: those of the nearest face."""
        inside, _ = self.pose.inward(points, points)
        face = self._face(inside)
        x, y, z = (np.where(face == i, np.sign(inside[i]), 0.0) for i in range(3))
        return self.pose.outward((x, y, z))

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return coordinates along the face: upright faces have the height as the second."""
        inside, _ = self.pose.inward(points, points)
        face = self._face(inside)
        x, y, z = inside
        return np.where(face == 0, z, x), np.where(face == 1, z, y)

    def _face(self, inside: Points) -> Array:
        gaps = np.stack([np.abs(np.abs(inside[i]) - self.half[i]) for i in range(3)])
        face: Array = np.argmin(gaps, axis=0)
        return face


@dataclass(frozen=True)
class Ball:
    """Describe a sphere, metres."""

    pose: Pose
    radius_m: float
    finish: Finish
    label: int

    def corners(self) -> list[Vector]:
        """Return eight points that enclose it."""
        return self.pose.corners((self.radius_m, self.radius_m, self.radius_m))

    def distance(self, direction: Points, origin: Points = CAMERA) -> Array:
        """Return where rays enter; inf elsewhere."""
        (px, py, pz), (dx, dy, dz) = self.pose.inward(origin, direction)
        enter, _ = _roots(
            dx * dx + dy * dy + dz * dz,
            px * dx + py * dy + pz * dz,
            px * px + py * py + pz * pz - self.radius_m**2,
        )
        return np.where(enter > TOUCH_M, enter, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals."""
        x, y, z = (points[i] - self.pose.centre[i] for i in range(3))
        return x / self.radius_m, y / self.radius_m, z / self.radius_m

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return coordinates across and down."""
        (x, y, z), _ = self.pose.inward(points, points)
        return x + 0.7 * z, y


@dataclass(frozen=True)
class Cylinder:
    """Describe a cylinder about its y axis with flat ends, metres."""

    pose: Pose
    radius_m: float
    half_length_m: float
    finish: Finish
    label: int

    def corners(self) -> list[Vector]:
        """Return eight points that enclose it."""
        return self.pose.corners((self.radius_m, self.half_length_m, self.radius_m))

    def distance(self, direction: Points, origin: Points = CAMERA) -> Array:
        """Return where rays enter; inf elsewhere."""
        (px, py, pz), (dx, dy, dz) = self.pose.inward(origin, direction)
        round_enter, round_leave = _roots(
            dx * dx + dz * dz, px * dx + pz * dz, px * px + pz * pz - self.radius_m**2
        )
        flat_enter, flat_leave = _slab(py, dy, self.half_length_m)
        enter = np.maximum(round_enter, flat_enter)
        leave = np.minimum(round_leave, flat_leave)
        return np.where((enter <= leave) & (enter > TOUCH_M), enter, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals: those of the end or of the side, whichever is nearer."""
        (x, y, z), _ = self.pose.inward(points, points)
        radius = np.sqrt(x * x + z * z)
        end = np.abs(np.abs(y) - self.half_length_m) < np.abs(radius - self.radius_m)
        reach = np.where(end, np.inf, radius)
        return self.pose.outward((x / reach, np.where(end, np.sign(y), 0.0), z / reach))

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return coordinates across and along."""
        (x, y, z), _ = self.pose.inward(points, points)
        return x + 0.7 * z, y


def _slab(start: Array, ahead: Array, half: float) -> tuple[Array, Array]:
    """Return where rays enter and leave the space between two planes at -half and +half."""
    one, other = (-half - start) / ahead, (half - start) / ahead
    return np.minimum(one, other), np.maximum(one, other)


def _roots(a: Array, half_b: Array, c: Array) -> tuple[Array, Array]:
    """Return between which parameters a*t*t + 2*half_b*t + c < 0; (inf, -inf) where never."""
    square = half_b * half_b - a * c
    root = np.sqrt(np.maximum(square, 0))
    first, last = (-half_b - root) / a, (root - half_b) / a
    # a = 0: a ray along a cylinder's axis is inside everywhere or nowhere.
    along, met = (a == 0) & (c < 0), (a > 0) & (square >= 0)
    enter = np.where(along, -np.inf, np.where(met, first, np.inf))
    return enter, np.where(along, np.inf, np.where(met, last, -np.inf))
