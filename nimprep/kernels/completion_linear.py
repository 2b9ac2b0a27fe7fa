"""Find the pixels that a linear filling needs, and interpolate over their triangles."""

from __future__ import annotations

from numba import float32, int32, int64, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_UNLIKE = 1e6


@kernel(int64(_DEPTH, int64[:, ::1]))
def border_points(depth, out):
    """Write v, u of the known pixels with an unknown one beside, above or below; count them.

    No other pixel can be the corner of a Delaunay triangle with an unknown pixel in it: a circle
    through a pixel whose four neighbours are known holds one of them unless its radius is at most
    the diagonal of half a pixel.
    """
    height, width = depth.shape
    found = 0
    for v in range(height):
        for u in range(width):
            if depth[v, u] > 0 and (
                (u > 0 and depth[v, u - 1] == 0)
                or (u + 1 < width and depth[v, u + 1] == 0)
                or (v > 0 and depth[v - 1, u] == 0)
                or (v + 1 < height and depth[v + 1, u] == 0)
            ):
                out[found, 0], out[found, 1] = v, u
                found += 1
    return found


@kernel()
def _clip_span(points, a, b, v, span):
    """Cut a span of columns to the left side of the directed edge a to b, both ends included."""
    dv = points[b, 0] - points[a, 0]
    du = points[b, 1] - points[a, 1]
    # The turn at column u is dv * (u - points[a, 1]) - du * (v - points[a, 0]) >= 0.
    reach = du * (v - points[a, 0])
    low, high = span
    if dv > 0:
        low = max(low, points[a, 1] - (-reach) // dv)
    elif dv < 0:
        high = min(high, points[a, 1] + (-reach) // -dv)
    return low, high


@kernel(void(_DEPTH, int64[:, ::1], int32[:, ::1], int64, int64, int64, float32[:, ::1]))
def fill_triangles(depth, points, triangles, count, first, last, out):
    """Interpolate depth over ``count`` triangles in the unknown pixels of rows first..last-1."""
    for t in range(count):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        va, ua = points[a, 0], points[a, 1]
        vb, ub = points[b, 0], points[b, 1]
        vc, uc = points[c, 0], points[c, 1]
        highest, lowest = min(va, vb, vc), max(va, vb, vc)
        left, right = min(ua, ub, uc), max(ua, ub, uc)
        top, bottom = max(highest, first), min(lowest, last - 1)
        # Half a pixel square, the commonest triangle beside holes, holds its corners only.
        if top > bottom or (lowest - highest == 1 and right - left == 1):
            continue
        area = float((vb - va) * (uc - ua) - (ub - ua) * (vc - va))
        za, zb, zc = float(depth[va, ua]), float(depth[vb, ub]), float(depth[vc, uc])
        nearest, farthest = min(za, zb, zc), max(za, zb, zc)
        # Where corners are so unlike, rounding would leave their range, even below 0.
        unlike = farthest > _UNLIKE * nearest
        zb -= za
        zc -= za
        slope_v = (zb * (uc - ua) - zc * (ub - ua)) / area
        slope_u = (zc * (vb - va) - zb * (vc - va)) / area
        for v in range(top, bottom + 1):
            span = _clip_span(points, a, b, v, (left, right))
            span = _clip_span(points, b, c, v, span)
            span = _clip_span(points, c, a, v, span)
            for u in range(span[0], span[1] + 1):
                if depth[v, u] == 0:
                    out[v, u] = za + slope_v * (v - va) + slope_u * (u - ua)
            if unlike:
                for u in range(span[0], span[1] + 1):
                    if depth[v, u] == 0:
                        out[v, u] = min(max(out[v, u], nearest), farthest)
