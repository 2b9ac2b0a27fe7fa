"""The equations of Levin et al. (2004) for depth: near pixels of like grey have like depth."""

from __future__ import annotations

import math

import numpy as np
from numba import float32, float64, int32, types, void

from nimprep.compilation.decorator import kernel

_DEPTH = types.Array(float32, 2, "C", readonly=True)
_LEAST_VARIANCE = 0.000002
_LEAST_WEIGHT = 0.01


@kernel()
def _neighbour_weights(gray, v, u, weights):
    """Write the weight of each pixel of the 3x3 window, 0 for the centre and outside the image."""
    height, width = gray.shape
    centre = gray[v, u]
    count = 1
    total = square = 0.0
    nearest = np.inf
    weights[:] = 0
    for i in range(9):
        row, column = v + i // 3 - 1, u + i % 3 - 1
        if i == 4 or not (0 <= row < height and 0 <= column < width):
            continue
        difference = gray[row, column] - centre
        weights[i] = difference * difference
        total += difference
        square += difference * difference
        nearest = min(nearest, difference * difference)
        count += 1
    mean = total / count
    variance = 0.6 * (square / count - mean * mean)
    # The most alike neighbour always keeps a hundredth of the weight that an equal one has.
    variance = max(variance, -nearest / math.log(_LEAST_WEIGHT), _LEAST_VARIANCE)
    total = 0.0
    for i in range(9):
        row, column = v + i // 3 - 1, u + i % 3 - 1
        if i != 4 and 0 <= row < height and 0 <= column < width:
            weights[i] = math.exp(-weights[i] / variance)
            total += weights[i]
    for i in range(9):
        weights[i] /= total


@kernel(
    void(
        _DEPTH,
        float64[:, ::1],
        int32[:, ::1],
        float64,
        int32[::1],
        int32[::1],
        float64[::1],
        float64[::1],
    )
)
def colorization_equations(depth, gray, index, alpha, starts, columns, values, right):
    """Write the sparse rows (CSR) of the pixels whose index is not negative, in raster order.

    x less the weighted mean of its neighbours is 0 where depth is unknown, and is joined by alpha
    times (x - depth) where it is known. A neighbour without an index counts with its depth.
    """
    height, width = depth.shape
    weights = np.empty(9)
    filled = 0
    for v in range(height):
        for u in range(width):
            i = index[v, u]
            if i < 0:
                continue
            known = alpha if depth[v, u] > 0 else 0.0
            right[i] = known * depth[v, u]
            starts[i] = filled
            _neighbour_weights(gray, v, u, weights)
            weights[4] = -1 - known
            for k in range(9):
                row, column = v + k // 3 - 1, u + k % 3 - 1
                if weights[k] == 0 or not (0 <= row < height and 0 <= column < width):
                    continue
                if index[row, column] < 0:
                    right[i] += weights[k] * depth[row, column]
                    continue
                columns[filled] = index[row, column]
                values[filled] = -weights[k]
                filled += 1
            starts[i + 1] = filled
