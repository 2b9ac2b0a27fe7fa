"""Delaunay triangulation of pixels by divide and conquer (Guibas & Stolfi, 1985).

Points come in raster order, (v, u) increasing, which is the order that the division needs. An edge
is a pair of directed edges, e and e ^ 1 (its reverse). Each knows the point it starts from and its
neighbours in turn about that point: ``after`` counter-clockwise, ``before`` clockwise, in axes
(v, u). Coordinates are integers, so every decision is exact while 6 (H² + W²) H W stays below 2^63:
for square images, up to 29,000 pixels wide.
"""

from __future__ import annotations

import numpy as np
from numba import int32, int64

from nimprep.compilation.decorator import kernel

_GONE = -1


@kernel()
def _turn(points, a, b, c):
    """Return twice the signed area of a, b, c: positive when they turn counter-clockwise."""
    return (points[b, 0] - points[a, 0]) * (points[c, 1] - points[a, 1]) - (
        points[b, 1] - points[a, 1]
    ) * (points[c, 0] - points[a, 0])


@kernel()
def _inside_circle(points, a, b, c, d):
    """Tell whether d lies strictly inside the circle through a, b, c (counter-clockwise)."""
    av, au = points[a, 0] - points[d, 0], points[a, 1] - points[d, 1]
    bv, bu = points[b, 0] - points[d, 0], points[b, 1] - points[d, 1]
    cv, cu = points[c, 0] - points[d, 0], points[c, 1] - points[d, 1]
    return (
        (av * av + au * au) * (bv * cu - bu * cv)
        + (bv * bv + bu * bu) * (cv * au - cu * av)
        + (cv * cv + cu * cu) * (av * bu - au * bv)
    ) > 0


@kernel()
def _new_edge(edges, free, a, b):
    """Take an edge from a to b off the stack of free ones; returns its directed edge at a."""
    free[0] -= 1
    e = free[free[0] + 1]
    reverse = e ^ 1
    edges[e, 0], edges[e, 1], edges[e, 2] = a, e, e
    edges[reverse, 0], edges[reverse, 1], edges[reverse, 2] = b, reverse, reverse
    return e


@kernel()
def _splice(edges, a, b):
    """Join or part the rings of edges that a and b belong to."""
    after_a, after_b = edges[a, 1], edges[b, 1]
    edges[a, 1], edges[b, 1] = after_b, after_a
    edges[after_a, 2], edges[after_b, 2] = b, a


@kernel()
def _connect(edges, free, a, b):
    """Add the edge from the end of a to the start of b, in the face to their left."""
    e = _new_edge(edges, free, edges[a ^ 1, 0], edges[b, 0])
    _splice(edges, e, edges[a ^ 1, 2])
    _splice(edges, e ^ 1, b)
    return e


@kernel()
def _delete(edges, free, e):
    _splice(edges, e, edges[e, 2])
    _splice(edges, e ^ 1, edges[e ^ 1, 2])
    edges[e, 0] = edges[e ^ 1, 0] = _GONE
    free[0] += 1
    free[free[0]] = e


@kernel()
def _leaf(points, edges, free, first, count):
    """Triangulate 2 or 3 points; returns the outer edges at the first and at the last point."""
    a = _new_edge(edges, free, first, first + 1)
    if count == 2:
        return a, a ^ 1
    b = _new_edge(edges, free, first + 1, first + 2)
    _splice(edges, a ^ 1, b)
    turn = _turn(points, first, first + 1, first + 2)
    if turn == 0:
        return a, b ^ 1
    c = _connect(edges, free, b, a)
    return (a, b ^ 1) if turn > 0 else (c ^ 1, c)


@kernel()
def _lower_tangent(points, edges, left_inner, right_inner):
    """Walk both hulls down to the edge that has all points on one side."""
    while True:
        left, right = edges[left_inner, 0], edges[right_inner, 0]
        if _turn(points, right, left, edges[left_inner ^ 1, 0]) > 0:
            left_inner = edges[left_inner ^ 1, 2]
        elif _turn(points, left, edges[right_inner ^ 1, 0], right) > 0:
            right_inner = edges[right_inner ^ 1, 1]
        else:
            return left_inner, right_inner


@kernel()
def _candidate(points, edges, free, base, side):
    """Find the edge on one side of the base that goes on, deleting those it makes impossible.

    ``side`` is the column of the next edge in turn: 1 (after) on the left, 2 (before) on the right.
    Returns the edge and whether it rises above the base.
    """
    start, end = edges[base, 0], edges[base ^ 1, 0]
    edge = edges[base ^ 1, 1] if side == 1 else edges[base, 2]
    if _turn(points, edges[edge ^ 1, 0], end, start) <= 0:
        return edge, False
    while True:
        following = edges[edge, side]
        tip, next_tip = edges[edge ^ 1, 0], edges[following ^ 1, 0]
        if not _inside_circle(points, end, start, tip, next_tip):
            return edge, True
        _delete(edges, free, edge)
        edge = following


@kernel()
def _merge(points, edges, free, ends):
    """Join two neighbouring triangulations; returns the outer edges of the whole."""
    left_outer, left_inner, right_inner, right_outer = ends
    left_inner, right_inner = _lower_tangent(points, edges, left_inner, right_inner)
    base = _connect(edges, free, right_inner ^ 1, left_inner)
    if edges[left_inner, 0] == edges[left_outer, 0]:
        left_outer = base ^ 1
    if edges[right_inner, 0] == edges[right_outer, 0]:
        right_outer = base
    while True:
        left, left_rises = _candidate(points, edges, free, base, 1)
        right, right_rises = _candidate(points, edges, free, base, 2)
        if not left_rises and not right_rises:
            return left_outer, right_outer
        take_right = not left_rises or (
            right_rises
            and _inside_circle(
                points, edges[left ^ 1, 0], edges[left, 0], edges[right, 0], edges[right ^ 1, 0]
            )
        )
        if take_right:
            base = _connect(edges, free, right, base ^ 1)
        else:
            base = _connect(edges, free, base ^ 1, left ^ 1)


@kernel()
def _collect(points, edges, out):
    """List the face to the left of every edge once, less the outer one."""
    found = 0
    for e in range(edges.shape[0]):
        a = edges[e, 0]
        if a == _GONE:
            continue
        e2 = edges[e ^ 1, 2]
        e3 = edges[e2 ^ 1, 2]
        b, c = edges[e2, 0], edges[e3, 0]
        closed = edges[e3 ^ 1, 2] == e
        if closed and a < b and a < c and _turn(points, a, b, c) > 0:
            out[found, 0], out[found, 1], out[found, 2] = a, b, c
            found += 1
    return found


@kernel(int64(int64[:, ::1], int32[:, ::1]))
def triangulate(points, out):
    """Write the triangles of n >= 2 points (n, 2) to ``out`` (2 n, 3) and return their number.

    The corners are indices of points, counter-clockwise in axes (v, u), the smallest first. Of more
    than three points on one circle, the order of division settles which triangles are taken.
    """
    count = points.shape[0]
    edges = np.full((6 * count, 3), _GONE, np.int32)
    free = np.empty(3 * count + 1, np.int32)
    free[0] = 3 * count
    for i in range(3 * count):
        free[i + 1] = 2 * (3 * count - 1 - i)
    parts = count // 2
    outer = np.empty((parts, 2), np.int32)
    for part in range(parts):
        size = 3 if part == parts - 1 and count % 2 else 2
        outer[part, 0], outer[part, 1] = _leaf(points, edges, free, 2 * part, size)
    while parts > 1:
        for pair in range(parts // 2):
            left, right = 2 * pair, 2 * pair + 1
            ends = outer[left, 0], outer[left, 1], outer[right, 0], outer[right, 1]
            outer[pair, 0], outer[pair, 1] = _merge(points, edges, free, ends)
        if parts % 2:
            outer[parts // 2] = outer[parts - 1]
        parts = (parts + 1) // 2
    return _collect(points, edges, out)
