"""Surface normals from depth and a pinhole camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.depth import checked_depth
from nimprep.derive.methods import METHODS as METHODS
from nimprep.derive.methods import Method
from nimprep.derive.methods import check_method as check_method
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.errors import ArrayError
from nimprep.kernels.normals import nim_rows
from nimprep.parallel import run_rows


def estimate_normals(
    depth_m: npt.ArrayLike,
    camera: Camera,
    method: Method = "nim",
    sign_filter: bool = False,
    out: npt.NDArray[np.float32] | None = None,
    num_threads: int | None = None,
    noise: float | None = None,
) -> npt.NDArray[np.float32]:
    """Estimate surface normals from a depth image.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        Depth along z; 0, NaN, infinity and what is masked = none, as below 0.1 mm. Computed in
        float32.
    camera : Camera
        Of the image's size.
    method : {"nim", "nim-edge", "auto"}
        "nim", the paper's: the gradient of inverse depth gives n_x and n_y; each of the four
        neighbours whose depth differs gives an n_z, and the unit vectors are summed. "nim-edge":
        the same n_x and n_y from differences that cross no depth edge, n_z from the plane that
        they and the pixel lie in, smoothed as far as the image is noisy. "auto": nim-edge where
        the image has noise that turns normals by half a degree or more, else nim.
    sign_filter : bool
        Of "nim" alone; "nim-edge" refuses it as it has no n_z to choose among, and so does "auto".
        Sum only the neighbours whose n_z has the majority's sign, before orientation. A tie
        counts as positive. An n_z of exactly 0 has no sign: it is left out unless all are 0.
    out : (H, W, 3) float32, C-contiguous, optional
        Where to write the result; must not overlap the depth.
    num_threads : int, optional
        None = all cores; 1 = the calling thread alone. Safe to call from many threads at once,
        which beats threads within a frame where there are many frames. The result is the same
        to the bit.
    noise : float, optional
        Of "nim-edge" alone: the standard deviation of inverse depth, 1/m, at every distance alike,
        as a stereo camera's is: that of its disparity by focal length (both in pixels) times
        baseline (m). 0 = none: edges are kept and nothing is smoothed. None = estimated from the
        image, as one standard deviation either of inverse depth or of depth.

    Returns
    -------
    (H, W, 3) float32
        Unit vectors (n_x, n_y, n_z) in the camera frame (x right, y down, z forward), pointing at
        the camera: n·P <= 0. (0, 0, 0) exactly where there is no depth, or none at any of the four
        neighbours, so that no difference was measured. At the border and beside holes from the
        neighbours there are: a difference with one of its two sides missing is one-sided and
        doubled (by "nim"), with both missing 0. Where there are neighbours but none's depth
        differs, or the gradient is exactly 0, (0, 0, -1).

    Raises
    ------
    ArrayError
        The depth is no floating (H, W) array of the camera's size or holds negative values;
        `out` does not fit; `method` is unknown, or has no such option; `noise` is negative or not
        finite; `num_threads` is not positive.

    References
    ----------
    Wang et al., "Applying surface normal information in drivable area and road anomaly detection
    for ground mobile robots", IROS 2020. For the differences of "nim-edge": Liu, Osher & Chan,
    "Weighted essentially non-oscillatory schemes", J. Comput. Phys. 115, 1994.
    """
    check_method(method, sign_filter, noise)
    depth = checked_depth(depth_m, camera)
    if method == "auto":
        from nimprep.derive.method_choice import measure_noise, method_for

        method = method_for([measure_noise(depth, camera)])
    height, width = depth.shape
    normal = np.empty((height, width, 3), np.float32) if out is None else _checked_out(out, depth)
    flat = normal.reshape(height, 3 * width)
    if method == "nim-edge":
        from nimprep.derive.normals_edge import edge_normals

        edge_normals(depth, camera, noise, num_threads, flat)
        return normal

    def rows(start: int, stop: int) -> None:
        nim_rows(
            depth, start, stop, camera.fx, camera.fy, camera.cx, camera.cy, bool(sign_filter), flat
        )

    run_rows(rows, depth.shape, num_threads)
    return normal


def _checked_out(out: Any, depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    expected = (*depth.shape, 3)
    if not isinstance(out, np.ndarray) or out.shape != expected or out.dtype != np.float32:
        found = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise ArrayError(f"out: expected a float32 array of shape {expected}, found {found}")
    if isinstance(out, np.ma.MaskedArray):
        raise ArrayError("out: expected an array without a mask, found a masked one; pass out.data")
    if not out.flags.c_contiguous or not out.flags.writeable:
        raise ArrayError("out: expected a writable C-contiguous array, found one that is not")
    if np.may_share_memory(out, depth):
        raise ArrayError("out: expected memory of its own, found the depth's; pass another array")
    return out


def make_normals(given: Given) -> Made:
    """Estimate a frame's normals by the recipe's method."""
    recipe = given.recipe
    if recipe.whole_cells:
        normals = _normals_of_whole_cells(given)
    else:
        normals = estimate_normals(
            given.depth_m,
            given.frame.camera,
            method=recipe.normals,
            sign_filter=recipe.sign_filter,
            num_threads=1,
            noise=recipe.noise,
        )
    if recipe.lone_normals:
        alone = (given.depth_m > 0) & ~normals.any(axis=-1)
        normals[alone] = (0, 0, -1)
    return Made(normals)


def _normals_of_whole_cells(given: Given) -> npt.NDArray[np.float32]:
    """Estimate nim-edge's normals as versions did that knew no quarters of cells."""
    from nimprep.derive.normals_edge import edge_normals

    camera = given.frame.camera
    depth = checked_depth(given.depth_m, camera)
    normals = np.empty((*depth.shape, 3), np.float32)
    flat = normals.reshape(len(depth), -1)
    edge_normals(depth, camera, given.recipe.noise, 1, flat, quartered=False)
    return normals


def describe_normals(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its normals."""
    options: dict[str, Any] = {"sign_filter": recipe.sign_filter}
    if recipe.normals == "nim-edge":
        options = {"noise": "estimated" if recipe.noise is None else recipe.noise}
        if not recipe.whole_cells:
            options["cells"] = "quartered"
    if not recipe.lone_normals:
        options["lone"] = "none"
    return {"method": recipe.normals, "parameters": {**options, "fill": recipe.fill}}
