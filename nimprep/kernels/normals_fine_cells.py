"""Planes of cells half as wide, where those of `normals_cells` miss what is there; see there.

A plane fitted to 7 x 7 cells is the best there is on a surface as large, and wrong by more than
noise on smaller ones. So each quarter of a cell gets a plane too, fitted to the 3 x 3 quarters
around it: less than a quarter as wide, and noisier by the square of that. The two planes' slopes
should differ by the noise of the smaller one. Means of that difference over 3 x 3 quarters have
little noise, and what is left of it is squared and taken over 5 x 5: where that is more than noise
explains, the quarter has its own plane; else its cell's.
"""

from __future__ import annotations

import numpy as np
from numba import float32, int64, void

from nimprep.compilation.decorator import kernel
from nimprep.kernels.inverse_depth_gradient import (
    FASTMATH,
    NO_PLANE,
    ONE,
    TINY,
    ZERO,
    Image,
    Row,
    noise_floor,
)
from nimprep.kernels.normals_cells import (
    BLOCK,
    FEW,
    INVERSE,
    REACH,
    RIDGE,
    SLOPE,
    STRIDE,
    WITHIN2,
    Noise,
    tap,
    variance_of_mean,
)

AROUND = 2
"""How many quarters to each side the squared difference of slopes is averaged over."""

ROUNDS = 2

# Where, in strides, the gradients and energies of the cells' planes begin, and what is compared.
CELL, ODD = 4, 7

# A slope's variance goes with the fourth power of the width it is fitted over: 3 quarters, and 5
# once slopes of 3 x 3 are averaged.
AVERAGED = np.float32((3 / 5) ** 4)

# Three standard deviations.
APART2, MOST = np.float32(9), np.float32(1e6)


@kernel(void(float32[:, :, ::1], int64, int64, int64, float32[:, :, ::1]), fastmath=FASTMATH)
def merged_means(fine: Image, row_start: int, row_stop: int, side: int, out: Image) -> None:
    """Write rows of what `cell_means` writes for cells of four, `side` pixels wide each."""
    offset = np.float32(0.5 * side)
    for row in range(row_start, row_stop):
        for i in range(out.shape[2] - 2 * REACH):
            share, right, down, total = ZERO, ZERO, ZERO, ZERO
            for j in range(2):
                for k in range(2):
                    v, u = REACH + 2 * row + j, REACH + 2 * i + k
                    x, y = (offset if k else -offset), (offset if j else -offset)
                    some = fine[0, v, u]
                    share += some
                    right += some * (fine[1, v, u] + x)
                    down += some * (fine[2, v, u] + y)
                    total += some * fine[3, v, u]
            known = share > np.float32(0.5)
            per = ONE / max(share, TINY)
            out[0, row + REACH, i + REACH] = np.float32(0.25) * share if known else ZERO
            out[1, row + REACH, i + REACH] = right * per
            out[2, row + REACH, i + REACH] = down * per
            out[3, row + REACH, i + REACH] = total * per if known else ZERO


@kernel(fastmath=FASTMATH, inline=True)
def _taps(
    work: Row, row: int, i: int, middle: np.float32, g: np.float32, per_variance: np.float32
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Return the sums over the 3 cells of one row around the i-th."""
    # From the first on: LLVM vectorises no index that it thinks may be negative.
    share, r = row * STRIDE + REACH - 1 + i, (row + INVERSE) * STRIDE + REACH - 1 + i
    sums = (ZERO, ZERO, ZERO, ZERO, ZERO)
    sums = tap(work[share], work[r], middle - g, per_variance, -ONE, sums)
    sums = tap(work[share + 1], work[r + 1], middle, per_variance, ZERO, sums)
    return tap(work[share + 2], work[r + 2], middle + g, per_variance, ONE, sums)


@kernel(fastmath=FASTMATH, inline=True)
def _fit(work: Row, plane: Row, count: int, noise: Noise) -> None:
    """Turn and shift planes by the weighted least-squares fit to their misses, of 3 x 3 cells."""
    for i in range(count):
        c = plane[i]
        g = plane[STRIDE + i]
        h = plane[2 * STRIDE + i]
        own = work[(INVERSE + REACH) * STRIDE + REACH + i]
        per = ONE / (WITHIN2 * variance_of_mean(own, noise))
        t0 = _taps(work, REACH - 1, i, c - h, g, per)
        t1 = _taps(work, REACH, i, c, g, per)
        t2 = _taps(work, REACH + 1, i, c + h, g, per)
        weight = t0[0] + t1[0] + t2[0] + TINY
        scale = ONE / weight
        x, y = scale * (t0[1] + t1[1] + t2[1]), scale * (t2[0] - t0[0])
        miss = scale * (t0[3] + t1[3] + t2[3])
        xx = scale * (t0[2] + t1[2] + t2[2]) - x * x + RIDGE
        xy = scale * (t2[1] - t0[1]) - x * y
        yy = scale * (t2[0] + t0[0]) - y * y + RIDGE
        xm = scale * (t0[4] + t1[4] + t2[4]) - x * miss
        ym = scale * (t2[3] - t0[3]) - y * miss
        per_det = ONE / (xx * yy - xy * xy)
        turn_u, turn_v = (xm * yy - ym * xy) * per_det, (ym * xx - xm * xy) * per_det
        plane[i] = c + miss - turn_u * x - turn_v * y
        plane[STRIDE + i] = g + turn_u
        plane[2 * STRIDE + i] = h + turn_v
        plane[3 * STRIDE + i] = weight


@kernel(fastmath=FASTMATH, inline=True)
def _compare(work: Row, plane: Row, count: int, side: int, noise: Noise, apart: np.float32) -> None:
    """Turn planes from per quarter to per pixel, and say how far from their cells' they are."""
    per_size = ONE / np.float32(side)
    for i in range(min(count, BLOCK)):
        g_u = plane[STRIDE + i] * per_size
        g_v = plane[2 * STRIDE + i] * per_size
        weight = plane[3 * STRIDE + i]
        own = work[(INVERSE + REACH) * STRIDE + REACH + i]
        some = work[REACH * STRIDE + REACH + i]
        floor = noise_floor(own, noise[0], noise[1])
        per2 = ONE / (weight * weight)
        variance = SLOPE * (per_size * per_size)
        energy = per2 * (variance * variance_of_mean(own, noise) + FEW * per2 * floor)
        plane[STRIDE + i] = g_u
        plane[2 * STRIDE + i] = g_v
        plane[3 * STRIDE + i] = min(energy, NO_PLANE) if some > ZERO else NO_PLANE
        both = ONE if (some > ZERO) & (plane[(CELL + 2) * STRIDE + i] < NO_PLANE) else ZERO
        plane[ODD * STRIDE + i] = both
        plane[(ODD + 1) * STRIDE + i] = both * (weight * (g_u - plane[CELL * STRIDE + i]))
        plane[(ODD + 2) * STRIDE + i] = both * (weight * (g_v - plane[(CELL + 1) * STRIDE + i]))
        plane[(ODD + 3) * STRIDE + i] = variance * apart * (floor + TINY)


@kernel(fastmath=FASTMATH)
def _write(
    plane: Row,
    row: int,
    start: int,
    count: int,
    side: int,
    cx: np.float32,
    cy: np.float32,
    out: Image,
    odd: Image,
) -> None:
    """Write what was fitted and compared, the planes from the principal point."""
    y = np.float32((row + 0.5) * side - 0.5 - cy)
    level = out[0, row, start : start + count]
    for i in range(count):
        x = np.float32((start + i + 0.5) * side - 0.5 - cx)
        g_u, g_v = plane[STRIDE + i], plane[2 * STRIDE + i]
        level[i] = plane[i] - g_u * x - g_v * y
    for k in range(1, 4):
        line = out[k, row, start : start + count]
        for i in range(count):
            line[i] = plane[k * STRIDE + i]
    for k in range(4):
        line = odd[k, row + 1, start + 1 : start + 1 + count]
        for i in range(count):
            line[i] = plane[(ODD + k) * STRIDE + i]


@kernel(
    void(
        float32[:, :, ::1],
        float32[:, :, ::1],
        float32[:, :, ::1],
        int64,
        int64,
        int64,
        float32,
        float32,
        float32,
        float32,
        float32,
        float32,
        float32[:, :, ::1],
        float32[:, :, ::1],
    ),
    fastmath=FASTMATH,
)
def fine_planes(
    means: Image,
    centres: Image,
    coarse: Image,
    row_start: int,
    row_stop: int,
    side: int,
    cx: np.float32,
    cy: np.float32,
    variance: np.float32,
    quartic: np.float32,
    averaging: np.float32,
    apart: np.float32,
    out: Image,
    odd: Image,
) -> None:
    """Write the planes of rows of quarters, and how far their slopes are from their cells'.

    ``odd``, (4, rows + 2, columns + 2): whether both are known, the difference by u and by v times
    the sum N of the smaller plane's weights, and N^2 times its variance. `apart` times a pixel's
    variance is that of a quarter's mean on a flat surface, which may be more than a pixel's: errors
    of neighbours are alike.
    """
    columns = out.shape[2]
    # The planes in an array of their own, which LLVM needs here to vectorise.
    work = np.zeros(2 * INVERSE * STRIDE, np.float32)
    plane = np.zeros((ODD + 4) * STRIDE, np.float32)
    noise = variance, quartic, averaging
    for row in range(row_start, row_stop):
        for start in range(0, columns, BLOCK):
            count = min(BLOCK, columns - start)
            for k in range(REACH - 1, REACH + 2):
                for i in range(count + 2 * REACH):
                    work[k * STRIDE + i] = means[0, row + k, start + i]
                    work[(k + INVERSE) * STRIDE + i] = centres[0, row + k, start + i]
            for k in range(3):
                for i in range(count):
                    plane[k * STRIDE + i] = centres[k, row + REACH, start + REACH + i]
            # BLOCK is even, and so is each start.
            for k in range(3):
                for i in range((count + 1) // 2):
                    value = coarse[k + 1, row // 2, start // 2 + i]
                    plane[(k + CELL) * STRIDE + 2 * i] = value
                    plane[(k + CELL) * STRIDE + 2 * i + 1] = value
            for _ in range(ROUNDS):
                _fit(work, plane, count, noise)
            _compare(work, plane, count, side, noise, apart)
            _write(plane, row, start, count, side, cx, cy, out, odd)


@kernel(void(float32[:, :, ::1], int64, int64, float32[:, :, ::1]), fastmath=FASTMATH)
def slope_misses(odd: Image, row_start: int, row_stop: int, out: Image) -> None:
    """Write (2, rows + 4, columns + 4): whether both planes are known, and by how much they differ.

    That is the square of their slopes' mean difference over 3 x 3 quarters, by its variance.
    """
    columns = out.shape[2] - 2 * AROUND
    sums = np.empty((3, columns + 2), np.float32)
    for row in range(row_start, row_stop):
        for k in range(3):
            for i in range(columns + 2):
                sums[k, i] = odd[k, row, i] + odd[k, row + 1, i] + odd[k, row + 2, i]
        for i in range(columns):
            count = sums[0, i] + sums[0, i + 1] + sums[0, i + 2]
            off_u = sums[1, i] + sums[1, i + 1] + sums[1, i + 2]
            off_v = sums[2, i] + sums[2, i + 1] + sums[2, i + 2]
            some = odd[0, row + 1, i + 1]
            variance = AVERAGED * odd[3, row + 1, i + 1] * max(count * count, ONE)
            miss = (off_u * off_u + off_v * off_v) / max(variance, TINY)
            out[0, row + AROUND, i + AROUND] = some
            out[1, row + AROUND, i + AROUND] = some * min(miss, MOST)


@kernel(
    void(float32[:, :, ::1], float32[:, :, ::1], int64, int64, float32[:, :, ::1]),
    fastmath=FASTMATH,
)
def keep_level(misses: Image, coarse: Image, row_start: int, row_stop: int, planes: Image) -> None:
    """Give quarters in rows [row_start, row_stop) their cell's plane where it is as good."""
    columns = planes.shape[2]
    sums = np.empty((2, columns + 2 * AROUND), np.float32)
    for row in range(row_start, row_stop):
        sums[:] = ZERO
        for j in range(2 * AROUND + 1):
            for i in range(columns + 2 * AROUND):
                sums[0, i] += misses[0, row + j, i]
                sums[1, i] += misses[1, row + j, i]
        for i in range(columns):
            count, miss = ZERO, ZERO
            for k in range(2 * AROUND + 1):
                count += sums[0, i + k]
                miss += sums[1, i + k]
            level = (miss <= APART2 * count) & (coarse[3, row // 2, i // 2] < NO_PLANE)
            if level or planes[3, row, i] >= NO_PLANE:
                for k in range(4):
                    planes[k, row, i] = coarse[k, row // 2, i // 2]
