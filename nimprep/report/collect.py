"""One pass over a store: what the page's charts and findings are made of."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.frame import IGNORE_LABEL
from nimprep.modality import MODALITIES, Modality
from nimprep.parallel import Progress, map_in_order, no_progress
from nimprep.report.hashes import difference_hash
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store
from nimprep.store.statistics import byte_histogram

Counts = npt.NDArray[np.int64]

SAMPLED_PIXELS = 1 << 16
"""Distributions take about this many pixels of a frame: every n-th row and column."""

DIRECTION_BINS = 75
"""Cells a side of the histogram of normals."""

DIRECTION_REACH = 1.5
"""Half the side of that histogram; 1 is the circle of normals at right angles to the view."""

POOLED = 256
"""Values kept of a frame of an image that has no histogram of its own."""

_BLOCK = 16
_DEPTH_LEVELS = 1 << 16
_LEVELS = 256


@dataclass(eq=False)
class Sums:
    """Hold what adds up over frames; every count is of pixels.

    Attributes
    ----------
    depth : (4, 65536) int64
        Depth in the store's unit by split (train, val, test, none), of sampled pixels; column 0 =
        none.
    holes, seen : (h, w) int64
        Of each sampled place in the image: frames without depth there, and frames that reach it.
    directions : (75, 75) int64
        Normals by where they lie on the sphere, equal areas; rows from up to down, columns from
        left to right, the centre = towards the camera. `directions_outside` counts the rest.
    hha : (3, 256) int64
        Levels of each channel, where there is HHA.
    """

    depth: Counts
    holes: Counts
    seen: Counts
    directions: Counts
    hha: Counts
    directions_outside: int = 0

    @classmethod
    def zeros(cls, shape: tuple[int, int]) -> Sums:
        """Return empty sums for a sampled image of this shape."""
        return cls(
            depth=np.zeros((len(SPLIT_CODES), _DEPTH_LEVELS), np.int64),
            holes=np.zeros(shape, np.int64),
            seen=np.zeros(shape, np.int64),
            directions=np.zeros((DIRECTION_BINS, DIRECTION_BINS), np.int64),
            hha=np.zeros((3, _LEVELS), np.int64),
        )

    def add(self, other: Sums) -> None:
        """Add another part's sums."""
        for name in ("depth", "holes", "seen", "directions", "hha"):
            getattr(self, name).__iadd__(getattr(other, name))
        self.directions_outside += other.directions_outside


@dataclass(eq=False)
class Collected:
    """Hold a store's statistics: per frame, and summed.

    Attributes
    ----------
    step : int
        Distributions take every so-manieth row and column of the image.
    pixels : (N,) int64
        Of each frame, padding left out.
    valid : (N,) int64
        Pixels with depth.
    farthest, at_farthest : (N,) int64
        The greatest depth of a frame, in the store's unit, and how many pixels have it.
    classes : (N, C) int64
        Pixels of each of the store's classes.
    ignored, undeclared : (N,) int64
        Pixels labelled 255, and those labelled with an id that is no class.
    hashes : (N, 4) uint64
        Of the colour images.
    sums : Sums
    pooled : dict of str to (N, 256) float32
        Some values of each other modality, in its unit; NaN = none.
    depth : Modality
        As the store holds it.
    """

    step: int
    pixels: Counts
    valid: Counts
    farthest: Counts
    at_farthest: Counts
    classes: Counts
    ignored: Counts
    undeclared: Counts
    hashes: npt.NDArray[np.uint64]
    sums: Sums
    pooled: dict[str, npt.NDArray[np.float32]] = field(default_factory=dict)
    depth: Modality = MODALITIES["depth"]

    @property
    def hole_share(self) -> npt.NDArray[np.float64]:
        """(N,) share of a frame's pixels without depth, 0 to 1."""
        return np.asarray(1 - self.valid / self.pixels)


def collect(
    store: Store, progress: Progress | None = None, num_threads: int | None = None
) -> Collected:
    """Read every frame once and count.

    Shares of holes and classes are of every pixel; distributions of every `step`-th row and column
    (all of them in a small image). The result is the same on any number of threads.

    Raises
    ------
    StoreError
        The store is damaged.
    """
    number = len(store)
    height, width = next(iter(store.arrays.values())).shape[1:3]
    step = max(1, math.ceil(math.sqrt(height * width / SAMPLED_PIXELS)))
    sampled = (-(-height // step), -(-width // step))
    zeros = (np.zeros(number, np.int64) for _ in range(5))
    valid, farthest, at_farthest, ignored, undeclared = zeros
    found = Collected(
        step=step,
        pixels=store.tables.image_size.astype(np.int64).prod(axis=1),
        valid=valid,
        farthest=farthest,
        at_farthest=at_farthest,
        classes=np.zeros((number, len(store.classes)), np.int64),
        ignored=ignored,
        undeclared=undeclared,
        hashes=np.zeros((number, 4), np.uint64),
        sums=Sums.zeros(sampled),
        pooled={
            name: np.full((number, POOLED), np.nan, np.float32)
            for name in store.modalities
            if name not in _COUNTS
        },
        depth=store.stored.get("depth", MODALITIES["depth"]),
    )
    done = (progress or no_progress)("looking", number)
    blocks = [range(i, min(i + _BLOCK, number)) for i in range(0, number, _BLOCK)]

    def work(frames: range) -> Sums:
        part = Sums.zeros(sampled)
        for frame in frames:
            _add_frame(store, frame, found, part)
            done()
        return part

    for part in map_in_order(work, blocks, num_threads):
        found.sums.add(part)
    return found


def _add_frame(store: Store, index: int, found: Collected, part: Sums) -> None:
    """Count one frame into its rows of `found` and into `part`."""
    height, width = (int(n) for n in store.tables.image_size[index])
    for name, array in store.arrays.items():
        image = array.read(index)[:height, :width]
        if name in _COUNTS:
            _COUNTS[name](image, store, index, found, part)
        else:
            values = _spread(image, POOLED)
            found.pooled[name][index, : values.size] = physical(store, name, values)


def _split_row(code: int) -> int:
    """Return a split's row of `Sums.depth`; what is no split counts as none."""
    codes = list(SPLIT_CODES.values())
    return codes.index(code) if code in codes else len(codes) - 1


def _count_colors(
    image: npt.NDArray[np.uint8], store: Store, index: int, found: Collected, part: Sums
) -> None:
    found.hashes[index] = difference_hash(image[:: found.step, :: found.step])


def _count_depth(
    image: npt.NDArray[np.uint16], store: Store, index: int, found: Collected, part: Sums
) -> None:
    found.valid[index] = np.count_nonzero(image)
    farthest = image.max()
    found.farthest[index] = farthest
    if farthest:
        found.at_farthest[index] = np.count_nonzero(image == farthest)
    sample = image[:: found.step, :: found.step]
    split = _split_row(int(store.tables.split[index]))
    part.depth[split] += np.bincount(sample.ravel(), minlength=_DEPTH_LEVELS)
    rows, columns = sample.shape
    part.holes[:rows, :columns] += sample == 0
    part.seen[:rows, :columns] += 1


def _count_labels(
    image: npt.NDArray[np.uint8], store: Store, index: int, found: Collected, part: Sums
) -> None:
    ids = [c.id for c in store.classes]
    counts = byte_histogram(image)
    found.classes[index] = counts[ids]
    found.ignored[index] = counts[IGNORE_LABEL]
    found.undeclared[index] = image.size - counts[list({*ids, IGNORE_LABEL})].sum()


def _count_directions(normal: npt.NDArray[Any], part: Sums) -> None:
    """Place normals, (h, w, 3) of any length, by Lambert's equal-area projection.

    The projection of a unit vector n, centred on (0, 0, -1), is (n_x, n_y) / sqrt(1 - n_z): 1 where
    n_z = 0. Areas of the disc are to each other as areas of the sphere.
    """
    # One array per component: the last axis of three is slow to work along.
    x, y, z = (normal[:, :, i].ravel().astype(np.float32) for i in range(3))
    length = np.sqrt(x * x + y * y + z * z)
    known = length > 0
    # L - Z is 0 only straight away from the camera, where no visible surface looks.
    divisor = np.sqrt(np.maximum(length * (length - z), np.float32(1e-12)))
    scale = np.float32(DIRECTION_BINS / (2 * DIRECTION_REACH)) / divisor
    middle = np.float32(DIRECTION_BINS / 2)
    column, row = (np.floor(v * scale + middle).astype(np.intp) for v in (x, y))
    inside = known & (np.minimum(column, row) >= 0) & (np.maximum(column, row) < DIRECTION_BINS)
    part.directions_outside += int(known.sum() - inside.sum())
    cells = (row * DIRECTION_BINS + column)[inside]
    flat = np.bincount(cells, minlength=DIRECTION_BINS**2)
    part.directions += flat.reshape(DIRECTION_BINS, DIRECTION_BINS)


def _count_hha(hha: npt.NDArray[np.uint8], part: Sums) -> None:
    channels = [hha[:, :, i].ravel() for i in range(3)]
    known = (channels[0] | channels[1] | channels[2]) > 0
    for channel, values in enumerate(channels):
        part.hha[channel] += np.bincount(values[known], minlength=_LEVELS)


def _count_normals(
    image: npt.NDArray[Any], store: Store, index: int, found: Collected, part: Sums
) -> None:
    _count_directions(image[:: found.step, :: found.step], part)


def _count_levels(
    image: npt.NDArray[np.uint8], store: Store, index: int, found: Collected, part: Sums
) -> None:
    _count_hha(image[:: found.step, :: found.step], part)


_COUNTS: dict[str, Callable[[npt.NDArray[Any], Store, int, Collected, Sums], None]] = {
    "rgb": _count_colors,
    "depth": _count_depth,
    "normal": _count_normals,
    "hha": _count_levels,
    "label": _count_labels,
}
"""What is counted of modalities with charts or findings of their own; the others are pooled."""


def _spread(image: npt.NDArray[Any], count: int) -> npt.NDArray[Any]:
    """Return at most so many values of an image, evenly spread over its pixels."""
    flat = image.reshape(-1)
    chosen = np.linspace(0, flat.size - 1, min(count, flat.size)).astype(np.intp)
    return flat[chosen]


def physical(store: Store, name: str, stored: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return stored values in the unit that the array's CF attributes name; NaN = none."""
    attributes = store.arrays[name].spec.attributes
    scale, offset = attributes.get("scale_factor", 1), attributes.get("add_offset", 0)
    values = stored.astype(np.float32) * np.float32(scale) + np.float32(offset)
    if "_FillValue" in attributes:
        values[stored == attributes["_FillValue"]] = np.nan
    return np.asarray(values)
