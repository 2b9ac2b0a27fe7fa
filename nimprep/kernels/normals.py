"""Normals by NIM: one pass over the rows, four neighbours at a time.

Wang et al., "Applying surface normal information in drivable area and road anomaly detection for
ground mobile robots", IROS 2020, with its angles replaced by the vector they stand for.

With x = (u - cx)/fx, y = (v - cy)/fy and (n_x, n_y) = (fx g_u, fy g_v) at any positive scale, the
candidate of neighbour i has, multiplied by dz_i,

    n_z,i dz_i = -(e_i + w dz_i),   w = n_x x + n_y y,
    e_i = -n_x Z_i / fx, n_x Z_i / fx, -n_y Z_i / fy, n_y Z_i / fy   for left, right, up, down,

so it takes no back-projected point. The normalised candidates sum to (n_x S, n_y S, -(E + w S)),
S = sum of |dz_i| / L_i, E = sum of sign(dz_i) e_i / L_i, L_i the length of dz_i (n_x, n_y, n_z,i);
and E has the sign of -n.P: it turns the vector to the camera without a further product.

Inverse depths are never formed: g_u is proportional to (Z_left - Z_right) Z_up Z_down, and g_v to
(Z_up - Z_down) Z_left Z_right. Two close float32 depths subtract exactly; their reciprocals do not:
at 60 m and one millimetre apart, the rounding of either is up to 0.3 % of their difference.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import boolean, float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel

ZERO = np.float32(0)
ONE = np.float32(1)

# Smallest normal float32: keeps 1 / sqrt(0) finite where there is no candidate.
TINY = np.float32(1.1754944e-38)

# A scaled gradient is at least 1/sqrt(2) long, unless it is 0 or beyond float32.
FLAT = np.float32(0.25)

# The sum of the candidates is squared; below this, underflow has eaten them.
FAINT = np.float32(1e-30)

EXPONENT_BITS = np.int32(0x7F800000)
EXPONENT_OF_INVERSE = np.int32(0x7F000000)
SIGN_BIT = np.int32(-0x80000000)

# Flags that assume nothing of NaN and infinity. They let 1 / sqrt(x) become the processor's
# estimate and a Newton step, and saved 12 % where that was measured.
FASTMATH = {"contract", "arcp", "nsz", "reassoc"}

# Callers' arrays may be read-only; this type takes both kinds.
_DEPTH = types.Array(float32, 2, "C", readonly=True)


# LLVM leaves functions of this size out of line, and does not vectorise a loop with calls in it.
@kernel(fastmath=FASTMATH, inline=True)
def _gradient(
    left: np.float32,
    right: np.float32,
    up: np.float32,
    down: np.float32,
    both_u: np.bool_,
    both_v: np.bool_,
    fy_over_fx: np.float32,
) -> tuple[np.float32, np.float32]:
    """Return (n_x, n_y), scaled by a power of two so that |n_x| + |n_y| is in [1, 2)."""
    difference_u = left - right
    difference_v = fy_over_fx * (up - down)
    difference_u = difference_u if both_u else difference_u + difference_u
    difference_v = difference_v if both_v else difference_v + difference_v
    n_x = difference_u * (up * down)
    n_y = difference_v * (left * right)
    size = np.float32(np.abs(n_x) + np.abs(n_y))
    exponent = np.int32(size.view(np.int32) & EXPONENT_BITS)
    scale = np.int32(EXPONENT_OF_INVERSE - exponent).view(np.float32)
    return n_x * scale, n_y * scale


@kernel(fastmath=FASTMATH, inline=True)
def _copysign(magnitude: np.float32, sign: np.float32) -> np.float32:
    """Return a magnitude >= 0 with the sign of another number."""
    bits = np.float32(sign).view(np.int32) & SIGN_BIT
    return np.int32(np.float32(magnitude).view(np.int32) | bits).view(np.float32)


@kernel(fastmath=FASTMATH, inline=True)
def _candidate(
    dz: np.float32, e: np.float32, w: np.float32, gradient2: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Return one candidate's share of S and of E, and its n_z at some scale; all 0 if dz = 0."""
    dz_n_z = -(e + w * dz)
    length = np.sqrt(gradient2 * (dz * dz) + dz_n_z * dz_n_z + TINY)
    weight = _copysign(ONE / length, dz)
    weight = weight if dz != ZERO else ZERO
    return dz * weight, e * weight, dz_n_z * weight


@kernel(fastmath=FASTMATH, inline=True)
def _tally(
    votes: np.float32,
    positive: tuple[np.float32, np.float32],
    negative: tuple[np.float32, np.float32],
    candidate: tuple[np.float32, np.float32, np.float32],
) -> tuple[np.float32, tuple[np.float32, np.float32], tuple[np.float32, np.float32]]:
    """Add a candidate to the sums of its sign."""
    s, e, n_z = candidate
    above, below = n_z > ZERO, n_z < ZERO
    votes = votes + ONE if above else votes
    votes = votes - ONE if below else votes
    s_positive = positive[0] + s if above else positive[0]
    e_positive = positive[1] + e if above else positive[1]
    s_negative = negative[0] + s if below else negative[0]
    e_negative = negative[1] + e if below else negative[1]
    return votes, (s_positive, e_positive), (s_negative, e_negative)


@kernel(fastmath=FASTMATH, inline=True)
def _majority(
    a: tuple[np.float32, np.float32, np.float32],
    b: tuple[np.float32, np.float32, np.float32],
    c: tuple[np.float32, np.float32, np.float32],
    d: tuple[np.float32, np.float32, np.float32],
) -> tuple[np.float32, np.float32]:
    """Return S and E of the candidates with the majority's sign; of all if none has a sign."""
    votes, positive, negative = _tally(ZERO, (ZERO, ZERO), (ZERO, ZERO), a)
    votes, positive, negative = _tally(votes, positive, negative, b)
    votes, positive, negative = _tally(votes, positive, negative, c)
    votes, positive, negative = _tally(votes, positive, negative, d)
    s = positive[0] if votes >= ZERO else negative[0]
    e = positive[1] if votes >= ZERO else negative[1]
    s_all = (a[0] + b[0]) + (c[0] + d[0])
    e_all = (a[1] + b[1]) + (c[1] + d[1])
    return (s if s > ZERO else s_all), (e if s > ZERO else e_all)


@kernel(fastmath=FASTMATH, inline=True)
def _nim_row(
    left_row: npt.NDArray[np.float32],
    row: npt.NDArray[np.float32],
    right_row: npt.NDArray[np.float32],
    up_row: npt.NDArray[np.float32],
    down_row: npt.NDArray[np.float32],
    x_row: npt.NDArray[np.float32],
    y: np.float32,
    per_fx: np.float32,
    per_fy: np.float32,
    sign_filter: bool,
    out: npt.NDArray[np.float32],
) -> None:
    """Write one row of normals, (3 W,), from rows of depth that are 0 where there is none."""
    fy_over_fx = per_fx / per_fy
    for u in range(x_row.size):
        depth = row[u]
        has_left, has_right = left_row[u] > ZERO, right_row[u] > ZERO
        has_up, has_down = up_row[u] > ZERO, down_row[u] > ZERO
        # A missing neighbour takes the pixel's own depth: no candidate, a one-sided difference.
        left = left_row[u] if has_left else depth
        right = right_row[u] if has_right else depth
        up = up_row[u] if has_up else depth
        down = down_row[u] if has_down else depth
        n_x, n_y = _gradient(
            left, right, up, down, has_left & has_right, has_up & has_down, fy_over_fx
        )
        gradient2 = n_x * n_x + n_y * n_y
        w = n_x * x_row[u] + n_y * y
        e_u, e_v = n_x * per_fx, n_y * per_fy
        of_left = _candidate(left - depth, -e_u * left, w, gradient2)
        of_right = _candidate(right - depth, e_u * right, w, gradient2)
        of_up = _candidate(up - depth, -e_v * up, w, gradient2)
        of_down = _candidate(down - depth, e_v * down, w, gradient2)
        if sign_filter:
            s_sum, e_sum = _majority(of_left, of_right, of_up, of_down)
        else:
            s_sum = (of_left[0] + of_right[0]) + (of_up[0] + of_down[0])
            e_sum = (of_left[1] + of_right[1]) + (of_up[1] + of_down[1])
        z_sum = -(e_sum + w * s_sum)
        squared = gradient2 * (s_sum * s_sum) + z_sum * z_sum
        scale = _copysign(ONE / np.sqrt(squared + TINY), e_sum)
        present = depth > ZERO
        known = present & (gradient2 > FLAT) & (squared > FAINT)
        measured = present & (has_left | has_right | has_up | has_down)
        flat = -ONE if measured else ZERO
        out[3 * u] = n_x * (s_sum * scale) if known else ZERO
        out[3 * u + 1] = n_y * (s_sum * scale) if known else ZERO
        out[3 * u + 2] = z_sum * scale if known else flat


# A loop, as assigning to a slice took three times as long.
@kernel(inline=True)
def _copy_row(row: npt.NDArray[np.float32], padded: npt.NDArray[np.float32]) -> None:
    """Copy a row between the first and the last element of `padded`."""
    for u in range(row.size):
        padded[u + 1] = row[u]


@kernel(
    void(
        _DEPTH,
        int64,
        int64,
        float64,
        float64,
        float64,
        float64,
        boolean,
        float32[:, ::1],
    ),
    fastmath=FASTMATH,
)
def nim_rows(
    depth_m: npt.NDArray[np.float32],
    row_start: int,
    row_stop: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    sign_filter: bool,
    out: npt.NDArray[np.float32],
) -> None:
    """Write the normals of rows [row_start, row_stop) of (H, W) depth into (H, 3 W) out.

    `out` is flat along a row because LLVM vectorises stores with a stride it knows.
    """
    height, width = depth_m.shape
    x_row = np.empty(width, np.float32)
    for u in range(width):
        x_row[u] = (u - cx) / fx
    per_fx, per_fy = np.float32(1 / fx), np.float32(1 / fy)
    # The last three rows, a column of no depth at either side; row v stands in line v % 3.
    window = np.zeros((3, width + 2), np.float32)
    for v in range(max(row_start - 1, 0), row_start + 1):
        _copy_row(depth_m[v], window[v % 3])
    for v in range(row_start, row_stop):
        row, down, up = window[v % 3], window[(v + 1) % 3], window[(v + 2) % 3]
        if v + 1 < height:
            _copy_row(depth_m[v + 1], down)
        else:
            down[:] = ZERO
        y = np.float32((v - cy) / fy)
        left, middle, right = row[:width], row[1 : width + 1], row[2:]
        over, under = up[1 : width + 1], down[1 : width + 1]
        # Literals, so that each call becomes a loop of its own, without the test inside.
        if sign_filter:
            _nim_row(left, middle, right, over, under, x_row, y, per_fx, per_fy, True, out[v])
        else:
            _nim_row(left, middle, right, over, under, x_row, y, per_fx, per_fy, False, out[v])
