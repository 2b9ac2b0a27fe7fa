"""The gradient of inverse depth r = 1/Z, from differences that cross no edge.

A plane makes r exactly linear in (u, v), so that second differences tell what is no plane. A
gradient is a weighted mean of differences, each weighted by one over its energy, the square of the
error that its surroundings betray: the left, the central and the right difference of second order,
the energy of each its second difference squared, the central one at a quarter of it (a WENO scheme,
as for shocks: Liu, Osher & Chan, J. Comput. Phys. 115, 1994, with second differences as the measure
of smoothness); and the two differences of first order, which presume that r is level and have the
energy 8 g^2. The gradient's own energy is one over the sum of the weights.

Inverse depth is scaled by a power of two to be about 1, and held between 2^-20 and 2^20, so that
neither squares nor their reciprocals leave float32.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.compilation.decorator import kernel

ZERO = np.float32(0)
HALF = np.float32(0.5)
ONE = np.float32(1)

LEAST, MOST = np.float32(2.0**-20), np.float32(2.0**20)

# Rounding of 1/Z and Z, relative and squared: less than this is no second difference.
ROUNDING2 = np.float32(1e-14)

CENTRAL = np.float32(4)

# Of the differences of first order. The floor, relative to r, keeps surfaces that are level by
# chance (0.1 % of r a pixel) from being taken for planes that face the camera.
PAIR, PAIR_FLOOR2 = np.float32(8), np.float32(1e-6)

# Energies where there is no depth, and, as its inverse, along an axis without a neighbour: far
# apart, or a hole's gradient of 0 would count beside that of a pixel that knows one axis only.
NO_PLANE, ALONE = np.float32(1e30), np.float32(1e-20)
TINY = np.float32(1e-30)

# What bits of a float32 and of its inverse sum up to, near enough: see `weight_of`.
INVERSE_BITS = np.int32(0x7EF311C7)

# See kernels/normals.py.
FASTMATH = {"contract", "arcp", "nsz", "reassoc"}

Row = npt.NDArray[np.float32]
Image = npt.NDArray[np.float32]
Noise = tuple[np.float32, np.float32]


@kernel(fastmath=FASTMATH, inline=True)
def noise_floor(r: np.float32, variance: np.float32, quartic: np.float32) -> np.float32:
    """Return the variance of inverse depth r: constant, growing with r^4, and rounding's."""
    r2 = r * r
    return variance + r2 * (ROUNDING2 + quartic * r2)


@kernel(fastmath=FASTMATH, inline=True)
def weight_of(energy: np.float32) -> np.float32:
    """Return 1 / energy to within 12 %, by one subtraction from the bits of a normal float32."""
    return np.int32(INVERSE_BITS - np.float32(energy).view(np.int32)).view(np.float32)


@kernel(fastmath=FASTMATH, inline=True)
def axis_gradient(
    a: np.float32, b: np.float32, c: np.float32, d: np.float32, e: np.float32, floor: np.float32
) -> tuple[np.float32, np.float32]:
    """Return gradient and energy at c from five in a row, 0 = none; (0, 1e20) where c is alone."""
    back, front = c - b, d - c
    bend_left, bend, bend_right = back - (b - a), front - back, (e - d) - front
    pair_floor = PAIR * floor + PAIR_FLOOR2 * (c * c)
    has_b, has_d = b > ZERO, d > ZERO
    left = weight_of(bend_left * bend_left + floor)
    middle = CENTRAL * weight_of(bend * bend + floor)
    right = weight_of(bend_right * bend_right + floor)
    pair_b = weight_of(PAIR * (back * back) + pair_floor)
    pair_d = weight_of(PAIR * (front * front) + pair_floor)
    left = left if (a > ZERO) & has_b else ZERO
    middle = middle if has_b & has_d else ZERO
    right = right if has_d & (e > ZERO) else ZERO
    pair_b = pair_b if has_b else ZERO
    pair_d = pair_d if has_d else ZERO
    # The three are (3 c - 4 b + a) / 2, (d - b) / 2 and (-3 c + 4 d - e) / 2.
    total = (left + HALF * middle + pair_b) * back + (right + HALF * middle + pair_d) * front
    total = total + HALF * (left * bend_left - right * bend_right)
    energy = ONE / (left + middle + right + pair_b + pair_d + ALONE)
    return total * energy, energy


@kernel(fastmath=FASTMATH, inline=True)
def inverse_row(depth: Row, scale: np.float32, inverse: Row) -> None:
    """Write the scaled inverse of a row of depth; 0 where there is none."""
    for u in range(depth.size):
        scaled = min(max(depth[u] * scale, LEAST), MOST)
        inverse[u] = ONE / scaled if depth[u] > ZERO else ZERO


@kernel(fastmath=FASTMATH, inline=True)
def gradient_row(
    up2: Row,
    up: Row,
    row: Row,
    down: Row,
    down2: Row,
    noise: tuple[np.float32, np.float32],
    out: Row,
) -> None:
    """Write g_u, g_v and their energy, (3, W + 2), from rows of W + 4."""
    g_u, g_v, energy = out[0, 1:-1], out[1, 1:-1], out[2, 1:-1]
    width = g_u.size
    left2, left, middle, right, right2 = row[:width], row[1:-3], row[2:-2], row[3:-1], row[4:]
    up2, up, down, down2 = up2[2:-2], up[2:-2], down[2:-2], down2[2:-2]
    for u in range(width):
        r = middle[u]
        floor = noise_floor(r, noise[0], noise[1])
        along_u, energy_u = axis_gradient(left2[u], left[u], r, right[u], right2[u], floor)
        along_v, energy_v = axis_gradient(up2[u], up[u], r, down[u], down2[u], floor)
        g_u[u] = along_u if r > ZERO else ZERO
        g_v[u] = along_v if r > ZERO else ZERO
        energy[u] = energy_u + energy_v if r > ZERO else NO_PLANE
