"""The ground: stretches of road of one gradient each, raised sides, kerbs and potholes.

Every surface answers `distance` for rays from the camera (the scene frame's origin), and for
points on it `normal` and `texture`: two coordinates along the surface, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nimprep.synthetic.shapes import Array, Mask, Points, Vector, normalized, unit
from nimprep.synthetic.texture import Finish

SEAM_M = 1e-9
"""Neighbouring pieces overlap by this much: rounding lets no ray slip between them."""


@dataclass(frozen=True)
class Stretch:
    """Describe the road's level y(z) = offset_m + gradient * z from near_m to far_m.

    y points down, so a negative gradient climbs.
    """

    near_m: float
    far_m: float
    offset_m: float
    gradient: float

    @property
    def upward(self) -> Vector:
        """Unit normal of the road."""
        return unit((0.0, -1.0, self.gradient))

    def level_m(self, z_m: float) -> float:
        """Return the road's y at a z."""
        return self.offset_m + self.gradient * z_m

    def distance(self, direction: Points, raised_m: float = 0.0) -> Array:
        """Return where rays meet the endless plane this far above the road."""
        result: Array = (self.offset_m - raised_m) / (direction[1] - self.gradient * direction[2])
        return result

    def spans(self, z: Array) -> Mask:
        """Tell which z belong to this stretch."""
        result: Mask = (z >= self.near_m - SEAM_M) & (z <= self.far_m + SEAM_M)
        return result


@dataclass(frozen=True)
class Pothole:
    """Describe a depression in the road: a paraboloid of elliptic outline.

    Its floor lies depth_m * (1 - rho**2) below the road, rho being 1 on the rim.
    """

    stretch: Stretch
    x_m: float
    z_m: float
    radius_x_m: float
    radius_z_m: float
    depth_m: float
    finish: Finish
    label: int

    def covers(self, x: Array, z: Array) -> Mask:
        """Tell which points of the road's plane are cut out by the pothole."""
        across, along = (x - self.x_m) / self.radius_x_m, (z - self.z_m) / self.radius_z_m
        result: Mask = across * across + along * along < 1
        return result

    def corners(self) -> list[Vector]:
        """Return eight points that enclose it."""
        return [
            (self.x_m + i * self.radius_x_m, self.stretch.level_m(z) + sunk, z)
            for z in (self.z_m - self.radius_z_m, self.z_m + self.radius_z_m)
            for i in (-1, 1)
            for sunk in (0.0, self.depth_m)
        ]

    def distance(self, direction: Points) -> Array:
        """Return where rays that enter the outline meet the floor; inf elsewhere.

        What lies above the floor is convex, so that a ray leaves it at the larger root of the
        quadratic.
        """
        dx, dy, dz = direction
        sinking = dy - self.stretch.gradient * dz
        opening = self.stretch.offset_m / sinking
        inside = (opening > 0) & self.covers(opening * dx, opening * dz)
        across, along = dx / self.radius_x_m, dz / self.radius_z_m
        centre_x, centre_z = self.x_m / self.radius_x_m, self.z_m / self.radius_z_m
        a = self.depth_m * (across * across + along * along)
        b = sinking - 2 * self.depth_m * (across * centre_x + along * centre_z)
        c = self.depth_m * (centre_x**2 + centre_z**2 - 1) - self.stretch.offset_m
        root = (np.sqrt(np.maximum(b * b - 4 * a * c, 0)) - b) / (2 * a)
        return np.where(inside, root, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals of the floor."""
        x, y, z = points
        slope_x = -2 * self.depth_m / self.radius_x_m**2 * (x - self.x_m)
        slope_z = -2 * self.depth_m / self.radius_z_m**2 * (z - self.z_m)
        return normalized((slope_x, np.full_like(y, -1.0), slope_z + self.stretch.gradient))

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return coordinates along the ground."""
        return points[0], points[2]


@dataclass(frozen=True)
class Strip:
    """Describe the ground between two x: the road itself, or what runs along it, raised or not."""

    stretch: Stretch
    left_m: float
    right_m: float
    finish: Finish
    label: int
    raised_m: float = 0.0
    potholes: tuple[Pothole, ...] = ()

    def corners(self) -> None:
        """Return nothing: the ground may be anywhere in the image."""

    def distance(self, direction: Points) -> Array:
        """Return where rays meet the strip outside its potholes; inf elsewhere."""
        t = self.stretch.distance(direction, self.raised_m)
        x, z = t * direction[0], t * direction[2]
        met = (t > 0) & (x >= self.left_m - SEAM_M) & (x <= self.right_m + SEAM_M)
        met &= self.stretch.spans(z)
        for pothole in self.potholes:
            met &= ~pothole.covers(x, z)
        return np.where(met, t, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals, all alike."""
        x, y, z = (np.full_like(points[0], component) for component in self.stretch.upward)
        return x, y, z

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return x from the middle of the strip, and z."""
        return points[0] - (self.left_m + self.right_m) / 2, points[2]


@dataclass(frozen=True)
class Kerb:
    """Describe the upright face between the road and a raised side."""

    stretch: Stretch
    x_m: float
    raised_m: float
    facing: int
    finish: Finish
    label: int

    def corners(self) -> None:
        """Return nothing: a kerb may be anywhere in the image."""

    def distance(self, direction: Points) -> Array:
        """Return where rays meet the face; inf elsewhere."""
        t = self.x_m / direction[0]
        z = t * direction[2]
        above = self.stretch.offset_m + self.stretch.gradient * z - t * direction[1]
        met = (t > 0) & (above >= -SEAM_M) & (above <= self.raised_m + SEAM_M)
        return np.where(met & self.stretch.spans(z), t, np.inf)

    def normal(self, points: Points) -> Points:
        """Return unit normals, +x or -x as the face looks."""
        zeros = np.zeros_like(points[0])
        return np.full_like(points[0], float(self.facing)), zeros, zeros

    def texture(self, points: Points) -> tuple[Array, Array]:
        """Return z and y."""
        return points[2], points[1]
