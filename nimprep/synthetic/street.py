"""Random streets: a road with a change of gradient, raised sides, and things in the way."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nimprep.synthetic.ground import Kerb, Pothole, Stretch, Strip
from nimprep.synthetic.props import obstacle, roadside, wall
from nimprep.synthetic.scene import ANOMALY, BACKGROUND, DRIVABLE, Ground, Light, Scene, Solid
from nimprep.synthetic.shapes import rotation_from_angles, unit
from nimprep.synthetic.texture import Colour, Finish, Pattern

ENDLESS_M = 500.0


@dataclass(frozen=True)
class _Road:
    """Hold what the parts of a street share; y is down, z ahead, metres."""

    near: Stretch
    far: Stretch
    left_m: float
    right_m: float
    yaw_deg: float
    height_m: float

    def stretch_at(self, z_m: float) -> Stretch:
        return self.near if z_m < self.near.far_m else self.far


def random_street(rng: np.random.Generator) -> Scene:
    """Draw a street.

    The camera hangs 0.3 to 1.5 m above the road, between its kerbs, and looks along it to within
    12 degrees.

    Parameters
    ----------
    rng : numpy.random.Generator
        Decides everything; scenes of equal generators are equal.
    """
    height = rng.uniform(0.3, 1.5)
    yaw = rng.uniform(-12, 12)
    pitch = rng.uniform(-3, 9) + 7 * height
    rotation = rotation_from_angles(yaw, pitch, rng.uniform(-3, 3))
    road = _road(rng, height, yaw)
    taken: list[tuple[float, float, float]] = []
    potholes = _potholes(rng, road, taken)
    solids = [*_obstacles(rng, road, taken), *_surroundings(rng, road)]
    return Scene(rotation, _ground(rng, road, potholes), tuple(solids), _light(rng))


def _road(rng: np.random.Generator, height_m: float, yaw_deg: float) -> _Road:
    """Draw the road's level and its edges."""
    bend = rng.uniform(5, 18)
    gradient = rng.uniform(-0.10, 0.06) if rng.random() < 0.75 else 0.0
    near = Stretch(-ENDLESS_M, bend, height_m, 0.0)
    far = Stretch(bend, ENDLESS_M, height_m - gradient * bend, gradient)
    width = rng.uniform(2.4, 7.0)
    middle = rng.uniform(-0.3, 0.3) * width
    return _Road(near, far, middle - width / 2, middle + width / 2, yaw_deg, height_m)


def _ground(rng: np.random.Generator, road: _Road, potholes: list[Pothole]) -> tuple[Ground, ...]:
    """Draw what the ground is made of; everything lies in both stretches."""
    grey = rng.uniform(0.10, 0.24)
    asphalt = _tinted(rng, (grey, grey, 1.03 * grey), 0.015)
    line = (0.75, 0.75, 0.72) if rng.random() < 0.4 else asphalt
    finish = Finish(Pattern.ROAD, asphalt, line, rng.uniform(1.5, 4))
    stone = Finish(Pattern.PLAIN, _tinted(rng, (0.45, 0.44, 0.42), 0.05), (0, 0, 0))
    pieces: list[Ground] = []
    sides = [_side_finish(rng) for _ in range(2)]
    raised = [rng.uniform(0.06, 0.18) if rng.random() < 0.8 else 0.0 for _ in range(2)]
    for stretch in (road.near, road.far):
        holes = tuple(hole for hole in potholes if hole.stretch == stretch)
        pieces.append(Strip(stretch, road.left_m, road.right_m, finish, DRIVABLE, 0.0, holes))
        edges = ((road.left_m, -ENDLESS_M, 1), (road.right_m, ENDLESS_M, -1))
        for side, lift, (edge, end, facing) in zip(sides, raised, edges, strict=True):
            # A kerb stone's width of the side is the stone's colour.
            inner = edge - 0.15 * facing
            for a, b, look in ((edge, inner, stone), (inner, end, side)):
                low, high = min(a, b), max(a, b)
                pieces.append(Strip(stretch, low, high, look, BACKGROUND, lift))
            if lift > 0:
                pieces.append(Kerb(stretch, edge, lift, facing, stone, BACKGROUND))
    return (*pieces, *potholes)


def _side_finish(rng: np.random.Generator) -> Finish:
    """Draw what lies beside the road: grass or paving."""
    if rng.random() < 0.5:
        return Finish(Pattern.LEAVES, (0.06, 0.13, 0.03), (0.17, 0.24, 0.07))
    stone = (0.42, 0.37, 0.31) if rng.random() < 0.5 else (0.38, 0.22, 0.16)
    pattern = Pattern.TILES if rng.random() < 0.5 else Pattern.BRICKS
    return Finish(pattern, _tinted(rng, stone, 0.05), (0.16, 0.14, 0.12), rng.uniform(0.2, 0.5))


def _potholes(
    rng: np.random.Generator, road: _Road, taken: list[tuple[float, float, float]]
) -> list[Pothole]:
    """Draw up to three potholes, each whole and inside one stretch of the road."""
    gravel = Finish(Pattern.LEAVES, (0.10, 0.085, 0.07), (0.22, 0.19, 0.15))
    potholes: list[Pothole] = []
    for _ in range(int(rng.integers(0, 4))):
        rx, rz = rng.uniform(0.12, 0.45), rng.uniform(0.12, 0.45)
        depth = rng.uniform(0.12, 0.3) * min(rx, rz)
        spot = _free_spot(rng, road, max(rx, rz), taken)
        if spot is not None:
            x, z = spot
            stretch = road.stretch_at(z)
            potholes.append(Pothole(stretch, x, z, rx, rz, depth, gravel, ANOMALY))
    return potholes


def _obstacles(
    rng: np.random.Generator, road: _Road, taken: list[tuple[float, float, float]]
) -> list[Solid]:
    """Draw one to four things that lie on the road, or fewer where it is too narrow."""
    solids: list[Solid] = []
    for _ in range(int(rng.integers(1, 5))):
        size = rng.uniform(0.08, 0.4)
        spot = _free_spot(rng, road, 1.5 * size, taken)
        if spot is not None:
            x, z = spot
            stretch = road.stretch_at(z)
            base = (x, stretch.level_m(z), z)
            solids.append(obstacle(rng, base, stretch.upward, size, ANOMALY))
    return solids


def _free_spot(
    rng: np.random.Generator,
    road: _Road,
    radius_m: float,
    taken: list[tuple[float, float, float]],
) -> tuple[float, float] | None:
    """Draw an (x, z) on the road in view, clear of its edges, its bend and what is there already.

    None where the road is too crowded; a spot found is noted as taken.
    """
    for _ in range(20):
        z = 0.9 + radius_m + 0.8 * road.height_m + rng.random() ** 2 * 8
        x = z * (math.tan(math.radians(road.yaw_deg)) + rng.uniform(-0.55, 0.55))
        on_road = road.left_m + radius_m < x < road.right_m - radius_m
        clear_of_bend = abs(z - road.near.far_m) > radius_m
        apart = all(math.hypot(x - a, z - b) > radius_m + r + 0.05 for a, b, r in taken)
        if on_road and clear_of_bend and apart:
            taken.append((x, z, radius_m))
            return x, z
    return None


def _surroundings(rng: np.random.Generator, road: _Road) -> list[Solid]:
    """Draw walls along the sides and across the end, and things beside the road."""
    solids: list[Solid] = []
    for edge, outward in ((road.left_m, -1), (road.right_m, 1)):
        pavement = rng.uniform(0.8, 3.5)
        if rng.random() < 0.65:
            near, far = rng.uniform(-3, 8), rng.uniform(15, 60)
            foot = (edge + outward * (pavement + 0.5), (near + far) / 2)
            solids.append(wall(rng, foot, (0.5, (far - near) / 2), road.height_m))
        for _ in range(int(rng.integers(0, 3))):
            z = rng.uniform(3, 16)
            x = edge + outward * rng.uniform(0.45, max(0.5, pavement - 0.3))
            stretch = road.stretch_at(z)
            solids.extend(roadside(rng, (x, stretch.level_m(z), z), BACKGROUND))
    if rng.random() < 0.5:
        foot = ((road.left_m + road.right_m) / 2, rng.uniform(12, 45))
        solids.append(wall(rng, foot, (30.0, 0.5), road.height_m))
    return solids


def _light(rng: np.random.Generator) -> Light:
    """Draw the weather: from clear to overcast."""
    clouds = rng.uniform(0, 1)
    around, elevation = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(30, 65))
    to_sun = unit(
        (
            math.cos(elevation) * math.cos(around),
            -math.sin(elevation),
            math.cos(elevation) * math.sin(around),
        )
    )
    direct = 1.5 * (1 - 0.8 * clouds)
    diffuse = 0.45 + 0.5 * clouds
    zenith = _mixed((0.16, 0.34, 0.72), (0.62, 0.66, 0.70), clouds)
    horizon = _mixed((0.62, 0.74, 0.85), (0.74, 0.76, 0.78), clouds)
    return Light(
        to_sun=to_sun,
        sun=(direct, 0.94 * direct, 0.82 * direct),
        ambient=(0.93 * diffuse, 0.98 * diffuse, 1.05 * diffuse),
        zenith=zenith,
        horizon=horizon,
        skyline=_tinted(rng, (0.11, 0.17, 0.12), 0.03),
        skyline_height=rng.uniform(0.03, 0.14),
        clouds=clouds,
    )


def _mixed(first: Colour, second: Colour, share: float) -> Colour:
    a, b, c = (x + share * (y - x) for x, y in zip(first, second, strict=True))
    return a, b, c


def _tinted(rng: np.random.Generator, colour: Colour, spread: float) -> Colour:
    a, b, c = (max(x + rng.uniform(-spread, spread) * 0.5, 0.01) for x in colour)
    return a, b, c
