"""Arrays whose memory is used again once nobody holds them.

A fresh array of some megabytes costs a page fault per 4 KiB when it is first written to, which for
a 720p frame took longer than decompressing it. Memory that was written to before has none. An
array from here keeps its block alive, as do views of it; when the last of them is gone, the block
waits for the next array of its size.
"""

from __future__ import annotations

import math
from collections import defaultdict, deque
from typing import Any

import numpy as np
import numpy.typing as npt

_GRAIN = 1 << 18
"""Blocks are multiples of this many bytes, so that images of nearly one size share them."""

_KEPT = 8
"""Free blocks kept per size."""

_free: defaultdict[int, deque[npt.NDArray[np.uint8]]] = defaultdict(lambda: deque(maxlen=_KEPT))


class _Lease:
    """Own a block while an array uses it; give it back when the array is gone."""

    def __init__(self, size: int) -> None:
        try:
            self._block = _free[size].pop()
        except IndexError:
            self._block = np.empty(size, dtype=np.uint8)
        self.__array_interface__ = self._block.__array_interface__

    def __del__(self) -> None:
        _free[self._block.nbytes].append(self._block)


def empty(shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return an uninitialised C-contiguous array, as `numpy.empty` does."""
    dtype = np.dtype(dtype)
    count = math.prod(shape)
    if count * dtype.itemsize < _GRAIN:
        return np.empty(shape, dtype=dtype)
    size = -(-count * dtype.itemsize // _GRAIN) * _GRAIN
    block = np.asarray(_Lease(size))
    return block[: count * dtype.itemsize].view(dtype).reshape(shape)
