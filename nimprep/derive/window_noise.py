"""What inverse depth leaves of planes in windows: noise, if no bent surface explains it better."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.kernels.inverse_depth_windows import window_moments

_ROWS, _COLUMNS = 12, 20
"""Windows over an image, down and across."""

_HALF = 16
"""Pixels from a window's centre to its side: windows of 33, and of 17 in their middle."""

_STEP = 2
_LEAST_SHARE = 0.6
_LEAST_WINDOWS = 32

_PLANE = ((0, 0), (1, 0), (0, 1))
_QUADRIC = (*_PLANE, (2, 0), (1, 1), (0, 2))

# The windows with the least left are those with a plane in them: a fifth of the image is enough.
_FLATTEST = 20

# Shares of real stereo and LiDAR, and of made noise: 0.76 to 1; of clean curved scenes 0.05 to
# 0.45. Growths of those: 1.0 to 2.0, and 3.6 to 6.
_LEAST_LEFT = 0.6
_MOST_GROWTH = 2.7

# What the flattest fifth leaves is less than what the image has: by trial on stereo frames of
# GMRP and KITTI, where the normals of roads are best with 1.4 times as much.
_WHOLE = 1.4


@dataclass(frozen=True)
class _Windows:
    """Hold what is left in each window, as standard deviations of inverse depth, 1/m."""

    of_plane: npt.NDArray[np.float64]
    of_quadric: npt.NDArray[np.float64]

    @property
    def plane(self) -> float:
        """What the flattest windows leave of a plane."""
        return float(np.percentile(self.of_plane, _FLATTEST))

    @property
    def quadric(self) -> float:
        """What they leave of a quadric."""
        return float(np.percentile(self.of_quadric, _FLATTEST))


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
    v, u = (
        np.unique(np.linspace(_HALF, size - 1 - _HALF, number).astype(np.int64))
        for size, number in ((height, _ROWS), (width, _COLUMNS))
    )
    centres = np.stack(np.meshgrid(v, u, indexing="ij"), axis=-1).reshape(-1, 2)
    large = _windows(depth_m, centres, _HALF)
    if large.of_plane.size < _LEAST_WINDOWS or large.quadric < _LEAST_LEFT * large.plane:
        return 0.0
    small = _windows(depth_m, centres, _HALF // 2)
    if small.of_plane.size == 0 or large.plane > _MOST_GROWTH * small.plane:
        return 0.0
    return _WHOLE * large.plane


def _windows(
    depth_m: npt.NDArray[np.float32], centres: npt.NDArray[np.int64], half: int
) -> _Windows:
    """Fit a plane and a quadric to each window that has depth enough."""
    moments, sums = np.zeros((len(centres), 2, 5, 5)), np.zeros((len(centres), 2))
    window_moments(depth_m, np.ascontiguousarray(centres), half, _STEP, moments, sums)
    pixels = (2 * half // _STEP + 1) ** 2
    enough = moments[:, 0, 0, 0] >= _LEAST_SHARE * pixels
    moments, squares = moments[enough], sums[enough, 0]
    plane, quadric = (_left(moments, squares, basis) for basis in (_PLANE, _QUADRIC))
    return _Windows(plane, quadric)


def _left(
    moments: npt.NDArray[np.float64],
    squares: npt.NDArray[np.float64],
    basis: tuple[tuple[int, int], ...],
) -> npt.NDArray[np.float64]:
    """Return the standard deviation that least squares by these x**a * y**b leaves."""
    products = np.empty((len(moments), len(basis), len(basis)))
    for i, (a, b) in enumerate(basis):
        for j, (c, d) in enumerate(basis):
            products[:, i, j] = moments[:, 0, a + c, b + d]
    right = np.stack([moments[:, 1, a, b] for a, b in basis], axis=-1)
    # Where the pixels lie in one line there is more than one such plane: any will do.
    count = moments[:, 0, 0, 0]
    products += 1e-13 * count[:, None, None] * np.eye(len(basis))
    fitted = np.linalg.solve(products, right[..., None])[..., 0]
    rest = np.maximum(squares - (fitted * right).sum(axis=-1), 0)
    left: npt.NDArray[np.float64] = np.sqrt(rest / np.maximum(count - len(basis), 1))
    return left
