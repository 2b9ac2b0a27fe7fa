"""Between the arrays of a `Frame` and the integers of a store."""

from __future__ import annotations

import numpy as np
from numba import float32, int8, int16, int64, types, uint16, void

from nimprep.compilation.decorator import kernel

_METRES = types.Array(float32, 2, "C", readonly=True)
_VECTORS = types.Array(float32, 3, "C", readonly=True)
_BYTES = types.Array(int8, 3, "C", readonly=True)
_WORDS = types.Array(int16, 3, "C", readonly=True)


@kernel([void(_VECTORS, float32, int8[:, :, ::1]), void(_VECTORS, float32, int16[:, :, ::1])])
def normals_to_integers(normal, scale, out):
    """Round each component times `scale` to nearest even: (H, W, 3) float32 to intN."""
    # One loop over all numbers, through int32: so it becomes vector instructions.
    numbers, integers = normal.reshape(-1), out.reshape(-1)
    for i in range(numbers.size):
        integers[i] = np.int32(np.rint(numbers[i] * scale))


@kernel(int64(_METRES, float32, uint16[:, ::1]))
def metres_to_steps(depth_m, steps, out):
    """Round (H, W) float32 metres times `steps` to uint16; what does not fit = 0.

    Returns how many positive depths became 0: too far, or nearer than half a step.
    """
    metres, integers = depth_m.reshape(-1), out.reshape(-1)
    lost = 0
    for i in range(metres.size):
        rounded = np.rint(metres[i] * steps)
        integer = np.int32(rounded) if rounded <= 65535 else 0
        integers[i] = integer
        lost += metres[i] > 0 and integer == 0
    return lost


@kernel([void(_BYTES, float32[:, :, ::1]), void(_WORDS, float32[:, :, ::1])])
def normals_from_integers(stored, out):
    """Scale each vector to unit length: (H, W, 3) intN to float32; (0, 0, 0) stays."""
    for v in range(stored.shape[0]):
        for u in range(stored.shape[1]):
            x = float(stored[v, u, 0])
            y = float(stored[v, u, 1])
            z = float(stored[v, u, 2])
            square = x * x + y * y + z * z
            scale = 1.0 / square**0.5 if square > 0 else 0.0
            out[v, u, 0] = x * scale
            out[v, u, 1] = y * scale
            out[v, u, 2] = z * scale
