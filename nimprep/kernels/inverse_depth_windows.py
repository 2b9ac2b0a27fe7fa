"""Moments of inverse depth in square windows: what planes and quadrics are fitted to them by."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_CENTRES = types.Array(int64, 2, "C", readonly=True)

DEGREE = 4
"""Of the moments: those of x**a * y**b with a + b up to it, in the order of `MOMENTS`."""

MOMENTS = [(a, b) for a in range(DEGREE + 1) for b in range(DEGREE + 1 - a)]
"""The exponents (a, b)."""

WIDTH = DEGREE + 1


@kernel(inline=True)
def _first(depth_m: npt.NDArray[np.float32], v0: int, u0: int, half: int, step: int) -> float:
    """Return the inverse depth of a window's first pixel with depth; 0 = there is none."""
    for j in range(-half, half + 1, step):
        for i in range(-half, half + 1, step):
            z = depth_m[v0 + j, u0 + i]
            if z > 0:
                return 1 / float(z)
    return 0.0


# Sums in any order: one after the other they took three times as long.
@kernel(
    void(_DEPTH, _CENTRES, int64, int64, float64[:, :, :, ::1], float64[:, ::1]),
    fastmath={"contract", "arcp", "nsz", "reassoc"},
)
def window_moments(
    depth_m: npt.NDArray[np.float32],
    centres: npt.NDArray[np.int64],
    half: int,
    step: int,
    moments: npt.NDArray[np.float64],
    sums: npt.NDArray[np.float64],
) -> None:
    """Write sums over the pixels with depth of windows of every `step`-th pixel.

    x and y run from -1 to 1 over a window, r is inverse depth less that of the window's first
    pixel with depth, which keeps what is small beside it. Of each window: in moments[k, 0] those
    of x**a * y**b and in moments[k, 1] those of r * x**a * y**b (a + b up to 2 are written), at
    [a, b]; in sums[k] those of r**2, and the inverse depth that was taken off.
    """
    number = 2 * half // step + 1
    # Made once: made row by row they took a third of the time.
    row, r_row, depth = np.zeros(WIDTH), np.zeros(3), np.zeros(number)
    across = np.empty(number)
    for i in range(number):
        across[i] = (i * step - half) / half
    for k in range(centres.shape[0]):
        v0, u0 = centres[k, 0], centres[k, 1]
        moments[k] = 0.0
        squares, first = 0.0, _first(depth_m, v0, u0, half, step)
        for j in range(-half, half + 1, step):
            y = j / half
            for i in range(number):
                depth[i] = depth_m[v0 + j, u0 - half + i * step]
            s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
            r0, r1, r2 = 0.0, 0.0, 0.0
            for i in range(number):
                z, x = depth[i], across[i]
                some = 1.0 if z > 0 else 0.0
                r = some / (z if z > 0 else 1.0) - some * first
                x2 = x * x
                s0 += some
                s1 += some * x
                s2 += some * x2
                s3 += some * (x2 * x)
                s4 += some * (x2 * x2)
                r0 += r
                r1 += r * x
                r2 += r * x2
                squares += r * r
            row[0], row[1], row[2], row[3], row[4] = s0, s1, s2, s3, s4
            r_row[0], r_row[1], r_row[2] = r0, r1, r2
            power = 1.0
            for b in range(WIDTH):
                for a in range(WIDTH - b):
                    moments[k, 0, a, b] += row[a] * power
                if b < 3:
                    for a in range(3 - b):
                        moments[k, 1, a, b] += r_row[a] * power
                power *= y
        sums[k, 0], sums[k, 1] = squares, first


@kernel(inline=True)
def _exponents(k: int) -> tuple[int, int]:
    """Return (a, b) of the k-th term x**a * y**b: those of a plane first, then a quadric's."""
    if k < 3:
        return (1, 0) if k == 1 else (0, 1 if k == 2 else 0)
    return (5 - k, k - 3)


@kernel(void(float64[:, :, :, ::1], float64[:, ::1], int64, float64[::1]))
def fit_left(
    moments: npt.NDArray[np.float64],
    sums: npt.NDArray[np.float64],
    terms: int,
    out: npt.NDArray[np.float64],
) -> None:
    """Write the standard deviation that least squares by the first `terms` terms leave.

    Of what `window_moments` writes; 3 terms are a plane, 6 a quadric. By Cholesky: where the pixels
    lie in one line there is more than one such plane, and any will do.
    """
    lower = np.zeros((terms, terms))
    forward = np.zeros(terms)
    for k in range(moments.shape[0]):
        count = moments[k, 0, 0, 0]
        least = 1e-13 * max(count, 1.0)
        rest = sums[k, 0]
        for i in range(terms):
            a, b = _exponents(i)
            value = moments[k, 1, a, b]
            for j in range(i + 1):
                c, d = _exponents(j)
                product = moments[k, 0, a + c, b + d]
                if i == j:
                    product += least
                for m in range(j):
                    product -= lower[i, m] * lower[j, m]
                if i == j:
                    lower[i, i] = np.sqrt(max(product, least))
                else:
                    lower[i, j] = product / lower[j, j]
            for m in range(i):
                value -= lower[i, m] * forward[m]
            forward[i] = value / lower[i, i]
            # What is explained is the square of the solved half.
            rest -= forward[i] * forward[i]
        out[k] = np.sqrt(max(rest, 0.0) / max(count - terms, 1.0))
