"""Depth of a camera of its own, as the colour camera sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import ArrayError, LayoutError
from nimprep.readers.description import DepthSource

FARTHEST_M = 10.0
"""Cameras further apart are refused: the shift is in millimetres, or of a pose in the world."""

_ROTATION_TOLERANCE = 1e-2


def check_depth_camera(depth: DepthSource | None, root: Path) -> None:
    """Refuse a depth camera without its place, a place without its camera, and one that cannot be.

    Raises
    ------
    LayoutError
        One is without the other, the transform is no rotation and shift, or not in metres.
    """
    if depth is None or (depth.camera is None and depth.depth_to_rgb is None):
        return
    if depth.camera is None or depth.depth_to_rgb is None:
        there, lacking = "camera", "depth_to_rgb"
        if depth.camera is None:
            there, lacking = lacking, there
        raise LayoutError(
            f"{root}: expected depth's {lacking} beside its {there}, found none; give both, or "
            "neither where depth is registered"
        )
    transform = np.array(depth.depth_to_rgb)
    r, shift = transform[:3, :3], transform[:3, 3]
    if not np.abs(r @ r.T - np.eye(3)).max() <= _ROTATION_TOLERANCE or np.linalg.det(r) < 0:
        raise LayoutError(
            f"{root}: expected a rotation in depth_to_rgb, found {r.tolist()}; "
            "give its rows, as a point's transform R p + t has them"
        )
    if not np.linalg.norm(shift) <= FARTHEST_M:
        raise LayoutError(
            f"{root}: expected a shift of at most {FARTHEST_M:g} m in depth_to_rgb, found "
            f"{np.linalg.norm(shift):g} m; give it in metres, from depth's camera to colour's"
        )


def warped_depth(
    depth_m: npt.NDArray[np.float32],
    camera: Camera,
    depth_to_rgb: npt.ArrayLike,
    rgb_camera: Camera,
) -> npt.NDArray[np.float32]:
    """Return depth as another camera sees it: the nearest surface of each pixel.

    Parameters
    ----------
    depth_m : (h, w) float32, metres
        0 = none; without distortion.
    camera : Camera
        Of it.
    depth_to_rgb : (4, 4) or (3, 4), metres
        From its frame to the other camera's.
    rgb_camera : Camera
        The other.

    Returns
    -------
    (H, W) float32, metres
        Along the other camera's axis; 0 = none: nothing there was seen.

    Raises
    ------
    ArrayError
        Depth is not of its camera's size.
    """
    from nimprep.kernels.depth_warp import draw_inverse_depth

    if depth_m.shape != camera.shape:
        raise ArrayError(
            f"depth_m: expected shape {camera.shape} like its camera, found {depth_m.shape}"
        )
    inverse = np.empty(rgb_camera.shape, np.float32)
    draw_inverse_depth(
        np.ascontiguousarray(depth_m, np.float32),
        _numbers(camera),
        np.ascontiguousarray(np.array(depth_to_rgb, np.float64)[:3]),
        _numbers(rgb_camera),
        inverse,
    )
    return np.divide(1, inverse, out=np.zeros_like(inverse), where=inverse > 0)


def _numbers(camera: Camera) -> npt.NDArray[np.float64]:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
