"""Estimate the direction of gravity from the planes in a depth image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import unmasked
from nimprep.camera import Camera
from nimprep.depth import checked_depth
from nimprep.errors import ArrayError
from nimprep.kernels.hha_gravity import wall_minus_floor
from nimprep.kernels.hha_planes import inverse_depth, plane_block
from nimprep.parallel import run_blocks

BLOCK_ROWS = 32
"""Rows per unit of work. Fixed, so that sums do not depend on the number of threads."""

_RADIUS = 10
_ROUNDS_DEG = (45.0,) * 5 + (15.0,) * 5


@dataclass(frozen=True)
class Scene:
    """Hold one checked depth image as the plane fits read it.

    Attributes
    ----------
    depth_m : (H, W) float32, metres
        0 = no depth.
    inverse : (H, W) float64, 1/metres
        0 where the pixel takes no part in a plane.
    camera : tuple of float
        fx, fy, cx, cy in pixels.
    num_threads : int or None
        As `run_blocks` takes it.
    filled : bool
        Whether some of the depth is said to be filled in.
    """

    depth_m: npt.NDArray[np.float32]
    inverse: npt.NDArray[np.float64]
    camera: tuple[float, float, float, float]
    num_threads: int | None
    filled: bool

    @property
    def blocks(self) -> list[tuple[int, int]]:
        """First and last row (exclusive) of each unit of work."""
        height = self.depth_m.shape[0]
        return [(v, min(v + BLOCK_ROWS, height)) for v in range(0, height, BLOCK_ROWS)]


def scene_from_depth(
    depth_m: Any, camera: Camera, missing: Any = None, num_threads: int | None = None
) -> Scene:
    """Check depth, units and mask, and take the inverse depth of the pixels that count.

    Raises
    ------
    ArrayError
        As `estimate_gravity`.
    """
    depth = checked_depth(depth_m, camera)
    mask = _checked_missing(missing, depth.shape)
    filled = missing is not None and bool(mask.any())
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy)
    scene = Scene(depth, np.empty(depth.shape, np.float64), numbers, num_threads, filled)
    counts = np.zeros((len(scene.blocks), 3), np.int64)

    def invert(block: int) -> None:
        inverse_depth(depth, mask, *scene.blocks[block], scene.inverse, counts[block])

    run_blocks(invert, len(counts), num_threads)
    known, near, far = counts.sum(axis=0).tolist()
    if 2 * near > known or 2 * far > known:
        raise ArrayError(_unit_message(float(np.median(depth[depth > 0].astype(np.float64)))))
    return scene


def estimate_gravity(
    depth_m: Any, camera: Camera, missing: Any = None, num_threads: int | None = None
) -> npt.NDArray[np.float64]:
    """Estimate the direction of gravity in the camera frame.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0, NaN, infinity and what is masked = none, as below 0.1 mm.
    camera : Camera
        Its size must be the image's.
    missing : (H, W) bool, optional
        True, or masked, where the depth was filled in rather than measured; these pixels take no
        part in the planes, as pixels without depth do not.
    num_threads : int, optional
        None = one thread per core, 1 = the calling thread alone. The result is the same.

    Returns
    -------
    (3,) float64
        Unit vector, x right, y down, z forward, pointing down. (0, 1, 0) where no window
        determines a plane.

    Raises
    ------
    ArrayError
        An array of the wrong shape, type or values, or depth that is not in metres: its median
        lies outside 0.05 to 100.

    Notes
    -----
    Planes are fitted at every pixel to the window of radius 10. From (0, 1, 0), five rounds at 45
    degrees and five at 15: normals within that angle of the current direction or its opposite are
    floor, those within it of the perpendicular are wall, and the new direction is the eigenvector
    of the smallest eigenvalue of Σ n nᵀ over walls less Σ n nᵀ over floors. Where several
    eigenvalues share the smallest value (a lone wall) it is the direction among their eigenvectors
    nearest to the current one.

    Windows whose points lie on one line determine no plane and are left out. The reference counts
    the rounding errors that it gets there as normals; on its frame with missing values that turns
    its gravity by 0.008 degrees.

    References
    ----------
    Gupta et al., Learning rich features from RGB-D images for object detection and segmentation,
    ECCV 2014.
    """
    return gravity_of_scene(scene_from_depth(depth_m, camera, missing, num_threads))


def normals_of_scene(scene: Scene) -> npt.NDArray[np.float64]:
    """Return the planes' normals that gravity is estimated from, (3, H, W); 0 = none."""
    blocks = scene.blocks
    normals = np.empty((3, *scene.depth_m.shape))

    def fit(block: int) -> None:
        plane_block(scene.inverse, *blocks[block], _RADIUS, scene.camera, normals, 0)

    run_blocks(fit, len(blocks), scene.num_threads)
    return normals


def gravity_of_scene(
    scene: Scene, normals: npt.NDArray[np.float64] | None = None
) -> npt.NDArray[np.float64]:
    """Estimate gravity, (3,) float64, as `estimate_gravity` does.

    Parameters
    ----------
    normals : (3, H, W) float64, optional
        The scene's, where they are known already.
    """
    normals = normals_of_scene(scene) if normals is None else normals
    blocks = scene.blocks
    sums = np.empty((len(blocks), 6))
    gravity = np.array([0.0, 1.0, 0.0])
    for degrees in _ROUNDS_DEG:
        direction = tuple(gravity.tolist())
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))

        def reduce(block: int, at: Any = direction, above: Any = cosine, below: Any = sine) -> None:
            wall_minus_floor(normals, *blocks[block], at, above, below, sums[block])

        run_blocks(reduce, len(blocks), scene.num_threads)
        gravity = _next_direction(sums.sum(axis=0), gravity)
    return gravity


def _next_direction(
    sums: npt.NDArray[np.float64], current: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Project the current direction onto the eigenvectors of the smallest eigenvalue."""
    values, vectors = np.linalg.eigh(sums[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]])
    # Relative to the largest, 1e-9 is far above the rounding of the sums and far below the gap
    # that any real scene leaves.
    smallest = vectors[:, values - values[0] <= 1e-9 * np.abs(values).max()]
    direction = smallest @ (smallest.T @ current)
    length = np.linalg.norm(direction)
    return direction / length if length > 1e-9 else current


def _checked_missing(missing: Any, shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    if missing is None:
        return np.zeros(shape, np.bool_)
    mask = unmasked(missing, True)
    if mask.dtype != np.bool_:
        raise ArrayError(
            f"missing: expected a bool mask, True where depth was filled in, found {mask.dtype}; "
            "from raw depth, pass raw == 0"
        )
    if mask.shape != shape:
        raise ArrayError(f"missing: expected the depth's shape {shape}, found {mask.shape}")
    return np.ascontiguousarray(mask)


def _unit_message(median: float) -> str:
    if median < 0.05:
        return f"depth_m: expected metres, found a median of {median:g}; check the depth's unit"
    for factor, unit in ((1000, "millimetres"), (10000, "tenths of a millimetre")):
        if 0.05 <= median / factor <= 30:
            return (
                f"depth_m: expected metres, found a median of {median:g}, which looks like {unit}; "
                f"divide by {factor}"
            )
    return f"depth_m: expected metres, found a median of {median:g}; check the depth's unit"
