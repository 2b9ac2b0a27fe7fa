"""Height over the road's plane."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import floats
from nimprep.camera import Camera, unit_gravity
from nimprep.depth import checked_depth
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.derive.road import find_road, grid_points
from nimprep.errors import ArrayError
from nimprep.kernels.planes import heights
from nimprep.parallel import run_rows

_HIGHEST_M = 1e9
_LEVEL = "; where a frame has gravity given, the level plane that touches it below the camera"
_FITTED = "fitted to the depth" + _LEVEL

_STEEPEST_DEG = 30.0
"""What is steeper, by a gravity that is known, is no road."""

_LEAST_ACROSS = 0.05


def estimate_road_plane(
    depth_m: npt.ArrayLike, camera: Camera, gravity: npt.ArrayLike | None = None
) -> npt.NDArray[np.float64]:
    """Fit the road's plane to a depth image in which up to half of the road may be hidden.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0, NaN, infinity and what is masked = none, as below 0.1 mm.
    camera : Camera
        Of the image's size.
    gravity : (3,) array_like, optional
        Known direction of gravity in the camera frame, pointing down, of any length. The plane is
        then level: it is perpendicular to gravity, and touches the road right below the camera.

    Returns
    -------
    (4,) float64
        n_x, n_y, n_z and h: the unit normal in the camera frame (x right, y down, z forward) that
        points up from the road to the camera, and the camera's height over the road, metres. A
        point P lies n·P + h above the road.

    Raises
    ------
    ArrayError
        The depth is no floating (H, W) array of the camera's size or holds negative values; or
        there is no road in it, as `estimate_road_profile` says.

    Notes
    -----
    A plane's inverse depth is linear in u and v, so that this is the fit of `estimate_road_profile`
    without the curvature. Where gravity is known, a camera may be rolled: the road is looked for
    with the image turned upright, and what is steeper than 30 degrees is none.
    """
    down = None if gravity is None else unit_gravity(gravity)
    plane = find_road_plane(checked_depth(depth_m, camera), camera, down)
    if plane is None:
        raise ArrayError("depth_m: expected a road in it, found none; give its plane")
    return plane


def find_road_plane(
    depth_m: npt.NDArray[np.float32],
    camera: Camera,
    gravity: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.float64] | None:
    """Fit as `estimate_road_plane` does to checked depth; None = no road."""
    points = grid_points(depth_m, inverse=True)
    across, down = (0.0, 1.0) if gravity is None else _downwards(gravity, camera)
    upright = points
    if across:
        turned = down * points.x - across * points.y, across * points.x + down * points.y
        upright = replace(points, x=turned[0], y=turned[1])
    road = find_road(upright, curved=False)
    if road is None:
        return None
    # 1/Z = along · (x/z, y/z, 1), so that along · P = 1 on the road.
    per_u = road.levels[1] * (road.tilt * down + across) / points.unit
    per_v = road.levels[1] * (down - road.tilt * across) / points.unit
    u, v = camera.cx - points.middle[0], camera.cy - points.middle[1]
    along = np.array([per_u * camera.fx, per_v * camera.fy, road.levels[0] + per_u * u + per_v * v])
    length = float(np.linalg.norm(along))
    plane = np.append(-along, 1) / length
    return plane if gravity is None else level_plane(plane, gravity)


def _downwards(gravity: npt.NDArray[np.float64], camera: Camera) -> tuple[float, float]:
    """Return how level planes grow nearer in the image, along u and v; of unit length."""
    across, down = float(gravity[0]) / camera.fx, float(gravity[1]) / camera.fy
    length = math.hypot(across, down)
    # Seen straight from above there is no such direction.
    if math.hypot(float(gravity[0]), float(gravity[1])) < _LEAST_ACROSS:
        return 0.0, 1.0
    return across / length, down / length


def level_plane(
    plane: npt.NDArray[np.float64], gravity: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64] | None:
    """Return the level plane that touches a road right below the camera; None = it is too steep.

    Parameters
    ----------
    plane : (4,) float64
        The road's, as of `estimate_road_plane`.
    gravity : (3,) float64
        Unit vector, pointing down.
    """
    upright = float(-(plane[:3] @ gravity))
    if upright < math.cos(math.radians(_STEEPEST_DEG)):
        return None
    return np.append(-gravity, plane[3] / upright)


def road_plane(cam_to_road: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return the road's plane, (4,) as of `estimate_road_plane`, by calibration.

    Parameters
    ----------
    cam_to_road : (3, 4) array_like
        Transform from the camera frame to the road frame, metres; the road is where the road
        frame's y is 0, and y points down.

    Raises
    ------
    ArrayError
        Another shape, values that are not finite, or no rotation.
    """
    transform = floats(cam_to_road, "cam_to_road")
    if transform.shape != (3, 4) or not np.isfinite(transform).all():
        raise ArrayError(
            f"cam_to_road: expected (3, 4) finite numbers, found shape {transform.shape}"
        )
    return _checked(-transform[1], "cam_to_road")


def estimate_elevation(
    depth_m: npt.ArrayLike,
    camera: Camera,
    plane: npt.ArrayLike | None = None,
    num_threads: int | None = None,
    gravity: npt.ArrayLike | None = None,
) -> npt.NDArray[np.float32]:
    """Return the height over the road's plane at every pixel.

    Parameters
    ----------
    depth_m : (H, W) floating array, metres
        0, NaN, infinity and what is masked = none, as below 0.1 mm.
    camera : Camera
        Of the image's size.
    plane : (4,) array_like, optional
        The road's, as `estimate_road_plane` returns it, which is called where none is given, or
        `road_plane` of a calibration.
    num_threads : int, optional
        None = all cores; 1 = the calling thread alone. The result is the same.
    gravity : (3,) array_like, optional
        Known direction of gravity, with which `estimate_road_plane` is called: heights are then
        along it. It is not looked at where `plane` is given.

    Returns
    -------
    (H, W) float32, metres
        n·P + h: positive above the road, negative in potholes; NaN = none, exactly where the depth
        is none. With plane and camera it gives the depth back where a ray is not level:
        Z = (e - h) / (n · (x/z, y/z, 1)).

    Raises
    ------
    ArrayError
        As `estimate_road_plane`; or `plane` is no unit normal and height of at most 1e9 m.

    References
    ----------
    As an input of networks: Wang, Fan, Sun and Liu, "Dynamic fusion module evolves drivable area
    and road anomaly detection: a benchmark and algorithms", IEEE Transactions on Cybernetics 52,
    2022.
    """
    depth = checked_depth(depth_m, camera)
    if plane is None:
        found = estimate_road_plane(depth, camera, gravity)
    else:
        found = _checked(plane, "plane")
    numbers, plane_numbers = (camera.fx, camera.fy, camera.cx, camera.cy), tuple(found.tolist())
    out = np.empty(depth.shape, np.float32)

    def run(first: int, last: int) -> None:
        heights(depth, first, last, numbers, plane_numbers, out)

    run_rows(run, depth.shape, num_threads)
    return out


def _checked(plane: Any, name: str) -> npt.NDArray[np.float64]:
    values = floats(plane, name)
    if values.shape != (4,) or not np.isfinite(values).all():
        raise ArrayError(f"{name}: expected 4 finite numbers, found shape {values.shape}")
    length = math.sqrt(float(values[:3] @ values[:3]))
    if abs(values[3]) > _HIGHEST_M:
        raise ArrayError(
            f"{name}: expected a height within {_HIGHEST_M:g} m, found {values[3]:g} m"
        )
    if abs(length - 1) > 1e-3:
        raise ArrayError(f"{name}: expected a unit normal, found one of length {length:g}")
    return values


def make_elevation(given: Given) -> Made:
    """Make a frame's elevation, over the road of its calibration or of its depth; or none."""
    depth, frame = checked_depth(given.depth_m, given.frame.camera), given.frame
    plane: npt.NDArray[np.float64] | None
    if frame.cam_to_road is None or given.recipe.elevation_road == "fitted":
        plane = find_road_plane(depth, frame.camera, frame.gravity)
    else:
        plane = road_plane(frame.cam_to_road)
        plane = plane if frame.gravity is None else level_plane(plane, frame.gravity)
    if plane is None:
        return Made(None)
    return Made(estimate_elevation(depth, frame.camera, plane, num_threads=1))


def describe_elevation(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its elevation."""
    plane = (
        "the road frame's y = 0 where a frame has cam_to_road, else fitted to the depth" + _LEVEL
    )
    chosen = {"road": "fitted"} if recipe.elevation_road == "fitted" else {}
    parameters = {"fill": recipe.fill, **chosen, "plane": _FITTED if chosen else plane}
    return {"method": "road-plane", "parameters": parameters}
