"""Mean and standard deviation per channel over a split, from exact sums kept per frame.

A frame's sums depend on the frame alone, so that splitting a store anew leaves them right: the
statistics of a split are made of its frames' sums when they are asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.frame import IGNORE_LABEL
from nimprep.modality import MODALITIES, Modality
from nimprep.parallel import map_in_order

if TYPE_CHECKING:
    from nimprep.store.reader import Store

ROWS: dict[str, slice] = {"rgb": slice(0, 3), "depth": slice(3, 4), "hha": slice(4, 7)}
"""Which rows of a frame's sums belong to a modality; a row per channel."""

SUMS_SHAPE = (7, 3)
"""Of one frame's sums: channels, then count, sum and sum of squares; planes have rows below."""


@dataclass(frozen=True)
class ChannelStatistics:
    """Hold a modality's statistics over the pixels that have a value.

    Attributes
    ----------
    mean, std : tuple of float
        Per channel: rgb and hha in 0-255, depth in metres, planes in their units.
    """

    mean: tuple[float, ...]
    std: tuple[float, ...]


def channel_sums(
    images: Mapping[str, npt.NDArray[Any]], planes: Sequence[Modality] = ()
) -> npt.NDArray[np.int64]:
    """Add up one frame's images.

    Parameters
    ----------
    images : mapping of modality to array
        As the store holds them, without padding, C-contiguous: rgb and hha (H, W, 3) uint8, depth
        (H, W) uint16, planes (H, W) of their dtype. Others are passed over.
    planes : sequence of Modality
        The store's, in order.

    Returns
    -------
    (7 + P, 3) int64
        Per channel (red, green, blue, depth, the three of HHA, each plane) the number of pixels,
        the sum of their values and the sum of their squares. Pixels without depth (0) do not
        count, nor do those without HHA (all 0) and those that a plane says are none. Zeros where
        the frame lacks the modality.
    """
    from nimprep.kernels.sums import color_sums, depth_sums

    sums = np.zeros((SUMS_SHAPE[0] + len(planes), SUMS_SHAPE[1]), dtype=np.int64)
    for row, plane in zip(sums[SUMS_SHAPE[0] :], planes, strict=True):
        if plane.name in images:
            row[:] = _plane_sums(plane, images[plane.name])
    for name in ROWS.keys() & images.keys():
        rows, values = sums[ROWS[name]], MODALITIES[name].values
        if values == "numbers":
            depth_sums(images[name], rows[0])
        else:
            color_sums(images[name], values == "levels", rows)
    return sums


def _plane_sums(plane: Modality, image: npt.NDArray[Any]) -> tuple[int, int, int]:
    values = image[image != plane.fill] if plane.has_none else image.reshape(-1)
    wide = values.astype(np.int64)
    return wide.size, int(wide.sum()), int(wide @ wide)


def byte_histogram(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Count the 256 values of an (H, W) uint8 image."""
    import cv2

    # OpenCV's takes a tenth of bincount's time, and lets other threads run; it counts in float32.
    if image.size >= 1 << 24:
        return np.bincount(image.ravel(), minlength=256)
    whole = np.ascontiguousarray(image)
    return cv2.calcHist([whole], [0], None, [256], [0, 256]).ravel().astype(np.int64)


def class_pixels(label: npt.NDArray[np.uint8] | None, ids: Sequence[int]) -> npt.NDArray[np.uint32]:
    """Count the pixels of each class in one frame's label.

    Parameters
    ----------
    label : (H, W) uint8, optional
        Without padding; None = the frame has none.
    ids : sequence of int
        Of the classes.

    Returns
    -------
    (K + 1,) uint32
        Of each class, and last of the pixels to be ignored. Other values are in no class.
    """
    counts = np.zeros(256, np.int64) if label is None else byte_histogram(label)
    return counts[[*ids, IGNORE_LABEL]].astype(np.uint32)


def class_pixels_of(store: Store) -> npt.NDArray[np.uint32]:
    """Return the number of pixels of each class in every frame of a store, (N, K + 1).

    From its table; a store of format 1.0 has none, and its labels are read.

    Raises
    ------
    StoreError
        A label is damaged or gone.
    """
    if store.tables.class_pixels is not None:
        return store.tables.class_pixels
    ids, arrays = store.about.class_ids, store.arrays.values()
    labels = next((array for array in arrays if array.modality.values == "classes"), None)
    if labels is None:
        return np.zeros((len(store), len(ids) + 1), np.uint32)

    def count(index: int) -> npt.NDArray[np.uint32]:
        height, width = store.tables.image_size[index]
        return class_pixels(labels.read(index)[:height, :width], ids)

    return np.stack(list(map_in_order(count, range(len(store)))))


def combine_sums(
    sums: npt.NDArray[np.int64],
    planes: Sequence[Modality] = (),
    held: Mapping[str, Modality] = MODALITIES,
) -> dict[str, ChannelStatistics]:
    """Return the statistics of frames from their sums, (N, 7 + P, 3) int64; of planes in units.

    `held` are the modalities as the store holds them: depth counts in its unit.
    Modalities without any pixel are left out. The standard deviation is the population's.
    """
    # Python's integers: the squares of some thousand frames of far depth pass 2**63.
    total = sums.astype(object).sum(axis=0)
    statistics = {}
    for name, rows in ROWS.items():
        number_of = held.get(name, MODALITIES[name]).number_of
        if len(sums) == 0 or total[rows][0, 0] == 0:
            continue
        mean = tuple(number_of(int(s) / int(n)) for n, s, _ in total[rows])
        # n * sum(x^2) - sum(x)^2 in integers: a difference of floats would lose what matters.
        spread = (math.sqrt(int(n) * int(q) - int(s) ** 2) / int(n) for n, s, q in total[rows])
        statistics[name] = ChannelStatistics(mean, tuple(map(number_of, spread)))
    for plane, (n, s, q) in zip(planes, total[SUMS_SHAPE[0] :], strict=True):
        if len(sums) and n:
            mean = (int(s) / int(n) * plane.scale + plane.offset,)
            deviation = math.sqrt(int(n) * int(q) - int(s) ** 2) / int(n) * plane.scale
            statistics[plane.name] = ChannelStatistics(mean, (deviation,))
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
    return combine_sums(store.tables.channel_sums[frames], store.planes, store.stored)
