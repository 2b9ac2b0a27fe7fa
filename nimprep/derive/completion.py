"""Fill the holes of a depth image."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.depth import checked_depth
from nimprep.derive.colorization import fill_by_colorization
from nimprep.derive.methods import FILL_METHODS as FILL_METHODS
from nimprep.derive.methods import FillMethod as FillMethod
from nimprep.errors import ArrayError
from nimprep.kernels.completion_delaunay import triangulate
from nimprep.kernels.completion_linear import border_points, fill_triangles
from nimprep.kernels.completion_nearest import fill_nearest, nearest_rows
from nimprep.parallel import run_blocks

_BLOCK_ROWS = 32
_BLOCK_COLUMNS = 256
# Each band looks at every triangle, so there are few.
_BANDS = 4


def fill_depth(
    depth_m: Any,
    method: FillMethod = "linear",
    rgb: Any = None,
    num_threads: int | None = None,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """Fill the pixels without depth from those with depth, which stay as they are.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0, NaN, infinity and what is masked = none, as below 0.1 mm.
    method : {"linear", "nearest", "colorization"}
        How to fill; see Notes. "linear" leaves what lies outside the convex hull of the known
        pixels; the others fill every pixel.
    rgb : (H, W, 3) uint8 or (H, W) uint8, optional
        The picture, channels R, G, B, or its grey; "colorization" needs it, the others ignore it.
    num_threads : int, optional
        None = one thread per core, 1 = the calling thread alone. The result is the same.

    Returns
    -------
    filled : (H, W) float32, metres
        0 where still unknown.
    mask : (H, W) bool
        True where a depth was filled in.

    Raises
    ------
    ArrayError
        An array of the wrong shape, type or values, no known pixel at all, or an unknown method.
    NimprepError
        "colorization" without SciPy.

    Notes
    -----
    nearest
        The depth of the nearest known pixel by exact distance; of several equally near the
        left-most, then the upper.
    linear
        Linear in u and v over the Delaunay triangles of the known pixels. Where more than three
        known pixels lie on one circle without another inside, several triangulations are Delaunay
        and the positions alone decide which is taken. Without three known pixels off a line there
        is no triangle, and nothing is filled.
    colorization
        Each unknown pixel is the mean of its eight neighbours weighted by the likeness of their
        grey, and known pixels are held to their depth with weight 1, as in the NYUv2 toolbox;
        known pixels then keep their own depth. Seconds per frame; needs SciPy.

    References
    ----------
    Levin et al., Colorization using optimization, SIGGRAPH 2004. Silberman et al., Indoor
    segmentation and support inference from RGBD images, ECCV 2012.
    """
    if method not in FILL_METHODS:
        raise ArrayError(f"method: expected one of {', '.join(FILL_METHODS)}, found {method!r}")
    depth = checked_depth(depth_m)
    unknown = depth == 0
    if unknown.all():
        raise ArrayError("depth_m: expected at least one pixel with depth, found none")
    filled = depth.copy()
    if unknown.any():
        if method == "nearest":
            _fill_nearest(depth, filled, num_threads)
        elif method == "linear":
            _fill_linear(depth, filled, num_threads)
        else:
            fill_by_colorization(depth, rgb, filled)
    return filled, unknown & (filled > 0)


def _fill_nearest(
    depth: npt.NDArray[np.float32], out: npt.NDArray[np.float32], num_threads: int | None
) -> None:
    height, width = depth.shape
    rows = np.empty(depth.shape, np.int32)

    def search_columns(block: int) -> None:
        first = block * _BLOCK_COLUMNS
        nearest_rows(depth, first, min(first + _BLOCK_COLUMNS, width), rows)

    def search_rows(block: int) -> None:
        first = block * _BLOCK_ROWS
        fill_nearest(depth, rows, first, min(first + _BLOCK_ROWS, height), out)

    run_blocks(search_columns, -(-width // _BLOCK_COLUMNS), num_threads)
    run_blocks(search_rows, -(-height // _BLOCK_ROWS), num_threads)


def _fill_linear(
    depth: npt.NDArray[np.float32], out: npt.NDArray[np.float32], num_threads: int | None
) -> None:
    height, width = depth.shape
    # What the triangulation's products and its numbers of edges can hold.
    if 6 * (height**2 + width**2) * height * width >= 1 << 63 or 6 * depth.size >= 1 << 31:
        raise ArrayError(
            f"depth_m: expected a smaller image for 'linear', found {width}x{height}; "
            "fill parts of it, or use 'nearest'"
        )
    known = int(np.count_nonzero(depth))
    points = np.empty((known, 2), np.int64)
    points = points[: border_points(depth, points)]
    if len(points) < 3:
        return
    triangles = np.empty((2 * len(points), 3), np.int32)
    count = triangulate(points, triangles)
    rows = -(-height // _BANDS)

    def interpolate(band: int) -> None:
        first = min(band * rows, height)
        last = min(first + rows, height)
        fill_triangles(depth, points, triangles, count, first, last, out)

    run_blocks(interpolate, _BANDS, num_threads)
