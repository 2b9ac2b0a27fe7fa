"""From the integers a store holds to the tensors a network takes, each image in one pass.

Images come flat: (H * W * C,) interleaved as stored; `out` has the channels first, (C, H * W).
Flat loops over one counter are what LLVM turns into vector code: 0.25 ms for three channels of a
720p frame, where loops over rows and columns take 1.4 ms.
"""

from __future__ import annotations

import numpy as np

from nimprep.compilation.decorator import kernel


@kernel("(uint8[::1], float32[::1], float32[::1], float32[:, ::1])")
def scaled_colors(stored, scale, offset, out):
    """Write each channel times its scale plus its offset."""
    s0, s1, s2 = scale[0], scale[1], scale[2]
    o0, o1, o2 = offset[0], offset[1], offset[2]
    first, second, third = out[0], out[1], out[2]
    for i in range(first.size):
        first[i] = np.float32(stored[3 * i]) * s0 + o0
        second[i] = np.float32(stored[3 * i + 1]) * s1 + o1
        third[i] = np.float32(stored[3 * i + 2]) * s2 + o2


@kernel("(uint8[::1], float32[::1], float32[::1], float32[:, ::1])")
def scaled_some(stored, scale, offset, out):
    """Write each channel times its scale plus its offset; pixels that are all 0 stay 0."""
    s0, s1, s2 = scale[0], scale[1], scale[2]
    o0, o1, o2 = offset[0], offset[1], offset[2]
    first, second, third = out[0], out[1], out[2]
    for i in range(first.size):
        a, b, c = stored[3 * i], stored[3 * i + 1], stored[3 * i + 2]
        # Selected, not multiplied away: a sum with an offset of 0 must not become -0.
        some = (a | b | c) != 0
        first[i] = np.float32(a) * s0 + o0 if some else np.float32(0)
        second[i] = np.float32(b) * s1 + o1 if some else np.float32(0)
        third[i] = np.float32(c) * s2 + o2 if some else np.float32(0)


@kernel(
    [
        "(uint16[::1], int64, float32, float32, float32, float32, float32, float32[::1])",
        "(int16[::1], int64, float32, float32, float32, float32, float32, float32[::1])",
    ]
)
def scaled_plane(stored, none, steps, low, high, scale, offset, out):
    """Write integers over ``steps``, cut to `low` and `high`, times `scale` plus `offset`.

    What is `none` becomes 0.
    """
    for i in range(out.size):
        value = min(max(np.float32(stored[i]) / steps, low), high) * scale + offset
        out[i] = value if stored[i] != none else np.float32(0)


@kernel(["(int8[::1], float32[:, ::1])", "(int16[::1], float32[:, ::1])"])
def unit_vectors(stored, out):
    """Scale each vector to unit length; (0, 0, 0) stays."""
    x, y, z = out[0], out[1], out[2]
    one = np.float32(1)
    for i in range(x.size):
        a = np.float32(stored[3 * i])
        b = np.float32(stored[3 * i + 1])
        c = np.float32(stored[3 * i + 2])
        # The integers' squares sum to 0 or to 1 at least, so that this spares the zeros a branch.
        scale = one / np.sqrt(max(a * a + b * b + c * c, one))
        x[i] = a * scale
        y[i] = b * scale
        z[i] = c * scale


@kernel("(float32[::1], float32[:, ::1])")
def channels_first(interleaved, out):
    """Write (H * W * 3,) as (3, H * W)."""
    x, y, z = out[0], out[1], out[2]
    for i in range(x.size):
        x[i] = interleaved[3 * i]
        y[i] = interleaved[3 * i + 1]
        z[i] = interleaved[3 * i + 2]


@kernel("(uint8[::1], int64[::1])")
def widened(stored, out):
    """Write labels as the integers that losses take."""
    for i in range(out.size):
        out[i] = stored[i]
