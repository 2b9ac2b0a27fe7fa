"""Disparity from depth, and depth from disparity."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.camera import MAX_BASELINE_M, Camera
from nimprep.depth import checked_depth, checked_plane
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.errors import ArrayError
from nimprep.frame import VIRTUAL_BASELINE_M
from nimprep.kernels.planes import reciprocal
from nimprep.parallel import run_rows

_FAINT_REACH = 1e-6
"""Pixels times metres. Divided by the largest float32, this is still one that is not 0."""


def disparity_from_depth(
    depth_m: npt.ArrayLike,
    camera: Camera,
    baseline_m: float = VIRTUAL_BASELINE_M,
    num_threads: int | None = None,
) -> npt.NDArray[np.float32]:
    """Return the disparity d = fx * baseline_m / Z of a rectified stereo pair.

    On a plane it is linear in the pixel coordinates. `depth_from_disparity` undoes it.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        Depth along z; 0, NaN, infinity and what is masked = none, as below 0.1 mm.
    camera : Camera
        The pair's left one, of the image's size.
    baseline_m : float
        Distance between the two cameras, metres, at most 1000; by default a virtual one,
        `VIRTUAL_BASELINE_M`.
    num_threads : int, optional
        None = all cores; 1 = the calling thread alone. The result is the same.

    Returns
    -------
    (H, W) float32, pixels
        By how much farther left the right camera sees the point; 0 = none, exactly where the depth
        is none.

    Raises
    ------
    ArrayError
        The depth is no floating (H, W) array of the camera's size or holds negative values; the
        baseline is not positive, or more than 1000 m.
    """
    depth = checked_depth(depth_m, camera)
    reach = _reach(camera, baseline_m)
    out = _divided(reach, depth, 0.0, num_threads)
    if reach < _FAINT_REACH:
        # None is where there is no depth, nowhere else.
        np.maximum(out, np.finfo(np.float32).tiny, out=out, where=depth > 0)
    return out


def depth_from_disparity(
    disparity: npt.ArrayLike,
    camera: Camera,
    baseline_m: float = VIRTUAL_BASELINE_M,
    num_threads: int | None = None,
) -> npt.NDArray[np.float32]:
    """Return the depth Z = fx * baseline_m / d; the inverse of `disparity_from_depth`.

    Parameters
    ----------
    disparity : (H, W) floating array, pixels
        0, NaN, infinity and what is masked = none.
    camera : Camera
        The pair's left one, of the image's size.
    baseline_m : float
        The same as there.
    num_threads : int, optional
        As there.

    Returns
    -------
    (H, W) float32, metres
        0 = none, also where it would be below 0.1 mm or too far for float32.

    Raises
    ------
    ArrayError
        As there, of the disparity.
    """
    values = checked_plane(disparity, "disparity", "pixels", camera)
    return _divided(_reach(camera, baseline_m), values, LEAST_DEPTH_M, num_threads)


def _reach(camera: Camera, baseline_m: Any) -> float:
    baseline = float(baseline_m)
    if not 0 < baseline <= MAX_BASELINE_M:
        raise ArrayError(
            f"baseline_m: expected a positive number of at most {MAX_BASELINE_M:g} metres, "
            f"found {baseline:g}"
        )
    return camera.fx * baseline


def _divided(
    reach: float, values: npt.NDArray[np.float32], least: float, num_threads: int | None
) -> npt.NDArray[np.float32]:
    """Return reach / value where that is at least so much and finite, elsewhere 0."""
    out = np.empty(values.shape, np.float32)

    def run(first: int, last: int) -> None:
        reciprocal(values, first, last, reach, np.float32(least), out)

    run_rows(run, values.shape, num_threads)
    return out


def disparity_of(given: Given) -> npt.NDArray[np.float32]:
    """Return a frame's disparity by its own baseline, or the recipe's where it has none."""
    own = given.frame.baseline_m
    baseline_m = own if math.isfinite(own) else given.recipe.virtual_baseline_m
    return disparity_from_depth(given.depth_m, given.frame.camera, baseline_m, num_threads=1)


def make_disparity(given: Given) -> Made:
    """Make a frame's disparity."""
    return Made(disparity_of(given))


def baseline_parameters(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of what is made by a baseline."""
    return {
        "fill": recipe.fill,
        "baseline": "the frame's own where it has one, else the virtual one",
        "virtual_baseline_m": recipe.virtual_baseline_m,
    }


def describe_disparity(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its disparity."""
    parameters = {**baseline_parameters(recipe), "disparity": "fx * baseline / depth"}
    return {"method": "disparity", "parameters": parameters}
