"""Find the road in an image: the fit that the road's profile and the road's plane share.

On a plane, disparity and inverse depth are linear in the pixel coordinates u and v. A few hundred
planes through three pixels each are put to the vote, and the best one is fitted by least squares to
the pixels near it, which are found anew after each fit. Random numbers come from a fixed seed: the
same image gives the same road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.kernels.road_fit import best_plane, normal_equations, residuals

MAX_ROLL_DEG = 30.0
"""A plane whose level lines are tilted more against the image's rows is taken for a wall."""

_POINTS = 1 << 14
_THINNING = 4
_VOTERS = 1 << 11
_TRIPLES = 1000
_LEAST_POINTS = 30
_LEAST_SCORE = 0.1
_ROUNDS = 40
_WIDE_ROUNDS = 6

Vector = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RoadPoints:
    """Hold a grid of the image's pixels that have a value, from the top row down.

    Attributes
    ----------
    x, y : (N,) float64
        Coordinates, 0 in the image's middle, in units of half its height.
    values : (N,) float64
        Disparity, pixels, or inverse depth, 1/metres.
    middle : (float, float)
        u and v of the image's middle, pixels.
    unit : float
        Half the image's height, pixels.
    """

    x: Vector
    y: Vector
    values: Vector
    middle: tuple[float, float]
    unit: float


@dataclass(frozen=True)
class Road:
    """Describe the road in the coordinates of `RoadPoints`: r0 + r1 s + r2 s², s = y + tilt x.

    Attributes
    ----------
    tilt : float
    levels : (3,) float64
        r0, r1, r2.
    span : (float, float)
        Least and largest s of the pixels on the road.
    """

    tilt: float
    levels: Vector
    span: tuple[float, float]

    def slope(self, s: float) -> float:
        """Return by how much the road's value grows per s."""
        return float(self.levels[1] + 2 * self.levels[2] * s)


def grid_points(image: npt.NDArray[np.float32], *, inverse: bool = False) -> RoadPoints:
    """Take a grid of about 10000 pixels of (H, W), without those that are 0.

    In the outer quarters of the image it is four times as wide: the road that the camera is on lies
    ahead. On real streets pavements and verges, some centimetres higher, else tilted the plane.

    Parameters
    ----------
    inverse : bool
        Whether 1 / value is wanted.
    """
    height, width = image.shape
    step = max(int(math.sqrt(image.size / _POINTS)), 1)
    middle, unit = ((width - 1) / 2, (height - 1) / 2), max(height / 2, 1.0)
    # From the last row upwards: it sees the road where any row does.
    rows = np.arange((height - 1) % step, height, step)
    columns = np.arange(step // 2, width, step)
    inner = np.abs(columns - middle[0]) <= width / 4
    columns = columns[inner | (np.arange(len(columns)) % _THINNING == 0)]
    part = image[np.ix_(rows, columns)]
    v, u = np.nonzero(part)
    values = part[v, u].astype(np.float64)
    x, y = (columns[u] - middle[0]) / unit, (rows[v] - middle[1]) / unit
    return RoadPoints(x, y, 1 / values if inverse else values, middle, unit)


def find_road(points: RoadPoints, *, curved: bool) -> Road | None:
    """Return the road, a plane or, where `curved`, with a quadratic profile; None = none found."""
    count = len(points.values)
    if count < _LEAST_POINTS:
        return None
    data = points.x, points.y, points.values
    triples = np.random.default_rng(0).integers(0, count, (_TRIPLES, 3))
    step, bottom = -(-count // _VOTERS), points.middle[1] / points.unit
    (a, b, c), score = best_plane(
        *data, triples, step, bottom, math.tan(math.radians(MAX_ROLL_DEG))
    )
    if score < _LEAST_SCORE:
        return None
    start = Road(b / c, np.array([a, c, 0.0]), (0.0, 0.0))
    road = _refined(points, start, bottom, curved)
    if curved and road is not None and road.slope(road.span[0]) <= 0:
        # A road that is nearer the farther up it is seen: the parabola fits something else.
        road = _refined(points, start, bottom, curved=False)
    return road


def _refined(points: RoadPoints, road: Road, bottom: float, curved: bool) -> Road | None:
    """Fit to the pixels near the road, over and over until it stays."""
    data = points.x, points.y, points.values
    apart, sums = np.empty(len(points.values)), np.empty((4, 5))
    floor = road.levels[0] + road.levels[1] * bottom
    tilt, levels, within = road.tilt, road.levels, np.inf
    for number in range(_ROUNDS):
        wide = number < _WIDE_ROUNDS
        residuals(*data, tilt, (*levels.tolist(), 0.0), floor, apart)
        near = np.abs(apart[~np.isnan(apart)])
        if len(near) < _LEAST_POINTS:
            return None
        # 3 standard deviations, by the median; the least is what rounding to float32 leaves.
        within = np.inf if wide else max(3 * 1.4826 * float(np.median(near)), 1e-6 * floor)
        if normal_equations(*data, tilt, apart, within, sums) < _LEAST_POINTS:
            return None
        terms = [0, 1, 2, 3] if curved and number > 1 else [0, 1, 3]
        found = np.zeros(4)
        try:
            found[terms] = np.linalg.solve(sums[np.ix_(terms, terms)], sums[terms, 4])
        except np.linalg.LinAlgError:
            # The pixels near it lie on one line.
            return None
        if not found[1] > 0:
            return None
        before, tilt, levels = (tilt, levels), tilt + found[3] / found[1], found[:3]
        moved = abs(tilt - before[0]) + np.abs(levels - before[1]).max() / floor
        if not wide and moved < 1e-9:
            break
    s = (points.y + tilt * points.x)[np.abs(apart) <= within]
    return Road(float(tilt), levels, (float(s.min()), float(s.max())))
