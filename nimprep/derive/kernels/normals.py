"""Normals by NIM: one pass over the rows, four neighbours at a time.

Wang et al., "Applying surface normal information in drivable area and road anomaly detection for
ground mobile robots", IROS 2020, with its angles replaced by the vector they stand for.

With x = (u - cx)/fx and y = (v - cy)/fy, and with (c, s) the unit vector along
(n_x, n_y) = (fx g_u, fy g_v), the candidate of neighbour i has, after multiplying by dz_i,

    n_z,i dz_i = e_i - w dz_i,   w = c x + s y,
    e_i = c Z_i / fx, -c Z_i / fx, s Z_i / fy, -s Z_i / fy   for left, right, up, down,

so it takes no back-projected point. Its normalised sum over i is (c S, s S, E - w S) with
S = sum of |dz_i| / L_i, E = sum of sign(dz_i) e_i / L_i, L_i the length of (dz_i, n_z,i dz_i);
and E has the sign of n.P, which orients the vector without a further product.

Inverse depths are never formed: g_u is proportional to (Z_left - Z_right) Z_up Z_down, and g_v to
(Z_up - Z_down) Z_left Z_right. Two close float32 depths subtract exactly; their reciprocals do not:
at 60 m and one millimetre apart, the rounding of either is up to 0.3 % of their difference.

No fastmath flag: only +, -, *, / and sqrt as IEEE rounds them, so that every pixel's bits are the
same whatever the processor, its vector width and the place in the row. Contraction and approximate
square roots saved about 10 % of the time where it was measured.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import boolean, float32, float64, int64, njit, void

ZERO = np.float32(0)
ONE = np.float32(1)
INFINITY = np.float32(np.inf)

# Smallest normal float32: keeps 0 / sqrt(0) at 0 where a neighbour has the pixel's own depth.
TINY = np.float32(1.1754944e-38)

# Squared lengths below it are 0, or lost to underflow where neighbours are 1000 times nearer or
# farther; with depths alike, one unit in the last place already gives 1e-14.
FAINT = np.float32(1e-30)

EXPONENT_BITS = np.int32(0x7F800000)
EXPONENT_OF_INVERSE = np.int32(0x7F000000)


# LLVM leaves functions of this size out of line, and does not vectorise a loop with calls in it.
@njit(nogil=True, error_model="numpy", forceinline=True)
def _inverse_power_of_two(depth: np.float32) -> np.float32:
    """Return 2^-e for depth in [2^e, 2^(e+1)): a scale that rounds nothing."""
    exponent = np.int32(np.float32(depth).view(np.int32) & EXPONENT_BITS)
    return np.int32(EXPONENT_OF_INVERSE - exponent).view(np.float32)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _gradient_direction(
    left: np.float32,
    right: np.float32,
    up: np.float32,
    down: np.float32,
    both_u: np.bool_,
    both_v: np.bool_,
    fy_over_fx: np.float32,
) -> tuple[np.float32, np.float32, np.bool_]:
    """Return (n_x, n_y) as a unit vector, and whether there is a gradient at all."""
    difference_u = left - right
    difference_v = fy_over_fx * (up - down)
    difference_u = difference_u if both_u else difference_u + difference_u
    difference_v = difference_v if both_v else difference_v + difference_v
    n_x = difference_u * (up * down)
    n_y = difference_v * (left * right)
    squared = n_x * n_x + n_y * n_y
    scale = ONE / np.sqrt(squared + TINY)
    return n_x * scale, n_y * scale, (squared > FAINT) & (squared < INFINITY)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _candidate(
    depth: np.float32, neighbour: np.float32, e: np.float32, w: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Return one candidate's share of S and of E, and its n_z; all 0 where dz = 0."""
    dz = neighbour - depth
    dz_n_z = e - w * dz
    squared = dz * dz
    # dz / sqrt(dz^2 L^2) is sign(dz) / L, and 0 for dz = 0, with no branch.
    weight = dz / np.sqrt(squared * (squared + dz_n_z * dz_n_z) + TINY)
    return dz * weight, e * weight, dz_n_z * weight


@njit(nogil=True, error_model="numpy", forceinline=True)
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


@njit(nogil=True, error_model="numpy", forceinline=True)
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


@njit(nogil=True, error_model="numpy", forceinline=True)
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
        # Depths in units of about the pixel's own keep the products below within float32.
        unit = _inverse_power_of_two(depth)
        z = depth * unit
        left = (left_row[u] if has_left else depth) * unit
        right = (right_row[u] if has_right else depth) * unit
        up = (up_row[u] if has_up else depth) * unit
        down = (down_row[u] if has_down else depth) * unit
        c, s, sloped = _gradient_direction(
            left, right, up, down, has_left & has_right, has_up & has_down, fy_over_fx
        )
        w = c * x_row[u] + s * y
        c_per_fx, s_per_fy = c * per_fx, s * per_fy
        of_left = _candidate(z, left, c_per_fx * left, w)
        of_right = _candidate(z, right, -c_per_fx * right, w)
        of_up = _candidate(z, up, s_per_fy * up, w)
        of_down = _candidate(z, down, -s_per_fy * down, w)
        if sign_filter:
            s_sum, e_sum = _majority(of_left, of_right, of_up, of_down)
        else:
            s_sum = (of_left[0] + of_right[0]) + (of_up[0] + of_down[0])
            e_sum = (of_left[1] + of_right[1]) + (of_up[1] + of_down[1])
        z_sum = e_sum - w * s_sum
        squared = s_sum * s_sum + z_sum * z_sum
        scale = ONE / np.sqrt(squared + TINY)
        scale = -scale if e_sum > ZERO else scale
        present = depth > ZERO
        known = present & sloped & (squared > FAINT)
        flat = -ONE if present else ZERO
        out[3 * u] = c * (s_sum * scale) if known else ZERO
        out[3 * u + 1] = s * (s_sum * scale) if known else ZERO
        out[3 * u + 2] = z_sum * scale if known else flat


@njit(
    void(
        float32[:, ::1],
        int64,
        int64,
        float64,
        float64,
        float64,
        float64,
        boolean,
        float32[:, ::1],
    ),
    cache=True,
    nogil=True,
    error_model="numpy",
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
        window[v % 3, 1:-1] = depth_m[v]
    for v in range(row_start, row_stop):
        row, down, up = window[v % 3], window[(v + 1) % 3], window[(v + 2) % 3]
        if v + 1 < height:
            down[1:-1] = depth_m[v + 1]
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
