"""Find the road among points (x, y, w): x and y in the image, w a disparity or an inverse depth.

On a plane w is linear in x and y. Where the road is seen from above, w grows downwards; what stands
on the road hides it and is nearer, so that its w is larger than the road's.
"""

from __future__ import annotations

import numpy as np
from numba import float64, int64, types, void

from nimprep.compilation.decorator import kernel

_VECTOR = types.Array(float64, 1, "C", readonly=True)
_PLANE = types.UniTuple(float64, 3)
_NEAR_SHARE = 0.03
_FLOOR_SHARE = 0.01
_BELOW_WEIGHT = 0.25
_HIGHEST_HORIZON = 4.0


@kernel(
    types.Tuple((_PLANE, float64))(
        _VECTOR,
        _VECTOR,
        _VECTOR,
        types.Array(int64, 2, "C", readonly=True),
        int64,
        float64,
        float64,
    )
)
def best_plane(x, y, w, triples, step, bottom, max_tilt):
    """Return the plane w = a + b x + c y through three of the points that most others agree with.

    Every ``step``-th point votes: 1 on the plane, falling to 0 at the tolerance of 3 % of the
    plane's w plus 1 % of its w at the image's bottom, and -1/4 below that, as no road is seen
    through. Points above the plane's horizon do not vote. ``bottom`` is y of the last row, with
    x = y = 0 in the middle. No road is a plane with c <= 0, with |b| > max_tilt * c, or with its
    horizon more than 4 above the middle, as things that face the camera have. The score is the sum
    of votes over the number of points that could vote; without any plane it is -1.
    """
    best = (0.0, 0.0, 0.0)
    best_score = -1.0
    points = -(-x.shape[0] // step)
    few_x = np.empty(points)
    few_y = np.empty(points)
    few_w = np.empty(points)
    for i in range(points):
        few_x[i], few_y[i], few_w[i] = x[i * step], y[i * step], w[i * step]
    for triple in range(triples.shape[0]):
        i, j, k = triples[triple, 0], triples[triple, 1], triples[triple, 2]
        x1, y1, w1 = x[j] - x[i], y[j] - y[i], w[j] - w[i]
        x2, y2, w2 = x[k] - x[i], y[k] - y[i], w[k] - w[i]
        det = x1 * y2 - x2 * y1
        if det == 0:
            continue
        b = (w1 * y2 - w2 * y1) / det
        c = (x1 * w2 - x2 * w1) / det
        a = w[i] - b * x[i] - c * y[i]
        floor = a + c * bottom
        if not (c > 0 and floor > 0 and abs(b) <= max_tilt * c and a <= _HIGHEST_HORIZON * c):
            continue
        votes = 0.0
        for n in range(points):
            road = a + b * few_x[n] + c * few_y[n]
            above = (few_w[n] - road) / (_NEAR_SHARE * road + _FLOOR_SHARE * floor)
            vote = 1 - above * above
            vote = vote if vote > 0 else (-_BELOW_WEIGHT if above < 0 else 0.0)
            votes += vote if road > 0 else 0.0
        if votes > best_score * points:
            best_score = votes / points
            best = (a, b, c)
    return best, best_score


@kernel(void(_VECTOR, _VECTOR, _VECTOR, float64, types.UniTuple(float64, 4), float64, float64[::1]))
def residuals(x, y, w, tilt, road, floor, out):
    """Write w less the road's, and NaN above its horizon or beyond the votes' tolerance.

    The road's w is r0 + r1 s + r2 s² + r3 x with s = y + tilt * x.
    """
    for n in range(x.shape[0]):
        s = y[n] + tilt * x[n]
        level = road[0] + (road[1] + road[2] * s) * s + road[3] * x[n]
        above = w[n] - level
        near = level > 0 and abs(above) <= _NEAR_SHARE * level + _FLOOR_SHARE * floor
        out[n] = above if near else np.nan


@kernel(int64(_VECTOR, _VECTOR, _VECTOR, float64, float64[::1], float64, float64[:, ::1]))
def normal_equations(x, y, w, tilt, apart, within, out):
    """Sum the normal equations of w over 1, s, s², x of the points with |apart| <= within.

    ``out`` (4, 5) gets the symmetric matrix and the right side in its last column; the number of
    points is returned.
    """
    out[:] = 0
    count = 0
    for n in range(x.shape[0]):
        if abs(apart[n]) <= within:  # NaN is not
            s = y[n] + tilt * x[n]
            basis = (1.0, s, s * s, x[n])
            count += 1
            for row in range(4):
                for column in range(row, 4):
                    out[row, column] += basis[row] * basis[column]
                out[row, 4] += basis[row] * w[n]
    for row in range(4):
        for column in range(row):
            out[row, column] = out[column, row]
    return count
