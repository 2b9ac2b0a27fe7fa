"""Encode depth as HHA: horizontal disparity, height above ground, angle with gravity."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera, unit_gravity
from nimprep.derive.gravity import (
    Scene,
    gravity_of_scene,
    normals_of_scene,
    scene_from_depth,
)
from nimprep.derive.methods import GROUNDS, Ground
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.errors import ArrayError
from nimprep.kernels.hha_channels import encode_block, floor_depths_block, lowest_block
from nimprep.kernels.hha_lines import reference_normals
from nimprep.kernels.hha_planes import plane_block
from nimprep.parallel import run_blocks

_RADIUS = 3
_NO_ROTATION_BELOW_DEG = 0.1
_LOWEST_GROUND_CM = -90.0
_ASSUMED_GROUND_CM = -130.0

# Of the floor: how its normals may lean, the least share of the pixels, which of its heights counts
# for the ground, how deep below that is 0, and how deep it can lie.
_FLOOR_DEG = 15.0
_LEAST_FLOOR = 0.02
_LOW_SHARE = 0.1
_SUNK_CM = 20.0
_DEEPEST_CM = 4096

Vector = tuple[float, float, float]


def _angle_levels(
    bins_per_unit: int = 4096,
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64]]:
    """Tabulate whole degrees over cosines, for `encode_block`.

    The level rises at the cosines of 0.5, 1.5 ... 179.5 degrees. They lie at least 3.0e-4 apart, so
    that a bin of 1/4096 holds one at most.
    """
    thresholds = np.append(np.cos(np.radians(np.arange(180) + 0.5)), -2.0)
    upper = np.arange(1, 2 * bins_per_unit + 2) / bins_per_unit - 1
    return np.searchsorted(-thresholds, -upper).astype(np.uint8), thresholds


_ANGLE_LEVELS = _angle_levels()


def encode_hha(
    depth_m: Any,
    camera: Camera,
    missing: Any = None,
    gravity: Any = None,
    num_threads: int | None = None,
    ground: Ground = "lowest",
) -> npt.NDArray[np.uint8]:
    """Encode a depth image as HHA.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0, NaN, infinity and what is masked = none, as below 0.1 mm.
    camera : Camera
        Its size must be the image's. Pixels count from 0: a principal point counted from 1, as
        MATLAB calibrations have it, is one too large.
    missing : (H, W) bool, optional
        True, or masked, where the depth was filled in rather than measured. These pixels take part
        in the points but not in the planes.
    gravity : (3,) array_like, optional
        Known direction of gravity in the camera frame (x right, y down, z forward), pointing down,
        of any length. Estimated where not given.
    num_threads : int, optional
        None = one thread per core, 1 = the calling thread alone. The result is the same.
    ground : {"lowest", "floor"}
        Where heights are counted from: the reference's lowest point, or the floor, of which 20 cm
        are taken off so that holes in a road stay visible.

    Returns
    -------
    (H, W, 3) uint8
        Horizontal disparity, 31000 / max(Z, 100) with Z in cm; height above the ground, cm;
        angle between normal and gravity, degrees, plus 38 (floor 38, wall 128, ceiling 218). Each
        rounded to nearest even and cut to 255. (0, 0, 0) where there is no depth, and nowhere else.

    Raises
    ------
    ArrayError
        An array of the wrong shape, type or values, or depth that is not in metres: its median
        lies outside 0.05 to 100; or `ground` is neither.

    Notes
    -----
    Normals are fitted to the window of radius 3. A window without three points off a line has no
    normal, which counts as 180 degrees. The reference does not see that its points lie on a line
    and gives them a normal made of rounding errors; where `missing` marks any pixel that normal is
    reproduced, so that the pixels are the reference's.

    Where the lowest point is less than 90 cm below the camera, no ground is taken to be in view and
    the ground to be 130 cm below the camera. One outlier is enough for a lowest point far below the
    road, above which all else is 255.

    The floor is the pixels below the camera whose plane, fitted to the window of radius 10 as for
    gravity, has a normal within 15 degrees of it; its height is the one that a tenth of them do not
    exceed. Where fewer than 2 % of the pixels with depth are floor, the lowest point is taken.

    References
    ----------
    Gupta et al., Learning rich features from RGB-D images for object detection and segmentation,
    ECCV 2014.
    """
    known = None if gravity is None else unit_gravity(gravity)
    return _encoded(scene_from_depth(depth_m, camera, missing, num_threads), known, ground).hha


def encode_hha_and_gravity(
    depth_m: Any,
    camera: Camera,
    missing: Any = None,
    num_threads: int | None = None,
    ground: Ground = "lowest",
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float64]]:
    """Return what `encode_hha` and `estimate_gravity` do, in less time than one after the other."""
    made = _encoded(scene_from_depth(depth_m, camera, missing, num_threads), None, ground)
    return made.hha, made.gravity


class _Encoded(NamedTuple):
    """HHA, the direction of gravity it is made with, and whether heights count from a floor."""

    hha: npt.NDArray[np.uint8]
    gravity: npt.NDArray[np.float64]
    from_floor: bool


def _encoded(scene: Scene, known: npt.NDArray[np.float64] | None, ground: Ground) -> _Encoded:
    if ground not in GROUNDS:
        raise ArrayError(f"ground: expected one of {', '.join(GROUNDS)}, found {ground!r}")
    normals = normals_of_scene(scene) if known is None or ground == "floor" else None
    gravity = gravity_of_scene(scene, normals) if known is None else known
    toward = unit_gravity(gravity)
    down = _down(toward)
    zero = None
    if normals is not None and ground == "floor":
        zero = _floor_cm(scene, normals, toward, down)
    height = _lowest_cm(scene, down) if zero is None else zero
    return _Encoded(_encode_scene(scene, toward, down, height), gravity, zero is not None)


def _down(gravity: npt.NDArray[np.float64]) -> Vector:
    """Return the direction that heights are counted against."""
    tilt = np.degrees(np.arccos(np.clip(gravity[1], -1, 1)))
    x, y, z = gravity.tolist()
    return (x, y, z) if tilt > _NO_ROTATION_BELOW_DEG else (0.0, 1.0, 0.0)


def _lowest_cm(scene: Scene, down: Vector) -> float:
    """Return the height of the lowest point, cm above the camera, or of an assumed ground."""
    blocks = scene.blocks
    lowest = np.empty(len(blocks))

    def find_lowest(block: int) -> None:
        lowest[block] = lowest_block(scene.depth_m, *blocks[block], scene.camera, down)

    run_blocks(find_lowest, len(blocks), scene.num_threads)
    ground = float(lowest.min())
    return _ASSUMED_GROUND_CM if ground > _LOWEST_GROUND_CM else ground


def _floor_cm(
    scene: Scene, normals: npt.NDArray[np.float64], gravity: npt.NDArray[np.float64], down: Vector
) -> float | None:
    """Return the height that becomes 0, 20 cm below the floor's; None = no floor in view."""
    blocks = scene.blocks
    counts = np.zeros((len(blocks), _DEEPEST_CM + 1), np.int64)
    cosine = float(np.cos(np.radians(_FLOOR_DEG)))
    toward = tuple(gravity.tolist())

    def count(block: int) -> None:
        frame = scene.depth_m, normals, *blocks[block], scene.camera
        floor_depths_block(*frame, toward, down, cosine, counts[block])

    run_blocks(count, len(blocks), scene.num_threads)
    *below, known = counts.sum(axis=0).tolist()
    floor = sum(below)
    if floor < max(_LEAST_FLOOR * known, 1):
        return None
    # From the deepest up: a tenth of the floor lies as deep or deeper.
    deepest = np.cumsum(below[::-1])
    depth = len(below) - 1 - int(np.searchsorted(deepest, _LOW_SHARE * floor))
    return -float(depth) - 1 - _SUNK_CM


def _encode_scene(
    scene: Scene, gravity: npt.NDArray[np.float64], down: Vector, ground: float
) -> npt.NDArray[np.uint8]:
    out = np.empty((*scene.depth_m.shape, 3), np.uint8)
    blocks = scene.blocks
    toward = tuple(gravity.tolist())

    def encode(block: int) -> None:
        rows = blocks[block]
        normals = np.empty((3, rows[1] - rows[0], out.shape[1]))
        plane_block(scene.inverse, *rows, _RADIUS, scene.camera, normals, rows[0])
        if scene.filled:
            reference_normals(scene.depth_m, scene.inverse, *rows, scene.camera, normals)
        frame = scene.depth_m, normals, *rows, scene.camera
        encode_block(*frame, toward, down, ground, _ANGLE_LEVELS, out)

    run_blocks(encode, len(blocks), scene.num_threads)
    return out


def make_hha(given: Given) -> Made:
    """Encode a frame's HHA, with the gravity it is given, its calibration says, or depth shows."""
    frame, ground = given.frame, given.recipe.ground
    known = frame.gravity
    if known is None and frame.cam_to_road is not None:
        # The road frame's y axis points down, as the camera's does.
        known = frame.cam_to_road[:, :3].T @ (0.0, 1.0, 0.0)
    made = _encoded(scene_from_depth(given.depth_m, frame.camera, given.missing, 1), known, ground)
    signs = {} if ground == "lowest" else {"no_floor": float(not made.from_floor)}
    return Made(made.hha, made.gravity, signs)


_HEIGHTS: dict[Ground, str] = {
    "lowest": "cm above the frame's lowest point, or above a ground 130 cm below the camera where "
    "no point lies 90 cm below it",
    "floor": "cm above 20 cm below the floor, which a tenth of the pixels with level planes below "
    "the camera do not exceed; in frames without such pixels as with lowest",
}


def describe_hha(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its HHA."""
    return {
        "method": "hha",
        "parameters": {
            "fill": recipe.fill,
            "gravity": "as given where a frame has it, else from cam_to_road, else estimated",
            "horizontal_disparity": "31000 / max(depth, 100), depth in cm",
            # Stores made before there was a choice do not say it.
            **({} if recipe.ground == "lowest" else {"ground": recipe.ground}),
            "height": _HEIGHTS[recipe.ground],
            "angle": "degrees between normal and gravity, plus 38: floor 38, wall 128",
        },
    }
