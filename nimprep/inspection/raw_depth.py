"""What raw depth images have in common: their values, and how these change towards the bottom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.inspection.samples import Sample

FULL = 65535
_SOME = 200_000


@dataclass(frozen=True)
class RawDepth:
    """Hold raw depth planes and figures of their values.

    Attributes
    ----------
    planes : tuple of (H, W) float64
        Raw numbers; NaN = certainly none (0, not finite, or set apart).
    whole : bool
        They are whole numbers.
    empty : float
        Share of pixels that are 0 or not finite.
    apart : tuple of float
        Values that stand for none: at the top of the range and far from all others.
    least, median, most : float
        Percentiles 1, 50 and 99 of what is left.
    negative : bool
    stretched : bool
        Every image reaches smoothly from nothing to full scale, as relative depth does.
    """

    planes: tuple[npt.NDArray[np.float64], ...]
    whole: bool
    empty: float
    apart: tuple[float, ...]
    least: float
    median: float
    most: float
    negative: bool
    stretched: bool = False

    @property
    def width(self) -> int:
        return int(self.planes[0].shape[1])

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """All that are depth, a sample of them where there are many."""
        every = np.concatenate([plane[np.isfinite(plane)] for plane in self.planes])
        return every[:: max(1, every.size // _SOME)]


def raw_depth_of(planes: Sequence[npt.NDArray[Any]]) -> RawDepth | None:
    """Return the figures of raw planes; None = no pixel has a value."""
    whole = planes[0].dtype.kind in "ui"
    wide = [plane.astype(np.float64) for plane in planes]
    total = sum(plane.size for plane in wide)
    none = sum(int(((plane == 0) | ~np.isfinite(plane)).sum()) for plane in wide)
    for plane in wide:
        plane[(plane == 0) | ~np.isfinite(plane)] = np.nan
    negative = any(bool((plane < 0).any()) for plane in wide)
    for plane in wide:
        plane[plane < 0] = np.nan
    apart = _apart(wide, planes[0].dtype)
    stretched = planes[0].dtype == np.uint16 and len(planes) > 1 and all(map(_is_stretched, planes))
    for plane in wide:
        for value in apart:
            plane[plane == value] = np.nan
    every = np.concatenate([plane[np.isfinite(plane)] for plane in wide])
    if every.size == 0:
        return None
    some = every[:: max(1, every.size // _SOME)]
    low, middle, high = (float(x) for x in np.percentile(some, (1, 50, 99)))
    share = none / total
    return RawDepth(tuple(wide), whole, share, apart, low, middle, high, negative, stretched)


def _is_stretched(plane: npt.NDArray[Any]) -> bool:
    """Tell whether an image has 0, full scale and values that come near to both."""
    ends = int(plane.min()) == 0 and int(plane.max()) == FULL
    low, high = ((plane > 0) & (plane < 0.03 * FULL)), ((plane > 0.97 * FULL) & (plane < FULL))
    return ends and bool(low.any()) and bool(high.any())


def _apart(planes: Sequence[npt.NDArray[np.float64]], dtype: np.dtype[Any]) -> tuple[float, ...]:
    """Return the largest value, where it can only stand for none: full scale, or far from all."""
    every = np.concatenate([plane[np.isfinite(plane)] for plane in planes])
    if every.size == 0:
        return ()
    top = float(every.max())
    rest = every[every < top]
    share = 1 - rest.size / every.size
    full = dtype.kind == "u" and top in (FULL, 2**24 - 1, 2**32 - 1)
    if rest.size == 0 or share == 0:
        return ()
    if full or (share > 0.002 and float(rest.max()) < 0.5 * top and top > 100):
        return (top,)
    return ()


@dataclass(frozen=True)
class Ground:
    """Say how raw values change towards the bottom of the images, where a ground would be.

    Attributes
    ----------
    slope : float
        Of the logarithm of values over the lower half, sign alone counts: depth falls.
    depth_height : float
        Camera height over focal length, raw units, if values are depth: `1 / d(1/raw)/dv`.
    depth_fit, disparity_fit : float
        Shares of variance that a line explains of 1/raw and of raw, over rows.
    disparity_rate : float
        Raw disparity per row.
    """

    slope: float
    depth_height: float
    depth_fit: float
    disparity_fit: float
    disparity_rate: float


def ground_of(raw: RawDepth) -> Ground | None:
    """Fit lines over the rows of the lower 45 %; None = too few rows have values."""
    found = [line for plane in raw.planes if (line := _ground_of(plane)) is not None]
    if len(found) < max(1, len(raw.planes) // 2):
        return None
    columns = np.median(np.array(found), axis=0)
    return Ground(*(float(column) for column in columns))


def _ground_of(plane: npt.NDArray[np.float64]) -> tuple[float, ...] | None:
    height = plane.shape[0]
    rows, medians = [], []
    step = max(1, height // 400)
    for row in range(int(0.55 * height), height, step):
        values = plane[row][np.isfinite(plane[row])]
        if values.size >= max(3, plane.shape[1] // 50):
            rows.append(row)
            medians.append(float(np.median(values)))
    if len(rows) < 8:
        return None
    v, z = np.array(rows, float), np.array(medians)
    inverse, depth_fit = _line(v, 1 / z)
    rate, disparity_fit = _line(v, z)
    slope, _ = _line(v, np.log(z))
    height_raw = 1 / inverse if inverse > 0 else np.inf
    return slope, height_raw, depth_fit, disparity_fit, rate


def _line(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return a line's slope, and the share of variance that it explains."""
    if float(np.ptp(y)) == 0:
        return 0.0, 0.0
    slope, start = np.polyfit(x, y, 1)
    rest = y - (slope * x + start)
    return float(slope), float(1 - rest.var() / y.var())


def focal_length(numbers: Mapping[str, float], size: tuple[int, int]) -> tuple[float, bool]:
    """Return fy for images of a size, pixels, and whether a camera file gave it.

    Numbers for another size are scaled by where they have the principal point.
    """
    width, height = size
    fy, cx, cy = (numbers.get(name, 0.0) for name in ("fy", "cx", "cy"))
    if fy <= 0:
        return 0.75 * width, False
    fits = 0.25 * width < cx < 0.75 * width and 0.05 * height < cy < 0.95 * height
    return (fy if fits or cx <= 0 else fy * width / (2 * cx)), True


def planes_of(samples: Sequence[Sample], channel: str = "") -> list[npt.NDArray[Any]]:
    """Return samples' single planes, of several channels the one that counts."""
    place = "RGBA".index(channel) if channel else 0
    return [s.pixels if s.pixels.ndim == 2 else s.pixels[..., place] for s in samples]
