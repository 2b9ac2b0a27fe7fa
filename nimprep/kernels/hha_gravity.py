"""Sort normals into walls and floors, and sum their outer products."""

from __future__ import annotations

from numba import float64, int64, types, void

from nimprep.compilation.decorator import kernel

_VECTOR = types.UniTuple(float64, 3)


# reassoc lets the sums run in several lanes; NaN and infinity keep their meaning.
@kernel(
    void(float64[:, :, ::1], int64, int64, _VECTOR, float64, float64, float64[::1]),
    fastmath={"reassoc", "contract"},
)
def wall_minus_floor(normals, first, last, gravity, floor_above, wall_below, out):
    """Sum n nᵀ of the walls less that of the floors over rows first..last-1.

    A normal is floor where |n·gravity| > floor_above, wall where it is < wall_below (it may be both
    or neither). Missing normals are (0, 0, 0) and add nothing. ``out`` gets xx, xy, xz, yy, yz, zz.
    """
    gx, gy, gz = gravity
    xx = xy = xz = yy = yz = zz = 0.0
    for v in range(first, last):
        for u in range(normals.shape[2]):
            x = normals[0, v, u]
            y = normals[1, v, u]
            z = normals[2, v, u]
            cosine = abs(x * gx + y * gy + z * gz)
            weight = (1.0 if cosine < wall_below else 0.0) - (1.0 if cosine > floor_above else 0.0)
            xx += weight * x * x
            xy += weight * x * y
            xz += weight * x * z
            yy += weight * y * y
            yz += weight * y * z
            zz += weight * z * z
    out[0], out[1], out[2], out[3], out[4], out[5] = xx, xy, xz, yy, yz, zz
