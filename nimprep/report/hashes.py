"""Perceptual hashes: pictures that look alike have hashes that differ in few bits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.report.pictures import Picture

SIDE = 16
"""A hash compares a grid of this many cells a side, each with its right neighbour."""

BITS = SIDE * SIDE

NEAR = 32
"""Hashes that differ in at most this many bits are of nearly the same picture."""

_WORDS = BITS // 64
_BLOCK = 512


def difference_hash(rgb: Picture) -> npt.NDArray[np.uint64]:
    """Return a picture's difference hash, (4,) uint64: is a cell darker than its right neighbour.

    What changes brightness, contrast, size or compression leaves it nearly as it is; another scene
    changes half of the bits. A flat picture has the hash 0.
    """
    import cv2

    # The weights of luma would cost a pass over the whole picture; a small one has few pixels.
    small = cv2.resize(
        np.ascontiguousarray(rgb), (SIDE + 1, SIDE), interpolation=cv2.INTER_AREA
    ).astype(np.float32)
    grey = small @ np.array([0.299, 0.587, 0.114], np.float32)
    bits = grey[:, 1:] > grey[:, :-1]
    return np.packbits(bits.ravel()).view(np.uint64)


def nearest(
    queries: npt.NDArray[np.uint64], others: npt.NDArray[np.uint64]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int64]]:
    """Find for each hash the nearest of others.

    Parameters
    ----------
    queries : (N, 4) uint64
    others : (M, 4) uint64, M > 0

    Returns
    -------
    index : (N,) int
        Into `others`; the first of equally near ones.
    distance : (N,) int64
        Bits that differ.
    """
    index = np.empty(len(queries), np.intp)
    distance = np.empty(len(queries), np.int64)
    for start in range(0, len(queries), _BLOCK):
        block = queries[start : start + _BLOCK]
        bits = np.zeros((len(block), len(others)), np.uint16)
        for word in range(_WORDS):
            bits += np.bitwise_count(block[:, None, word] ^ others[None, :, word])
        best = bits.argmin(axis=1)
        index[start : start + len(block)] = best
        distance[start : start + len(block)] = bits[np.arange(len(block)), best]
    return index, distance
