"""What inverse depth leaves of planes in windows: noise, if no bent surface explains it better."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from nimprep.derive.percentile import percentile
from nimprep.kernels.inverse_depth_windows import fit_left, window_moments

_ROWS, _COLUMNS = 12, 20
"""Windows over an image, down and across."""

_HALF = 16
"""Pixels from a window's centre to its side: windows of 33, and of 17 in their middle."""

_STEP = 2
_LEAST_SHARE = 0.6
_LEAST_WINDOWS = 32

# Terms of what is fitted, see `fit_left`.
_PLANE, _QUADRIC = 3, 6

# The windows with the least left are those with a plane in them: a fifth of the image is enough.
_FLATTEST = 20

# Shares of real stereo and LiDAR, and of made noise: 0.76 to 1; of clean curved scenes 0.05 to
# 0.45. Growths of those: 1.0 to 2.0, and 3.6 to 6.
_LEAST_LEFT = 0.6
_MOST_GROWTH = 2.7

# What the flattest fifth leaves is less than what the image has: by trial on stereo frames of
# GMRP and KITTI, where the normals of roads are best with 1.4 times as much.
WHOLE = 1.4


@dataclass(frozen=True)
class _Windows:
    """Hold what `window_moments` writes of the windows that have depth enough."""

    moments: npt.NDArray[np.float64]
    sums: npt.NDArray[np.float64]

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.sums)

    def left(self, terms: int) -> float:
        """Return what is left by a plane or a quadric in the flattest ones, 1/m."""
        left = np.empty(self.count)
        fit_left(self.moments, self.sums, terms, left)
        return percentile(left, _FLATTEST)


def sigma_in_windows(depth_m: npt.NDArray[np.float32]) -> float:
    """Return the standard deviation of inverse depth about planes in windows, 1/m; 0 = no noise.

    Noise is left over by a quadric nearly as much as by a plane, and in a window of 33 pixels not
    much more than in one of 17; what is left over on a bent surface, the shape, is neither.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        0 = none; as `checked_depth` returns it.
    """
    height, width = depth_m.shape
    if min(height, width) <= 2 * _HALF:
        return 0.0
    centres = _centres(height, width)
    large = _windows(depth_m, centres, _HALF)
    if large.count < _LEAST_WINDOWS:
        return 0.0
    plane = large.left(_PLANE)
    if large.left(_QUADRIC) < _LEAST_LEFT * plane:
        return 0.0
    small = _windows(depth_m, centres, _HALF // 2)
    if small.count == 0 or plane > _MOST_GROWTH * small.left(_PLANE):
        return 0.0
    return WHOLE * plane


@lru_cache(maxsize=8)
def _centres(height: int, width: int) -> npt.NDArray[np.int64]:
    """Return windows' centres, (N, 2); kept, as making them took a third of the time."""
    v, u = (
        np.unique(np.linspace(_HALF, size - 1 - _HALF, number).astype(np.int64))
        for size, number in ((height, _ROWS), (width, _COLUMNS))
    )
    centres = np.stack(np.meshgrid(v, u, indexing="ij"), axis=-1).reshape(-1, 2)
    centres.flags.writeable = False
    return centres


def _windows(
    depth_m: npt.NDArray[np.float32], centres: npt.NDArray[np.int64], half: int
) -> _Windows:
    """Return the moments of the windows that have depth enough."""
    moments, sums = np.zeros((len(centres), 2, 5, 5)), np.zeros((len(centres), 2))
    window_moments(depth_m, centres, half, _STEP, moments, sums)
    pixels = (2 * half // _STEP + 1) ** 2
    enough = moments[:, 0, 0, 0] >= _LEAST_SHARE * pixels
    if not enough.all():
        moments, sums = moments[enough], sums[enough]
    return _Windows(moments, sums)
