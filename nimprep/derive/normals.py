"""Surface normals from depth and a pinhole camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.depth import checked_depth
from nimprep.derive.kernels.normals import nim_rows
from nimprep.derive.threads import available_cores, run_blocks
from nimprep.errors import ArrayError

_KERNELS = {"nim": nim_rows}

METHODS = tuple(_KERNELS)
"""What `estimate_normals` takes as `method`."""

# Blocks for each thread: the last to end then keeps the others waiting for little.
_BLOCKS_PER_THREAD = 4

# Below this many pixels a block costs less than handing it to a thread.
_LEAST_BLOCK_PIXELS = 1 << 14


def estimate_normals(
    depth_m: npt.ArrayLike,
    camera: Camera,
    method: str = "nim",
    sign_filter: bool = False,
    out: npt.NDArray[np.float32] | None = None,
    num_threads: int | None = None,
) -> npt.NDArray[np.float32]:
    """Estimate surface normals from a depth image.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        Depth along z; 0 or NaN = none. Computed in float32.
    camera : Camera
        Of the image's size.
    method : str
        "nim", the paper's: the gradient of inverse depth gives n_x and n_y; each of the four
        neighbours whose depth differs gives an n_z, and the unit vectors are summed.
    sign_filter : bool
        Sum only the neighbours whose n_z has the majority's sign, before orientation. A tie
        counts as positive. An n_z of exactly 0 has no sign: it is left out unless all are 0.
    out : (H, W, 3) float32, C-contiguous, optional
        Where to write the result; must not overlap the depth.
    num_threads : int, optional
        None = all cores; 1 = the calling thread alone. Safe to call from many threads at once,
        which beats threads within a frame where there are many frames. The result is the same
        to the bit.

    Returns
    -------
    (H, W, 3) float32
        Unit vectors (n_x, n_y, n_z) in the camera frame (x right, y down, z forward), pointing at
        the camera: n·P <= 0. (0, 0, 0) exactly where there is no depth. At the border and beside
        holes from the neighbours there are: a difference with one of its two sides missing is
        one-sided and doubled, with both missing 0. Where no neighbour's depth differs, or the
        gradient is exactly 0, (0, 0, -1).

    Raises
    ------
    ArrayError
        The depth is no floating (H, W) array of the camera's size or holds negative or infinite
        values; `out` does not fit; `method` is unknown; `num_threads` is not positive.

    References
    ----------
    Wang et al., "Applying surface normal information in drivable area and road anomaly detection
    for ground mobile robots", IROS 2020.
    """
    if method not in _KERNELS:
        known = ", ".join(repr(name) for name in METHODS)
        raise ArrayError(f"method: expected one of {known}, found {method!r}")
    kernel = _KERNELS[method]
    depth = checked_depth(depth_m, camera)
    height, width = depth.shape
    normal = np.empty((height, width, 3), np.float32) if out is None else _checked_out(out, depth)
    flat = normal.reshape(height, 3 * width)
    rows = _rows_per_block(height, width, num_threads)

    def run(block: int) -> None:
        start, stop = block * rows, min((block + 1) * rows, height)
        kernel(
            depth, start, stop, camera.fx, camera.fy, camera.cx, camera.cy, bool(sign_filter), flat
        )

    run_blocks(run, -(-height // rows), num_threads)
    return normal


def _rows_per_block(height: int, width: int, num_threads: int | None) -> int:
    if num_threads == 1:
        return height
    threads = num_threads or available_cores()
    return max(-(-height // (threads * _BLOCKS_PER_THREAD)), _LEAST_BLOCK_PIXELS // width, 1)


def _checked_out(out: Any, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    expected = (*depth.shape, 3)
    if not isinstance(out, np.ndarray) or out.shape != expected or out.dtype != np.float32:
        found = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise ArrayError(f"out: expected a float32 array of shape {expected}, found {found}")
    if not out.flags.c_contiguous or not out.flags.writeable:
        raise ArrayError("out: expected a writable C-contiguous array, found one that is not")
    if np.may_share_memory(out, depth):
        raise ArrayError("out: expected memory of its own, found the depth's; pass another array")
    return out
