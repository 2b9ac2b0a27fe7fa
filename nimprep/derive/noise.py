"""How noisy a depth image is, told from the image itself."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.derive.percentile import median
from nimprep.derive.window_noise import WHOLE, sigma_in_windows
from nimprep.kernels.inverse_depth_noise import SAMPLES, second_differences

LAGS = (1, 2, 4, 8, 16, 32)
"""Distances in pixels at which second differences of inverse depth are taken."""

_LEAST_SAMPLES = 64

# A second difference of independent errors has sqrt(6) times their standard deviation; of a normal
# distribution's absolute values half are below 0.6745 standard deviations.
_MEDIAN_OF_BEND = math.sqrt(6) * 0.6745

# From one lag to twice that, second differences grow four times on a curved surface, 1.4 times
# across steps at random, and not at all in noise of neighbours too far apart to be alike.
_LEVEL = 1.35

# A sensor's errors are never all smooth: rounding and matching leave some that differ from pixel to
# pixel (a D415's full second differences are 25 times those of neighbours). Clutter is smooth.
_SMOOTHEST = 50

# Errors farther apart than this share of the full noise's second differences count as independent.
_APART = 0.7

# The two halves of the samples, by distance, tell how noise grows only if they differ by this much.
_HALVES_APART = 1.2


@dataclass(frozen=True)
class DepthNoise:
    """Describe the noise of a depth image, as errors of inverse depth r.

    Attributes
    ----------
    sigma : float
        Standard deviation of r, 1/m: at every distance alike where `power` is 0, as a stereo
        camera's is, else that at r = 1/m.
    power : {0, 2}
        The standard deviation is sigma * r**power. 2 = depth's own is the same at every distance,
        as rounding to millimetres makes it.
    length : float
        Distance in pixels from which on errors are independent, at least 1.
    relative : float
        Median over the image of the standard deviation of r by r.
    flat : float
        Where most of the image is no plane: the standard deviation of r where it is one, 1/m, as
        far as `sigma` has more of it. 0 = most of it is planes.
    """

    sigma: float
    power: int
    length: float
    relative: float
    flat: float = 0.0


NO_NOISE = DepthNoise(0.0, 0, 1.0, 0.0)


@dataclass(frozen=True)
class _Bends:
    """Hold absolute second differences of inverse depth at one lag, and inverse depth itself."""

    lag: int
    bend: npt.NDArray[np.float64]
    inverse: npt.NDArray[np.float64]
    relative: float


def estimate_noise(depth_m: npt.NDArray[np.float32], least: float = 0.0) -> DepthNoise:
    """Estimate the noise of a depth image from inverse depth, which is linear on planes.

    Its second differences are 0 on a plane at any lag, so that their median tells noise where
    planes are most of the image. Where they grow with the lag without end, trees and walls are most
    of it: then noise is what the flattest windows leave of a plane, unless a quadric explains it,
    which is the shape of surfaces.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        0 = none; as `checked_depth` returns it.
    least : float
        Smallest `relative` that matters: less is returned as no noise at all.
    """
    bends = _bends(depth_m)
    level = _levels(bends)
    if True not in level:
        return _in_windows(depth_m, bends, least)
    last = len(level) - 1 - level[::-1].index(True)
    first = last
    while first > 0 and level[first - 1]:
        first -= 1
    full = bends[first + 1]
    relative = full.relative / _MEDIAN_OF_BEND
    if relative <= least or full.relative > _SMOOTHEST * bends[0].relative:
        return NO_NOISE
    sigma, power = _law(full)
    length = _length(bends[: first + 2], _APART * full.relative)
    return DepthNoise(sigma, power, length, relative)


def _in_windows(depth_m: npt.NDArray[np.float32], bends: list[_Bends], least: float) -> DepthNoise:
    """Return the noise that windows tell of, at every distance alike."""
    sigma = sigma_in_windows(depth_m) if bends else 0.0
    noise = _of_sigma(bends, sigma, sigma / WHOLE) if sigma > 0 else NO_NOISE
    return noise if noise.relative > least else NO_NOISE


def noise_of_sigma(depth_m: npt.NDArray[np.float32], sigma: float) -> DepthNoise:
    """Return the noise of one standard deviation of inverse depth, 1/m, at every distance."""
    bends = _bends(depth_m) if sigma > 0 else []
    if not bends:
        return NO_NOISE
    return _of_sigma(bends, sigma, 0.0 if True in _levels(bends) else sigma)


def _levels(bends: list[_Bends]) -> list[bool]:
    """Return from which lags to their doubles second differences do not grow."""
    return [
        after.relative < _LEVEL * before.relative for before, after in itertools.pairwise(bends)
    ]


def _of_sigma(bends: list[_Bends], sigma: float, flat: float) -> DepthNoise:
    relative = sigma * median(1 / bends[0].inverse)
    reached = relative * _MEDIAN_OF_BEND * _APART
    return DepthNoise(sigma, 0, _length(bends, reached), relative, flat)


def _bends(depth_m: npt.NDArray[np.float32]) -> list[_Bends]:
    """Return the second differences of as many lags as have samples enough."""
    lags, counts = np.array(LAGS), np.empty(len(LAGS), np.int64)
    medians = np.empty(len(LAGS))
    bends, inverses = np.empty((2, len(LAGS), 2 * SAMPLES**2))
    second_differences(depth_m, lags, counts, medians, bends, inverses)
    enough = itertools.takewhile(lambda k: counts[k] >= _LEAST_SAMPLES, range(len(LAGS)))
    return [
        _Bends(LAGS[k], bends[k, : counts[k]], inverses[k, : counts[k]], float(medians[k]))
        for k in enough
    ]


def _law(bends: _Bends) -> tuple[float, int]:
    """Return sigma and power that describe second differences of independent errors."""
    middle = median(bends.inverse)
    far, near = bends.inverse < middle, bends.inverse >= middle
    if far.any():
        apart = median(bends.inverse[near]) / median(bends.inverse[far])
        low, high = median(bends.bend[far]), median(bends.bend[near])
        # Nearer to apart**2 than to 1.
        if apart > _HALVES_APART and high > low * apart:
            return median(bends.bend / bends.inverse**2) / _MEDIAN_OF_BEND, 2
    return median(bends.bend) / _MEDIAN_OF_BEND, 0


def _length(bends: list[_Bends], reached: float) -> float:
    """Return the lag at which the medians first reach a value, interpolated; 1 if they never do."""
    before = None
    for one in bends:
        if one.relative >= reached:
            if before is None or before.relative <= 0:
                return float(one.lag)
            share = math.log(reached / before.relative) / math.log(one.relative / before.relative)
            return float(before.lag * (one.lag / before.lag) ** share)
        before = one
    return 1.0
