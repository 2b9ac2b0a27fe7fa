"""The edge-aware method of `estimate_normals`: which noise there is, and what it asks for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.noise import DepthNoise, estimate_noise, noise_of_sigma
from nimprep.derive.percentile import median
from nimprep.kernels.normals_cells import REACH, cell_centres, cell_means, cell_planes
from nimprep.kernels.normals_edge import edge_rows
from nimprep.kernels.normals_fine_cells import (
    AROUND,
    fine_planes,
    keep_level,
    merged_means,
    slope_misses,
)
from nimprep.parallel import run_blocks, run_rows

SIDES = (8, 16)
"""Sides of the cells that are smoothed over, pixels. Cells of 4 gained nothing on streets in
millimetres, half a degree on small round things near by, and took 1.6 times as long."""

# Noise that turns a normal by less is left alone, degrees.
_NIL_DEG = 0.1

# What cells cost in detail, degrees a pixel of their side, and how much of the 7 x 7 cells around
# one takes part in its plane, as a width in cells. Both by trial on synthetic streets.
_DETAIL_DEG = 0.3
_FITTED_CELLS = 5

# Scaled inverse depth lies between 2^-20 and 2^20: errors beyond are as good as this.
_MOST_VARIANCE = 1e20

# Rows of pixels whose cells one thread takes at a time.
_BLOCK_ROWS = 64

Image = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Smoothing:
    """Say over which cells an image is smoothed, and the variances that the kernels take.

    Attributes
    ----------
    side : int
        Of the cells, pixels; 0 = no smoothing.
    variance, quartic : float
        Of scaled inverse depth r: variance + quartic * r**4.
    averaging : float
        The variance of a cell's mean by that of a pixel.
    apart : float
        Where cells are to be quartered if the place asks for it: the variance of a quarter's mean
        where the image is flat, by that of a pixel; 0 = they are not.
    """

    side: int
    variance: float
    quartic: float
    averaging: float
    apart: float = 0.0

    @property
    def noise(self) -> tuple[np.float32, np.float32, np.float32]:
        """Variance, quartic and averaging."""
        variance, quartic = (min(v, _MOST_VARIANCE) for v in (self.variance, self.quartic))
        return np.float32(variance), np.float32(quartic), np.float32(self.averaging)


def edge_normals(
    depth_m: Image,
    camera: Camera,
    sigma: float | None,
    num_threads: int | None,
    out: Image,
    quartered: bool = True,
) -> None:
    """Write edge-aware normals of checked depth into (H, 3 W) `out`.

    Parameters
    ----------
    sigma : float, optional
        Standard deviation of inverse depth, 1/m; None = estimated.
    quartered : bool
        Whether cells may be quartered; not so in versions before it was tried.
    """
    scale = depth_scale(depth_m)
    smoothing = choose_smoothing(depth_m, camera, sigma, float(scale))
    if not quartered:
        smoothing = replace(smoothing, apart=0.0)
    noise, planes = smoothing.noise, np.empty((4, 0, 0), np.float32)
    if smoothing.side > 0:
        planes = cells_planes(depth_m, camera, scale, smoothing, num_threads)
    side = smoothing.side // 2 if smoothing.apart > 0 else smoothing.side
    intrinsics = camera.fx, camera.fy, camera.cx, camera.cy

    def rows(start: int, stop: int) -> None:
        edge_rows(depth_m, start, stop, *intrinsics, scale, noise[0], noise[1], planes, side, out)

    run_rows(rows, depth_m.shape, num_threads)


def depth_scale(depth_m: Image) -> np.float32:
    """Return a power of two that brings the median depth near 1."""
    height, width = depth_m.shape
    sample = depth_m[:: max(height // 32, 1), :: max(width // 32, 1)]
    some = sample[sample > 0]
    # In float64: the mean of two in the middle may leave float32.
    middle = median(some.astype(np.float64)) if some.size else float(depth_m.max())
    exponent = math.frexp(middle)[1]
    return np.float32(2.0 ** -min(max(exponent, -126), 126))


def choose_smoothing(
    depth_m: Image, camera: Camera, sigma: float | None, scale: float
) -> Smoothing:
    """Return how to smooth an image of noise `sigma`, 1/m, or as noisy as it looks."""
    focal = max(camera.fx, camera.fy)
    least = math.radians(_NIL_DEG) / focal
    noise = estimate_noise(depth_m, least) if sigma is None else noise_of_sigma(depth_m, sigma)
    if noise.relative <= least:
        return Smoothing(0, 0.0, 0.0, 1.0)
    side = _side(noise, focal)
    averaging = min(1.0, (noise.length / side) ** 2)
    # Smaller ones than the smallest gain nothing.
    quartered = noise.flat > 0 and side > min(SIDES)
    apart = (noise.flat / noise.sigma * noise.length / (side // 2)) ** 2 if quartered else 0.0
    if noise.power == 0:
        return Smoothing(side, _squared(noise.sigma / scale), 0.0, averaging, apart)
    return Smoothing(side, 0.0, _squared(noise.sigma * scale), averaging, apart)


def _squared(number: float) -> float:
    # Infinity where ** would raise an OverflowError.
    return number * number


def _side(noise: DepthNoise, focal: float) -> int:
    """Return the side of the cells with the least error expected."""
    turned = math.degrees(noise.relative * focal)

    def cost(side: int) -> float:
        # Slope of a plane fitted to (width / length)^2 independent errors over that width.
        width = _FITTED_CELLS * side
        return turned * math.sqrt(12) * noise.length / width**2 + _DETAIL_DEG * side

    return min(SIDES, key=cost)


def cells_planes(
    depth_m: Image,
    camera: Camera,
    scale: np.float32,
    smoothing: Smoothing,
    num_threads: int | None,
) -> Image:
    """Return the planes of all cells, (4, rows, columns), or of their quarters, for `edge_rows`."""
    side, noise = smoothing.side, smoothing.noise
    rows, columns = (-(-size // side) for size in depth_m.shape)
    means, centres = _padded(4, rows, columns), _padded(3, rows, columns)
    planes = np.empty((4, rows, columns), np.float32)
    centre = np.float32(camera.cx), np.float32(camera.cy)
    # Calls cost as much as a tenth of the work: one thread takes all at once.
    step = rows if num_threads == 1 else _BLOCK_ROWS // side

    def each(function: Callable[[int, int], None]) -> None:
        def block(i: int) -> None:
            function(i * step, min((i + 1) * step, rows))

        run_blocks(block, -(-rows // step), num_threads)

    if smoothing.apart > 0:
        half = side // 2
        quarters = _padded(4, 2 * rows, 2 * columns)
        each(lambda a, b: cell_means(depth_m, 2 * a, 2 * b, half, scale, quarters))
        each(lambda a, b: merged_means(quarters, a, b, half, means))
    else:
        each(lambda a, b: cell_means(depth_m, a, b, side, scale, means))
    each(lambda a, b: cell_centres(means, a, b, side, *noise, centres))
    each(lambda a, b: cell_planes(means, centres, a, b, side, *centre, *noise, planes))
    if smoothing.apart > 0:
        return _quarters_planes(quarters, planes, centre, smoothing, each)
    return planes


def _quarters_planes(
    means: Image,
    coarse: Image,
    centre: tuple[np.float32, np.float32],
    smoothing: Smoothing,
    each: Callable[[Callable[[int, int], None]], None],
) -> Image:
    """Return the planes of cells' quarters: their own, or where that is as good the cell's."""
    side, apart = smoothing.side // 2, np.float32(smoothing.apart)
    averaging = min(1.0, 4 * smoothing.averaging)
    noise = replace(smoothing, averaging=averaging).noise
    rows, columns = 2 * coarse.shape[1], 2 * coarse.shape[2]
    centres, planes = _padded(3, rows, columns), np.empty((4, rows, columns), np.float32)
    odd = np.zeros((4, rows + 2, columns + 2), np.float32)
    misses = np.zeros((2, rows + 2 * AROUND, columns + 2 * AROUND), np.float32)

    def fit(a: int, b: int) -> None:
        fine_planes(means, centres, coarse, a, b, side, *centre, *noise, apart, planes, odd)

    each(lambda a, b: cell_centres(means, 2 * a, 2 * b, side, *noise, centres))
    each(lambda a, b: fit(2 * a, 2 * b))
    each(lambda a, b: slope_misses(odd, 2 * a, 2 * b, misses))
    each(lambda a, b: keep_level(misses, coarse, 2 * a, 2 * b, planes))
    return planes


def _padded(channels: int, rows: int, columns: int) -> Image:
    return np.zeros((channels, rows + 2 * REACH, columns + 2 * REACH), np.float32)
