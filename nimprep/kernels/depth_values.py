"""Which values of a depth or disparity image are none: told, and taken out, in one pass each."""

from __future__ import annotations

import numpy as np
from numba import float32, int64, types, uint32

from nimprep.compilation.decorator import kernel

_BITS = types.Array(uint32, 1, "C", readonly=True)
_VALUES = types.Array(float32, 1, "C", readonly=True)


@kernel(types.UniTuple(uint32, 2)(_BITS))
def bit_range(bits):
    """Return the least of ``bits - 1``, in which 0 is the largest number there is, and the most.

    As integers, the bits of floats rise with them from 0 to infinity; above that are NaN and all
    that have a sign.
    """
    least, most = np.uint32(0xFFFFFFFF), np.uint32(0)
    for i in range(bits.size):
        least = min(least, np.uint32(bits[i] - np.uint32(1)))
        most = max(most, bits[i])
    return least, most


@kernel(int64(_VALUES, float32, float32[::1]))
def keep_some(values, least, out):
    """Write the finite values from ``least`` on, and 0 for all others; count the negative ones.

    -0 and negative infinity are not counted.
    """
    negative = 0
    for i in range(values.size):
        value = values[i]
        some = (value >= least) & (value < np.float32(np.inf))
        out[i] = value if some else np.float32(0)
        negative += (value < np.float32(0)) & (value > np.float32(-np.inf))
    return negative
