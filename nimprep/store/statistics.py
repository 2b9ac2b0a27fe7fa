"""Mean and standard deviation per channel over a split, from exact sums kept per frame.

A frame's sums depend on the frame alone, so that splitting a store anew leaves them right: the
statistics of a split are made of its frames' sums when they are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.modality import MODALITIES

if TYPE_CHECKING:
    from nimprep.store.reader import Store

ROWS: dict[str, slice] = {"rgb": slice(0, 3), "depth": slice(3, 4), "hha": slice(4, 7)}
"""Which rows of a frame's sums belong to a modality; a row per channel."""

SUMS_SHAPE = (7, 3)
"""Of one frame's sums: channels, then count, sum and sum of squares."""


@dataclass(frozen=True)
class ChannelStatistics:
    """Hold a modality's statistics over the pixels that have a value.

    Attributes
    ----------
    mean, std : tuple of float
        Per channel: rgb and hha in 0-255, depth in metres.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]


def channel_sums(images: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[np.int64]:
    """Add up one frame's images.

    Parameters
    ----------
    images : mapping of modality to array
        As the store holds them, without padding, C-contiguous: rgb and hha (H, W, 3) uint8, depth
        (H, W) uint16 millimetres. Others are passed over.

    Returns
    -------
    (7, 3) int64
        Per channel (red, green, blue, depth, the three of HHA) the number of pixels, the sum of
        their values and the sum of their squares. Pixels without depth (0) do not count, nor do
        those without HHA (all 0). Zeros where the frame lacks the modality.
    """
    from nimprep.kernels.sums import color_sums, depth_sums

    sums = np.zeros(SUMS_SHAPE, dtype=np.int64)
    for name in ROWS.keys() & images.keys():
        rows, values = sums[ROWS[name]], MODALITIES[name].values
        if values == "numbers":
            depth_sums(images[name], rows[0])
        else:
            color_sums(images[name], values == "levels", rows)
    return sums


def combine_sums(sums: npt.NDArray[np.int64]) -> dict[str, ChannelStatistics]:
    """Return the statistics of frames from their sums, (N, 7, 3) int64.

    Modalities without any pixel are left out. The standard deviation is the population's.
    """
    # Python's integers: the squares of some thousand frames of far depth pass 2**63.
    total = sums.astype(object).sum(axis=0)
    statistics = {}
    for name, rows in ROWS.items():
        unit = MODALITIES[name].steps
        if len(sums) == 0 or total[rows][0, 0] == 0:
            continue
        mean = tuple(int(s) / int(n) / unit for n, s, _ in total[rows])
        # n * sum(x^2) - sum(x)^2 in integers: a difference of floats would lose what matters.
        spread = (math.sqrt(int(n) * int(q) - int(s) ** 2) / int(n) for n, s, q in total[rows])
        statistics[name] = ChannelStatistics(mean, tuple(s / unit for s in spread))
    return statistics


def channel_statistics(store: Store, split: str | None = "train") -> dict[str, ChannelStatistics]:
    """Return the statistics of a split's frames, by modality.

    From the store's `channel_sums` table; no image is read.

    Raises
    ------
    StoreError
        The split has no frames.
    """
    frames = store.indices(split)
    if len(frames) == 0:
        raise StoreError(
            f"{store.path}: expected frames in split {split!r} for its statistics, found none; "
            "split the store anew with nimprep split"
        )
    return combine_sums(store.tables.channel_sums[frames])
