"""One number per pixel: disparity, disparity over the road's profile, height over the road.

All walk rows and write each pixel once. Depth and disparity 0 = none; elsewhere none is NaN.
"""

from __future__ import annotations

import numpy as np
from numba import float32, float64, int64, types, void

from nimprep.compilation.decorator import kernel

_PLANE = types.Array(float32, 2, "C", readonly=True)
_MOST = np.float32(3.4028235e38)
_FAR = 3e38


@kernel(void(_PLANE, int64, int64, float64, float32, float32[:, ::1]))
def reciprocal(values, first, last, factor, least, out):
    """Write factor / value of rows first..last-1, and 0 where the value is 0.

    So it does where the quotient is below ``least`` or beyond float32.
    """
    numerator = np.float32(factor)
    for v in range(first, last):
        for u in range(values.shape[1]):
            quotient = numerator / values[v, u]
            out[v, u] = quotient if (quotient >= least) & (quotient <= _MOST) else np.float32(0)


@kernel(
    void(
        _PLANE,
        int64,
        int64,
        types.UniTuple(float64, 4),
        types.UniTuple(float64, 4),
        float32[:, ::1],
    )
)
def heights(depth, first, last, camera, plane, out):
    """Write n·P + h of rows first..last-1, NaN where there is no depth.

    ``camera`` holds fx, fy, cx, cy; ``plane`` n_x, n_y, n_z and h.
    """
    fx, fy, cx, cy = camera
    across = plane[0] / fx
    none = np.float32(np.nan)
    # Once for all rows: turning column numbers into doubles takes a fifth of the time.
    along = across * np.arange(depth.shape[1])
    for v in range(first, last):
        start = plane[1] * (v - cy) / fy + plane[2] - across * cx
        # What is higher than float32 can say is at its end, and stays a number.
        steepest = max(abs(start), abs(start + across * (depth.shape[1] - 1)), 1e-9)
        farthest = np.float32(_FAR / steepest)
        for u in range(depth.shape[1]):
            z = depth[v, u]
            near = z if z < farthest else farthest
            height = np.float32(near * (start + along[u]) + plane[3])
            out[v, u] = height if z > 0 else none


@kernel(float64(float64, types.UniTuple(float64, 3), types.UniTuple(float64, 2)))
def road_level(s, coefficients, span):
    """Return the road's disparity at s: a parabola within the span, its tangents beyond it."""
    c0, c1, c2 = coefficients
    inside = min(max(s, span[0]), span[1])
    level = c0 + (c1 + c2 * inside) * inside + (c1 + 2 * c2 * inside) * (s - inside)
    return max(level, 0.0)


@kernel(
    void(
        _PLANE,
        int64,
        int64,
        types.UniTuple(float64, 2),
        types.UniTuple(float64, 3),
        types.UniTuple(float64, 2),
        float32[:, ::1],
    )
)
def over_profile(disparity, first, last, turn, coefficients, span, out):
    """Write disparity less the road's of rows first..last-1, NaN where there is none.

    ``turn`` holds the cosine and the sine of the roll.
    """
    none = np.float32(np.nan)
    along = turn[1] * np.arange(disparity.shape[1])  # as in `heights`
    for v in range(first, last):
        for u in range(disparity.shape[1]):
            level = road_level(v * turn[0] + along[u], coefficients, span)
            value = disparity[v, u]
            apart = np.float32(value - level)
            apart = apart if apart > -_MOST else -_MOST
            out[v, u] = apart if value > 0 else none


@kernel(
    void(
        _PLANE,
        int64,
        int64,
        types.UniTuple(float64, 2),
        types.UniTuple(float64, 3),
        types.UniTuple(float64, 2),
        float32[:, ::1],
    )
)
def under_profile(transformed, first, last, turn, coefficients, span, out):
    """Undo `over_profile`: write the disparity of rows first..last-1, 0 where there is none.

    NaN and infinity are none, and so is what would not be positive: farther than the horizon.
    """
    along = turn[1] * np.arange(transformed.shape[1])  # as in `heights`
    for v in range(first, last):
        for u in range(transformed.shape[1]):
            level = road_level(v * turn[0] + along[u], coefficients, span)
            restored = np.float32(transformed[v, u] + level)
            some = (restored > 0) & (restored <= _MOST)  # NaN is not
            out[v, u] = restored if some else np.float32(0)


@kernel(void(_PLANE, float64, types.Array(types.uint16, 2, "C")))
def positives_to_integers(values, steps, out):
    """Round values times ``steps`` into 1..65535; 0 stays."""
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            step = min(max(np.rint(values[v, u] * steps), 1.0), 65535.0)
            out[v, u] = np.uint16(step) if values[v, u] > 0 else np.uint16(0)


@kernel(void(_PLANE, float64, types.Array(types.int16, 2, "C")))
def signed_to_integers(values, steps, out):
    """Round values times ``steps`` into -32767..32767; NaN becomes -32768."""
    for v in range(values.shape[0]):
        for u in range(values.shape[1]):
            value = values[v, u]
            some = not np.isnan(value)
            step = min(max(np.rint((value if some else np.float32(0)) * steps), -32767.0), 32767.0)
            out[v, u] = np.int16(step) if some else np.int16(-32768)
