"""Second differences of inverse depth on a grid of samples: what noise is estimated from."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)

SAMPLES = 24
"""Rows and columns of the grid of samples."""


@kernel(void(_DEPTH, int64[::1], int64[::1], float64[::1], float64[:, ::1], float64[:, ::1]))
def second_differences(
    depth_m: npt.NDArray[np.float32],
    lags: npt.NDArray[np.int64],
    counts: npt.NDArray[np.int64],
    medians: npt.NDArray[np.float64],
    bends: npt.NDArray[np.float64],
    inverses: npt.NDArray[np.float64],
) -> None:
    """Write |r(-lag) - 2 r + r(lag)| along u and along v, and r, where all three have depth.

    Of each lag: how many there are, the median of their ratio to r, and, in rows of 2 SAMPLES^2,
    they and r themselves.
    """
    height, width = depth_m.shape
    ratio = np.empty(2 * SAMPLES * SAMPLES)
    for k in range(lags.size):
        lag, found = lags[k], 0
        for j in range(SAMPLES):
            v = (2 * j + 1) * height // (2 * SAMPLES)
            for i in range(SAMPLES):
                u = (2 * i + 1) * width // (2 * SAMPLES)
                z = depth_m[v, u]
                if not z > 0:
                    continue
                r = 1 / float(z)
                for du, dv in ((lag, 0), (0, lag)):
                    if u < du or u + du >= width or v < dv or v + dv >= height:
                        continue
                    before, after = depth_m[v - dv, u - du], depth_m[v + dv, u + du]
                    if before > 0 and after > 0:
                        bend = abs(1 / float(before) - 2 * r + 1 / float(after))
                        bends[k, found], inverses[k, found] = bend, r
                        ratio[found] = bend / r
                        found += 1
        counts[k] = found
        medians[k] = np.median(ratio[:found]) if found > 0 else 0.0
