"""Nearest known pixel by exact squared distances (Meijster et al., 2000): columns, then rows."""

from __future__ import annotations

import numpy as np
from numba import float32, int32, int64, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_NONE = -1


@kernel(void(_DEPTH, int64, int64, int32[:, ::1]))
def nearest_rows(depth, first, last, out):
    """Write the row of the nearest known pixel of the same column, for columns first..last-1.

    -1 where the column has none; of two equally near, the upper.
    """
    height = depth.shape[0]
    for u in range(first, last):
        out[0, u] = 0 if depth[0, u] > 0 else _NONE
    for v in range(1, height):
        for u in range(first, last):
            out[v, u] = v if depth[v, u] > 0 else out[v - 1, u]
    for v in range(height - 2, -1, -1):
        for u in range(first, last):
            above, below = out[v, u], out[v + 1, u]
            # Below a known pixel's row, `below` is that same pixel: it is never nearer than itself.
            if below > v and (above == _NONE or below - v < v - above):
                out[v, u] = below


@kernel()
def _drop_hidden(columns, starts, squares, kept, u):
    """Take from the envelope the parabolas above the one at column u from their start on."""
    while kept > 0:
        j, start = columns[kept - 1], starts[kept - 1]
        if (start - j) ** 2 + squares[j] <= (start - u) ** 2 + squares[u]:
            break
        kept -= 1
    return kept


@kernel(void(_DEPTH, int32[:, ::1], int64, int64, float32[:, ::1]))
def fill_nearest(depth, rows, first, last, out):
    """Write the depth of the nearest known pixel to the unknown ones of rows first..last-1.

    Of several equally near, the left-most, then the upper. The squared distance to the known pixel
    of each column is a parabola along the row; ``starts`` are the columns from which each parabola
    of the lower envelope, ``columns``, is the lowest.
    """
    width = depth.shape[1]
    columns = np.empty(width, np.int64)
    starts = np.empty(width, np.int64)
    squares = np.empty(width, np.int64)
    for v in range(first, last):
        kept = 0
        for u in range(width):
            if rows[v, u] == _NONE:
                continue
            squares[u] = (rows[v, u] - v) ** 2
            kept = _drop_hidden(columns, starts, squares, kept, u)
            start = 0
            if kept > 0:
                j = columns[kept - 1]
                start = 1 + (u * u - j * j + squares[u] - squares[j]) // (2 * (u - j))
            if start < width:
                columns[kept], starts[kept] = u, start
                kept += 1
        parabola = kept - 1
        for u in range(width - 1, -1, -1):
            while starts[parabola] > u:
                parabola -= 1
            if depth[v, u] == 0:
                column = columns[parabola]
                out[v, u] = depth[rows[v, column], column]
