"""Exact sums over the pixels of an image: how many, their sum, and the sum of their squares."""

from __future__ import annotations

import numpy as np

from nimprep.compilation.decorator import kernel

# Whole pixels and whole vectors: a lane always meets the same channel, and so the loop over lanes
# becomes vector instructions.
_LANES = 192

# 255 ** 2 this often is still an int32.
_ROUNDS = 1 << 15


@kernel()
def _count_colored(image):
    n = 0
    for v in range(image.shape[0]):
        row = image[v]
        for u in range(image.shape[1]):
            n += (row[u, 0] | row[u, 1] | row[u, 2]) != 0
    return n


@kernel("(uint8[:, :, ::1], boolean, int64[:, ::1])")
def color_sums(image, skip_zero, out):
    """Add up (H, W, 3) per channel into (3, 3); `skip_zero` leaves out pixels that are all 0."""
    flat = image.reshape(-1)
    sums, squares = np.zeros(_LANES, np.int64), np.zeros(_LANES, np.int64)
    some, some_squares = np.empty(_LANES, np.int32), np.empty(_LANES, np.int32)
    groups = flat[: flat.size // _LANES * _LANES].reshape(-1, _LANES)
    for first in range(0, groups.shape[0], _ROUNDS):
        some[:] = 0
        some_squares[:] = 0
        for i in range(first, min(first + _ROUNDS, groups.shape[0])):
            group = groups[i]
            for lane in range(_LANES):
                value = np.int32(group[lane])
                some[lane] += value
                some_squares[lane] += value * value
        sums += some
        squares += some_squares
    rest = flat[groups.size :]
    for lane in range(rest.size):
        value = np.int64(rest[lane])
        sums[lane] += value
        squares[lane] += value * value
    n = _count_colored(image) if skip_zero else image.shape[0] * image.shape[1]
    for channel in range(3):
        out[channel, 0] += n
        out[channel, 1] += sums[channel::3].sum()
        out[channel, 2] += squares[channel::3].sum()


@kernel("(uint16[:, ::1], int64[::1])")
def depth_sums(depth, out):
    """Add up the pixels of (H, W) that are not 0 into (3,)."""
    for v in range(depth.shape[0]):
        n, total, square = 0, 0, 0
        for u in range(depth.shape[1]):
            value = int(depth[v, u])
            n += 1 if value != 0 else 0
            total += value
            square += value * value
        out[0] += n
        out[1] += total
        out[2] += square


@kernel("(uint16[:, ::1], int64[::1])")
def count_values(image, out):
    """Count how often each value occurs in (H, W), into (65536,)."""
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            out[image[v, u]] += 1
