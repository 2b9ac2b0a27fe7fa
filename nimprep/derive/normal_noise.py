"""How much of an image's normals is noise: of those that the paper's method makes of its depth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.coarse_road import coarse_road_plane
from nimprep.derive.noise import estimate_noise
from nimprep.kernels.inverse_depth_noise import SAMPLES, second_differences
from nimprep.kernels.normals import nim_rows

_LEAST_SAMPLES = 64
_LEAST_ROAD_PIXELS = 100

# As `nimprep.derive.noise` has it: half of the second differences of normal errors are below this
# many standard deviations of one error.
_MEDIAN_OF_BEND = math.sqrt(6) * 0.6745

_ROWS, _COLUMNS = 64, 320
"""Rows that normals are made of, and pixels of each that are looked at."""

# What lies this near to the road's plane is road: metres, and metres more per metre of distance,
# as the height of a noisy point is off by its error along the ray.
_ROAD_M, _ROAD_PER_M = 0.02, 0.01


@dataclass(frozen=True)
class NormalNoise:
    """Say how noisy the depth of an image is, and what that makes of its normals.

    Attributes
    ----------
    relative : float
        Median over the image of the standard deviation of inverse depth by inverse depth: the share
        of the distance that depth is off by. 0 = no noise is found; NaN = too few pixels have
        neighbours with depth, so that none could be.
    expected_deg : float
        By how much normals of the method "nim" are turned on a plane that faces the camera at the
        median distance, degrees: what next neighbours differ by tells it, as "nim" takes the
        difference of these alone; NaN as `relative`.
    roughness_deg : float
        Median angle of the road's normals, by "nim", to their median; NaN where there is no road.
    """

    relative: float
    expected_deg: float
    roughness_deg: float


def normal_noise(depth_m: npt.NDArray[np.float32], camera: Camera) -> NormalNoise:
    """Measure the noise of an image and of its normals, on some thousand of its pixels.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        0 = none; as `checked_depth` returns it.
    """
    expected = _expected_deg(depth_m, camera)
    relative = math.nan if math.isnan(expected) else estimate_noise(depth_m).relative
    return NormalNoise(relative, expected, _roughness_deg(depth_m, camera))


def _expected_deg(depth_m: npt.NDArray[np.float32], camera: Camera) -> float:
    lags, counts, medians = np.ones(1, np.int64), np.empty(1, np.int64), np.empty(1)
    bends, inverses = np.empty((2, 1, 2 * SAMPLES**2))
    second_differences(depth_m, lags, counts, medians, bends, inverses)
    if counts[0] < _LEAST_SAMPLES:
        return math.nan
    # Half the difference of two neighbours has 1 / sqrt(2) of an error, and a plane that faces the
    # camera has n_z = r where n_x = f g_u.
    error = float(medians[0]) / _MEDIAN_OF_BEND / math.sqrt(2)
    return math.degrees(math.atan(max(camera.fx, camera.fy) * error))


def _roughness_deg(depth_m: npt.NDArray[np.float32], camera: Camera) -> float:
    plane = coarse_road_plane(depth_m, camera)
    if plane is None:
        return math.nan
    height, width = depth_m.shape
    rows = np.unique(np.linspace(0, height - 1, _ROWS).astype(np.intp))
    columns = np.unique(np.linspace(0, width - 1, _COLUMNS).astype(np.intp))
    depth = depth_m[np.ix_(rows, columns)].astype(np.float64)
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    toward = plane[0] * x[None, :] + plane[1] * y[:, None] + plane[2]
    above = np.abs(toward * depth + plane[3])
    road = (depth > 0) & (above < _ROAD_M + _ROAD_PER_M * depth)
    if np.count_nonzero(road) < _LEAST_ROAD_PIXELS:
        return math.nan
    # Of a whole image's memory only the rows that are written to are ever there.
    normals = np.empty((height, 3 * width), np.float32)
    for row in rows[road.any(axis=1)]:
        nim_rows(depth_m, row, row + 1, camera.fx, camera.fy, camera.cx, camera.cy, False, normals)
    v, u = np.nonzero(road)
    found = normals.reshape(height, width, 3)[rows[v], columns[u]].astype(np.float64)
    middle = np.median(found, axis=0)
    cosines = found @ (middle / max(float(np.linalg.norm(middle)), 1e-9))
    return float(np.degrees(np.median(np.arccos(np.clip(cosines, -1, 1)))))
