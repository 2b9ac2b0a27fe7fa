"""Between the arrays of a `Frame` and the integers of a store."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def normals_to_integers(normal, scale, out):
    """Round each component times `scale` to nearest even: (H, W, 3) float32 to intN."""
    for v in range(normal.shape[0]):
        for u in range(normal.shape[1]):
            for c in range(3):
                out[v, u, c] = int(np.rint(normal[v, u, c] * scale))


@njit(cache=True, nogil=True, error_model="numpy")
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
