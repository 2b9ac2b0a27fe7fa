"""Edge-aware normals: each pixel's plane of inverse depth, its own and its neighbours' weighed.

With r = 1/Z and g its gradient, n is along (fx g_u, fy g_v, r - g_u (u - cx) - g_v (v - cy)); n.P
is then 1 before n is turned, so that the sign is known without a product. A pixel that no neighbour
with depth is beside has no n: nothing was measured there. g is a weighted mean:

1. of the pixel's own gradient and those of its four neighbours, from `inverse_depth_gradient`. A
   neighbour's plane should hold the pixel: how far it misses it, squared and times 8, is added to
   its energy, and the weight is one over that;
2. in noise also of the planes of the four cells around, from `normals_cells`, likewise.
"""

from __future__ import annotations

import numpy as np
from numba import float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel
from nimprep.kernels.inverse_depth_gradient import (
    FASTMATH,
    NO_PLANE,
    ONE,
    TINY,
    ZERO,
    Image,
    Noise,
    Row,
    gradient_row,
    inverse_row,
    noise_floor,
    weight_of,
)

_DEPTH = types.Array(float32, 2, "C", readonly=True)

# Of a pixel's own gradient, and of the distance by which another's plane misses it.
OWN, MISS = np.float32(8), np.float32(8)

# The share of all the cells' planes together, and how many standard deviations they may miss.
CELLS, WITHIN2 = np.float32(16), np.float32(9)


@kernel(fastmath=FASTMATH, inline=True)
def _neighbour_row(
    up: Row, row: Row, down: Row, above: Row, here: Row, below: Row, sums: Row
) -> None:
    """Write the weighted sums of g_u and g_v and the weights' own over a pixel and its neighbours.

    ``up`` to ``down`` are inverse depths (W + 4), ``above`` to ``below`` gradients (3, W + 2).
    """
    sum_u, sum_v, weights = sums[0], sums[1], sums[2]
    up_r, left_r, r, right_r, down_r = up[2:-2], row[1:-3], row[2:-2], row[3:-1], down[2:-2]
    up_u, up_v, up_e = above[0, 1:-1], above[1, 1:-1], above[2, 1:-1]
    down_u, down_v, down_e = below[0, 1:-1], below[1, 1:-1], below[2, 1:-1]
    u_row, v_row, e_row = here[0], here[1], here[2]
    for u in range(r.size):
        c = r[u]
        miss_left = c - left_r[u] - u_row[u]
        miss_right = c - right_r[u] + u_row[u + 2]
        miss_up = c - up_r[u] - up_v[u]
        miss_down = c - down_r[u] + down_v[u]
        own = OWN * weight_of(e_row[u + 1])
        left = weight_of(e_row[u] + MISS * (miss_left * miss_left))
        right = weight_of(e_row[u + 2] + MISS * (miss_right * miss_right))
        over = weight_of(up_e[u] + MISS * (miss_up * miss_up))
        under = weight_of(down_e[u] + MISS * (miss_down * miss_down))
        sum_u[u] = (
            own * u_row[u + 1]
            + (left * u_row[u] + right * u_row[u + 2])
            + (over * up_u[u] + under * down_u[u])
        )
        sum_v[u] = (
            own * v_row[u + 1]
            + (left * v_row[u] + right * v_row[u + 2])
            + (over * up_v[u] + under * down_v[u])
        )
        weights[u] = own + (left + right) + (over + under)


@kernel(fastmath=FASTMATH, inline=True)
def _cell(
    r: np.float32,
    level: np.float32,
    g_u: np.float32,
    g_v: np.float32,
    energy: np.float32,
    share: np.float32,
    x: np.float32,
    y: np.float32,
    allowed: np.float32,
    sums: tuple[np.float32, np.float32, np.float32],
) -> tuple[np.float32, np.float32, np.float32]:
    """Add a cell's plane to the sums of g_u, of g_v and of weights."""
    miss = r - (level + g_u * x + g_v * y)
    weight = share * weight_of(energy + MISS * max(miss * miss - allowed, ZERO))
    return sums[0] + weight * g_u, sums[1] + weight * g_v, sums[2] + weight


@kernel(fastmath=FASTMATH, inline=True)
def _add_cells(
    r: Row,
    above: Image,
    below: Image,
    side: int,
    across: np.float32,
    share_row: Row,
    x_row: Row,
    y: np.float32,
    noise: Noise,
    sums: Image,
) -> None:
    """Add the planes of the four cells around each pixel, from two rows of cells, (4, W + 2 s).

    `across` of them are taken from ``below``, the rest from ``above``.
    """
    sum_u, sum_v, weights = sums[0], sums[1], sums[2]
    # Sliced one by one: a slice of all four has a stride that LLVM does not know.
    start, stop = side // 2, side // 2 + side
    a_r, a_u, a_v, a_e = above[0][start:], above[1][start:], above[2][start:], above[3][start:]
    b_r, b_u, b_v, b_e = above[0][stop:], above[1][stop:], above[2][stop:], above[3][stop:]
    c_r, c_u, c_v, c_e = below[0][start:], below[1][start:], below[2][start:], below[3][start:]
    d_r, d_u, d_v, d_e = below[0][stop:], below[1][stop:], below[2][stop:], below[3][stop:]
    over, under = CELLS * (ONE - across), CELLS * across
    for u in range(r.size):
        x, share, here = x_row[u], share_row[u], r[u]
        allowed = WITHIN2 * noise_floor(here, noise[0], noise[1])
        some = sum_u[u], sum_v[u], weights[u]
        rest = ONE - share
        some = _cell(here, a_r[u], a_u[u], a_v[u], a_e[u], rest * over, x, y, allowed, some)
        some = _cell(here, b_r[u], b_u[u], b_v[u], b_e[u], share * over, x, y, allowed, some)
        some = _cell(here, c_r[u], c_u[u], c_v[u], c_e[u], rest * under, x, y, allowed, some)
        some = _cell(here, d_r[u], d_u[u], d_v[u], d_e[u], share * under, x, y, allowed, some)
        sum_u[u] = some[0]
        sum_v[u] = some[1]
        weights[u] = some[2]


@kernel(fastmath=FASTMATH, inline=True)
def _normal_row(
    up: Row,
    row: Row,
    down: Row,
    sums: Row,
    x_row: Row,
    y: np.float32,
    fx: np.float32,
    fy: np.float32,
    out: Row,
) -> None:
    """Write one row of normals, (3 W,); none where no neighbour has depth, whatever cells say."""
    sum_u, sum_v, weights = sums[0], sums[1], sums[2]
    up_r, left_r, r, right_r, down_r = up[2:-2], row[1:-3], row[2:-2], row[3:-1], down[2:-2]
    for u in range(r.size):
        # The vector's length is free: it need only stay in float32.
        per_weight = weight_of(weights[u])
        g_u, g_v = sum_u[u] * per_weight, sum_v[u] * per_weight
        n_x, n_y = fx * g_u, fy * g_v
        n_z = r[u] * (weights[u] * per_weight) - (g_u * x_row[u] + g_v * y)
        across2 = n_x * n_x + n_y * n_y
        scale = -ONE / np.sqrt(across2 + n_z * n_z + TINY)
        beside = max(max(left_r[u], right_r[u]), max(up_r[u], down_r[u]))
        known = (r[u] > ZERO) & (beside > ZERO)
        tilted = known & (across2 > ZERO)
        flat = -ONE if known else ZERO
        out[3 * u] = n_x * scale if tilted else ZERO
        out[3 * u + 1] = n_y * scale if tilted else ZERO
        out[3 * u + 2] = n_z * scale if tilted else flat


@kernel(fastmath=FASTMATH)
def _widened(planes: Image, row: int, side: int, out: Row) -> None:
    """Write a row of cells' planes for every pixel, a cell of none at either side: (4, W + 2 s)."""
    rows, columns = planes.shape[1:]
    out[3] = NO_PLANE
    if not 0 <= row < rows:
        return
    for k in range(4):
        for i in range(columns):
            for u in range((i + 1) * side, min((i + 2) * side, out.shape[1])):
                out[k, u] = planes[k, row, i]


@kernel(fastmath=FASTMATH)
def _advance(
    depth_m: Image, v: int, scale: np.float32, noise: Noise, inverse: Image, gradient: Image
) -> None:
    """Write the gradients of row v, and before them the inverse depths of row v + 2.

    Row v's inverse depths stand in line v % 8, its gradients in line v % 4; none outside the image.
    """
    height = depth_m.shape[0]
    if 0 <= v + 2 < height:
        inverse_row(depth_m[v + 2], scale, inverse[(v + 2) % 8, 2:-2])
    else:
        inverse[(v + 2) % 8] = ZERO
    if 0 <= v < height:
        gradient_row(
            inverse[(v - 2) % 8],
            inverse[(v - 1) % 8],
            inverse[v % 8],
            inverse[(v + 1) % 8],
            inverse[(v + 2) % 8],
            noise,
            gradient[v % 4],
        )
    else:
        gradient[v % 4, :2] = ZERO
        gradient[v % 4, 2] = NO_PLANE


@kernel(
    void(
        _DEPTH,
        int64,
        int64,
        float64,
        float64,
        float64,
        float64,
        float32,
        float32,
        float32,
        float32[:, :, ::1],
        int64,
        float32[:, ::1],
    ),
    fastmath=FASTMATH,
)
def edge_rows(
    depth_m: Image,
    row_start: int,
    row_stop: int,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    scale: np.float32,
    variance: np.float32,
    quartic: np.float32,
    planes: Image,
    side: int,
    out: Image,
) -> None:
    """Write the normals of rows [row_start, row_stop) of (H, W) depth into (H, 3 W) out.

    Depth times `scale` is about 1. The variance of its inverse r is `variance` + `quartic` r^4.
    `planes` are those of cells `side` pixels wide, as `normals_cells` leaves them; 0 = none.
    """
    height, width = depth_m.shape
    f_x, f_y, noise, half = np.float32(fx), np.float32(fy), (variance, quartic), side // 2
    x_row = np.empty(width, np.float32)
    # How much of the cell to the right, and not of the one to the left, each pixel takes.
    share_row = np.empty(width, np.float32)
    for u in range(width):
        x_row[u] = u - cx
        share_row[u] = ((u - half) % side + 0.5) / side if side > 0 else 0.0
    inverse = np.zeros((8, width + 4), np.float32)
    gradient = np.zeros((4, 3, width + 2), np.float32)
    gradient[:, 2] = NO_PLANE
    sums = np.empty((3, width), np.float32)
    wide = np.zeros((2, 4, width + 2 * side), np.float32)
    if side > 0:
        upper = (row_start - half) // side
        _widened(planes, upper, side, wide[upper % 2])
        _widened(planes, upper + 1, side, wide[(upper + 1) % 2])
    for v in range(max(row_start - 3, 0), min(row_start + 1, height)):
        inverse_row(depth_m[v], scale, inverse[v % 8, 2:-2])
    _advance(depth_m, row_start - 1, scale, noise, inverse, gradient)
    _advance(depth_m, row_start, scale, noise, inverse, gradient)
    for v in range(row_start, row_stop):
        _advance(depth_m, v + 1, scale, noise, inverse, gradient)
        up, row, down = inverse[(v - 1) % 8], inverse[v % 8], inverse[(v + 1) % 8]
        _neighbour_row(
            up,
            row,
            down,
            gradient[(v - 1) % 4],
            gradient[v % 4],
            gradient[(v + 1) % 4],
            sums,
        )
        y = np.float32(v - cy)
        if side > 0:
            upper, inside = (v - half) // side, (v - half) % side
            above, below = wide[upper % 2], wide[(upper + 1) % 2]
            if inside == 0:
                _widened(planes, upper + 1, side, below)
            across = np.float32((inside + 0.5) / side)
            _add_cells(row[2:-2], above, below, side, across, share_row, x_row, y, noise, sums)
        _normal_row(up, row, down, sums, x_row, y, f_x, f_y, out[v])
