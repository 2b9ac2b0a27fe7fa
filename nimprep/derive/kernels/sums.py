"""Exact sums over the pixels of an image: how many, their sum, and the sum of their squares."""

from __future__ import annotations

from numba import njit


@njit(["(uint8[:, :, ::1], boolean, int64[:, ::1])"], cache=True, nogil=True, error_model="numpy")
def color_sums(image, skip_zero, out):
    """Add up (H, W, 3) per channel into (3, 3); `skip_zero` leaves out pixels that are all 0."""
    for v in range(image.shape[0]):
        n, s0, s1, s2, q0, q1, q2 = 0, 0, 0, 0, 0, 0, 0
        for u in range(image.shape[1]):
            a, b, c = int(image[v, u, 0]), int(image[v, u, 1]), int(image[v, u, 2])
            n += 1 if not skip_zero or (a | b | c) != 0 else 0
            s0 += a
            s1 += b
            s2 += c
            q0 += a * a
            q1 += b * b
            q2 += c * c
        for channel in range(3):
            out[channel, 0] += n
        out[0, 1] += s0
        out[1, 1] += s1
        out[2, 1] += s2
        out[0, 2] += q0
        out[1, 2] += q1
        out[2, 2] += q2


@njit(["(uint16[:, ::1], int64[::1])"], cache=True, nogil=True, error_model="numpy")
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
