"""Planes of inverse depth over square cells, for images with noise; see `normals_edge`.

Averages over cells of s x s pixels take the noise down and the work with it. Each cell then gets
the plane that fits the 7 x 7 cells around it best by weighted least squares, twice over: a cell
that misses the plane by several standard deviations belongs to another surface and hardly counts.

Images of cells, (n, rows + 6, columns + 6), have three of none on each side, so that no loop asks
where it is. A fit works on BLOCK cells of a row at a time, copied into one flat array of a constant
stride: told from several arrays, whose places LLVM must compare first, it gave up vectorising.
"""

from __future__ import annotations

import numpy as np
from numba import float32, int64, types, void

from nimprep.compilation.decorator import kernel
from nimprep.kernels.inverse_depth_gradient import (
    FASTMATH,
    NO_PLANE,
    ONE,
    ROUNDING2,
    TINY,
    ZERO,
    Image,
    Row,
    axis_gradient,
    inverse_row,
    noise_floor,
    weight_of,
)

_DEPTH = types.Array(float32, 2, "C", readonly=True)

REACH = 3
"""How many cells to each side take part in a cell's plane."""

ROUNDS = 2

BLOCK = 128
STRIDE = BLOCK + 2 * REACH
# Where the 7 rows of shares, of inverse depths, and the 4 of the planes begin, in strides.
INVERSE, PLANE = 7, 14

TWO, THREE = np.float32(2), np.float32(3)

# Cells farther from the plane than this many standard deviations count for a quarter and less.
WITHIN2 = np.float32(9)

# Where no variance is known a miss can be any number of these: its square must not leave float32.
FAR = np.float32(1e15)

# Keeps the plane of cells in one row or column from turning about it.
RIDGE = np.float32(1e-3)

# Variance of a slope fitted to N values spread over a width w: 12 / (N w^2). What few cells agree
# on is worse than that: on curved and broken surfaces slopes were off by 4 to 8 standard deviations
# of a pixel, divided by N^2, whence FEW / N^4.
SLOPE, FEW = np.float32(12), np.float32(64)

Noise = tuple[np.float32, np.float32, np.float32]
Sums = tuple[np.float32, np.float32, np.float32, np.float32, np.float32]


@kernel(void(_DEPTH, int64, int64, int64, float32, float32[:, :, ::1]), fastmath=FASTMATH)
def cell_means(
    depth_m: Image, row_start: int, row_stop: int, side: int, scale: np.float32, out: Image
) -> None:
    """Write rows [row_start, row_stop) of an image of cells from depth.

    Channels: the share of pixels with depth, 0 where less than an eighth; how far their mean place
    lies from the cell's centre, in u and in v, pixels; their mean scaled inverse depth.
    """
    height, width = depth_m.shape
    columns = out.shape[2] - 2 * REACH
    inverse = np.empty(width, np.float32)
    sums = np.empty((3, columns * side), np.float32)
    count_u, down_u, total_u = sums[0], sums[1], sums[2]
    middle = np.float32(0.5 * (side - 1))
    for row in range(row_start, row_stop):
        sums[:] = ZERO
        for v in range(row * side, min((row + 1) * side, height)):
            inverse_row(depth_m[v], scale, inverse)
            y = np.float32(v - row * side) - middle
            for u in range(width):
                some = ONE if inverse[u] > ZERO else ZERO
                count_u[u] += some
                down_u[u] += some * y
                total_u[u] += inverse[u]
        for i in range(columns):
            count, right, down, total = ZERO, ZERO, ZERO, ZERO
            for k in range(side):
                some = count_u[i * side + k]
                count += some
                right += some * (np.float32(k) - middle)
                down += down_u[i * side + k]
                total += total_u[i * side + k]
            known = 8 * count >= side * side
            per_count = ONE / max(count, ONE)
            out[0, row + REACH, i + REACH] = count / np.float32(side * side) if known else ZERO
            out[1, row + REACH, i + REACH] = right * per_count
            out[2, row + REACH, i + REACH] = down * per_count
            out[3, row + REACH, i + REACH] = total * per_count if known else ZERO


@kernel(fastmath=FASTMATH, inline=True)
def variance_of_mean(r: np.float32, noise: Noise) -> np.float32:
    """Return the variance of a cell's mean; rounding does not average out."""
    return noise[2] * noise_floor(r, noise[0], noise[1]) + ROUNDING2 * (r * r) + TINY


@kernel(fastmath=FASTMATH, inline=True)
def _centre_row(means: Image, row: int, per_side: np.float32, noise: Noise, out: Image) -> None:
    """Write a row of inverse depth at the cells' centres and of its gradient a cell."""
    centre, g_u, g_v = out[0, row, 2:-2], out[1, row, 2:-2], out[2, row, 2:-2]
    right, down, mean = means[1, row, 2:-2], means[2, row, 2:-2], means[3, row]
    left2, left1, middle, right1, right2 = mean[:-4], mean[1:-3], mean[2:-2], mean[3:-1], mean[4:]
    over2, over = means[3, row - 2, 2:-2], means[3, row - 1, 2:-2]
    under, under2 = means[3, row + 1, 2:-2], means[3, row + 2, 2:-2]
    for i in range(middle.size):
        c = middle[i]
        floor = variance_of_mean(c, noise)
        u, _ = axis_gradient(left2[i], left1[i], c, right1[i], right2[i], floor)
        v, _ = axis_gradient(over2[i], over[i], c, under[i], under2[i], floor)
        u = u if c > ZERO else ZERO
        v = v if c > ZERO else ZERO
        centre[i] = c - (u * right[i] + v * down[i]) * per_side
        g_u[i] = u
        g_v[i] = v


@kernel(
    void(float32[:, :, ::1], int64, int64, int64, float32, float32, float32, float32[:, :, ::1]),
    fastmath=FASTMATH,
)
def cell_centres(
    means: Image,
    row_start: int,
    row_stop: int,
    side: int,
    variance: np.float32,
    quartic: np.float32,
    averaging: np.float32,
    out: Image,
) -> None:
    """Write what `cell_means` left as inverse depth at the cells' centres and its gradient.

    The gradient, by u and by v, is that of `axis_gradient`, per cell. The variance of a cell's mean
    is `averaging` times a pixel's, which `edge_rows` describes.
    """
    per_side = ONE / np.float32(side)
    for row in range(row_start, row_stop):
        _centre_row(means, row + REACH, per_side, (variance, quartic, averaging), out)


@kernel(fastmath=FASTMATH, inline=True)
def tap(
    share: np.float32,
    r: np.float32,
    expected: np.float32,
    per_variance: np.float32,
    x: np.float32,
    sums: Sums,
) -> Sums:
    """Add a cell x columns away: weight, its moments in x, and the plane's miss, also times x."""
    miss = r - expected
    off = ONE + min(miss * miss * per_variance, FAR)
    weight = share * weight_of(off * off)
    of_x, of_miss = weight * x, weight * miss
    return (
        sums[0] + weight,
        sums[1] + of_x,
        sums[2] + of_x * x,
        sums[3] + of_miss,
        sums[4] + of_miss * x,
    )


@kernel(fastmath=FASTMATH, inline=True)
def _taps(
    work: Row, row: int, i: int, middle: np.float32, g: np.float32, per_variance: np.float32
) -> Sums:
    """Return the sums over the 7 cells of one row around the i-th."""
    share, r = row * STRIDE + i, (row + INVERSE) * STRIDE + i
    sums = (ZERO, ZERO, ZERO, ZERO, ZERO)
    sums = tap(work[share], work[r], middle - THREE * g, per_variance, -THREE, sums)
    sums = tap(work[share + 1], work[r + 1], middle - TWO * g, per_variance, -TWO, sums)
    sums = tap(work[share + 2], work[r + 2], middle - g, per_variance, -ONE, sums)
    sums = tap(work[share + 3], work[r + 3], middle, per_variance, ZERO, sums)
    sums = tap(work[share + 4], work[r + 4], middle + g, per_variance, ONE, sums)
    sums = tap(work[share + 5], work[r + 5], middle + TWO * g, per_variance, TWO, sums)
    return tap(work[share + 6], work[r + 6], middle + THREE * g, per_variance, THREE, sums)


@kernel(fastmath=FASTMATH, inline=True)
def _fit(work: Row, count: int, noise: Noise) -> None:
    """Turn and shift planes by the weighted least-squares fit to their misses.

    Of a plane: inverse depth at the cell's centre, its gradient by u and by v, and, only written,
    the sum of weights.
    """
    for i in range(count):
        c = work[PLANE * STRIDE + i]
        g = work[(PLANE + 1) * STRIDE + i]
        h = work[(PLANE + 2) * STRIDE + i]
        own = work[(INVERSE + REACH) * STRIDE + REACH + i]
        per = ONE / (WITHIN2 * variance_of_mean(own, noise))
        t0 = _taps(work, 0, i, c - THREE * h, g, per)
        t1 = _taps(work, 1, i, c - TWO * h, g, per)
        t2 = _taps(work, 2, i, c - h, g, per)
        t3 = _taps(work, 3, i, c, g, per)
        t4 = _taps(work, 4, i, c + h, g, per)
        t5 = _taps(work, 5, i, c + TWO * h, g, per)
        t6 = _taps(work, 6, i, c + THREE * h, g, per)
        weight = t0[0] + t1[0] + t2[0] + t3[0] + t4[0] + t5[0] + t6[0] + TINY
        scale = ONE / weight
        x = scale * (t0[1] + t1[1] + t2[1] + t3[1] + t4[1] + t5[1] + t6[1])
        y = scale * (THREE * (t6[0] - t0[0]) + TWO * (t5[0] - t1[0]) + (t4[0] - t2[0]))
        miss = scale * (t0[3] + t1[3] + t2[3] + t3[3] + t4[3] + t5[3] + t6[3])
        xx = scale * (t0[2] + t1[2] + t2[2] + t3[2] + t4[2] + t5[2] + t6[2]) - x * x + RIDGE
        xy = scale * (THREE * (t6[1] - t0[1]) + TWO * (t5[1] - t1[1]) + (t4[1] - t2[1])) - x * y
        yy = THREE * THREE * (t6[0] + t0[0]) + TWO * TWO * (t5[0] + t1[0]) + (t4[0] + t2[0])
        yy = scale * yy - y * y + RIDGE
        xm = scale * (t0[4] + t1[4] + t2[4] + t3[4] + t4[4] + t5[4] + t6[4]) - x * miss
        ym = THREE * (t6[3] - t0[3]) + TWO * (t5[3] - t1[3]) + (t4[3] - t2[3])
        ym = scale * ym - y * miss
        per_det = ONE / (xx * yy - xy * xy)
        turn_u, turn_v = (xm * yy - ym * xy) * per_det, (ym * xx - xm * xy) * per_det
        work[PLANE * STRIDE + i] = c + miss - turn_u * x - turn_v * y
        work[(PLANE + 1) * STRIDE + i] = g + turn_u
        work[(PLANE + 2) * STRIDE + i] = h + turn_v
        work[(PLANE + 3) * STRIDE + i] = weight


@kernel(fastmath=FASTMATH)
def _write_planes(
    work: Row,
    row: int,
    start: int,
    count: int,
    side: int,
    cx: np.float32,
    cy: np.float32,
    noise: Noise,
    out: Image,
) -> None:
    """Write fitted planes per pixel instead of per cell, from the principal point."""
    size = np.float32(side)
    y = np.float32((row + 0.5) * side - 0.5 - cy)
    for i in range(count):
        x = np.float32((start + i + 0.5) * side - 0.5 - cx)
        g_u = work[(PLANE + 1) * STRIDE + i] / size
        g_v = work[(PLANE + 2) * STRIDE + i] / size
        weight = work[(PLANE + 3) * STRIDE + i]
        known = work[REACH * STRIDE + REACH + i] > ZERO
        own = work[(INVERSE + REACH) * STRIDE + REACH + i]
        per2 = ONE / (weight * weight)
        fit = SLOPE * variance_of_mean(own, noise) / (size * size)
        energy = per2 * (fit + FEW * per2 * noise_floor(own, noise[0], noise[1]))
        out[0, row, start + i] = work[PLANE * STRIDE + i] - g_u * x - g_v * y
        out[1, row, start + i] = g_u
        out[2, row, start + i] = g_v
        out[3, row, start + i] = min(energy, NO_PLANE) if known else NO_PLANE


@kernel(
    void(
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
        float32[:, :, ::1],
    ),
    fastmath=FASTMATH,
)
def cell_planes(
    means: Image,
    centres: Image,
    row_start: int,
    row_stop: int,
    side: int,
    cx: np.float32,
    cy: np.float32,
    variance: np.float32,
    quartic: np.float32,
    averaging: np.float32,
    out: Image,
) -> None:
    """Write the planes of rows [row_start, row_stop) of cells, as `edge_rows` takes them.

    ``out`` is (4, rows, columns): inverse depth at the principal point, its gradient by u and by v
    a pixel, and the gradient's energy.
    """
    columns = out.shape[2]
    work = np.zeros((PLANE + 4) * STRIDE, np.float32)
    noise = variance, quartic, averaging
    for row in range(row_start, row_stop):
        for start in range(0, columns, BLOCK):
            count = min(BLOCK, columns - start)
            for k in range(INVERSE):
                for i in range(count + 2 * REACH):
                    work[k * STRIDE + i] = means[0, row + k, start + i]
                    work[(k + INVERSE) * STRIDE + i] = centres[0, row + k, start + i]
            for k in range(3):
                for i in range(count):
                    work[(k + PLANE) * STRIDE + i] = centres[k, row + REACH, start + REACH + i]
            for _ in range(ROUNDS):
                _fit(work, count, noise)
            _write_planes(work, row, start, count, side, cx, cy, noise, out)
