"""Depth from a Velodyne scan: each return seen by the image_2 camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.arrays import LEAST_DEPTH_M, floats
from nimprep.errors import ArrayError, DecodeError
from nimprep.files import read_file
from nimprep.kitti.calibration import Calibration

_MAX_BYTES = 1 << 28
"""A scan holds about 120,000 points, 2 MB; a file of more than 256 MB is no scan."""


def read_velodyne(path: Path | str) -> npt.NDArray[np.float32]:
    """Read a scan: float32 x, y, z, reflectance, little-endian, nothing else.

    Returns
    -------
    (N, 4) float32, metres and [0, 1]
        Scanner frame: x forward, y left, z up. Points with NaN or infinity among their coordinates
        are no returns and left out.

    Raises
    ------
    DecodeError
        It cannot be read, is empty, holds a part of a point, or none with finite coordinates.
    """
    return read_points(Path(path), 4, "a Velodyne scan")


def read_points(path: Path, columns: int, what: str) -> npt.NDArray[np.float32]:
    """Read a scan of any scanner: float32 in rows of so many numbers, x, y, z first.

    Parameters
    ----------
    columns : int
        Numbers of a point.
    what : str
        What the file should be, for messages.

    Returns
    -------
    (N, columns) float32, metres
        Without points that have NaN or infinity among their coordinates.

    Raises
    ------
    DecodeError
        It cannot be read, is empty, holds a part of a point, or none with finite coordinates.
    """
    data = read_file(path, _MAX_BYTES, what)
    if not data or len(data) % (4 * columns):
        raise DecodeError(
            f"{path}: expected whole points of {4 * columns} bytes, found {len(data)} bytes; "
            "the file is truncated"
        )
    points = np.frombuffer(data, dtype="<f4").reshape(-1, columns).astype(np.float32, copy=False)
    returns = np.isfinite(points[:, :3]).all(axis=1)
    if not returns.any():
        raise DecodeError(f"{path}: expected finite coordinates, found NaN or infinity in all")
    return points if returns.all() else points[returns]


def project_lidar(
    points: npt.NDArray[np.floating], calibration: Calibration, height: int, width: int
) -> npt.NDArray[np.float32]:
    """Return the sparse depth image of a scan; the nearest return of a pixel wins.

    A point falls on the pixel whose centre is nearest; points behind the camera, nearer than 0.1 mm
    and outside the image are left out.

    Parameters
    ----------
    points : (N, 3) or (N, 4) floating, metres
        Scanner frame; a fourth column is ignored. Where a coordinate is NaN, infinite or masked
        there is no return.
    calibration : Calibration
        With P2, R0_rect and Tr_velo_to_cam.
    height, width : int
        Size of the image.

    Returns
    -------
    (height, width) float32, metres
        Along the image_2 camera's z; 0 = no return.

    Raises
    ------
    ArrayError
        The points have another shape.
    DecodeError
        The calibration lacks a matrix.
    """
    if np.ndim(points) != 2 or np.shape(points)[1] not in (3, 4):
        raise ArrayError(f"points: expected (N, 3) or (N, 4), found shape {np.shape(points)}")
    return project_points(points, calibration.velo_to_cam, calibration.intrinsics, height, width)


def project_points(
    points: npt.NDArray[np.floating],
    to_camera: npt.NDArray[np.float64],
    intrinsics: npt.NDArray[np.float64],
    height: int,
    width: int,
) -> npt.NDArray[np.float32]:
    """Return the sparse depth image of points of any frame, as `project_lidar` does.

    Parameters
    ----------
    points : (N, 3) or (N, 4) floating, metres
    to_camera : (3, 4) float64, metres
        From the points' frame to the camera's.
    intrinsics : (3, 3) float64, pixels
    height, width : int
        Size of the image.

    Returns
    -------
    (height, width) float32, metres
        Along the camera's z; 0 = no point.
    """
    coordinates = floats(points, "points")[:, :3]
    coordinates = coordinates[np.isfinite(coordinates).all(axis=1)]
    depth_m = np.full(height * width, np.inf, dtype=np.float32)
    # What is too far for floating point comes out as NaN or infinity, and so nowhere.
    with np.errstate(over="ignore", invalid="ignore"):
        seen = coordinates @ to_camera[:, :3].T + to_camera[:, 3]
        seen = seen[seen[:, 2] >= LEAST_DEPTH_M]
        image_points = seen @ intrinsics.T
        u = np.rint(image_points[:, 0] / image_points[:, 2])
        v = np.rint(image_points[:, 1] / image_points[:, 2])
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        pixel = v[inside].astype(np.int64) * width + u[inside].astype(np.int64)
        np.minimum.at(depth_m, pixel, seen[inside, 2].astype(np.float32))
    depth_m[np.isinf(depth_m)] = 0
    return depth_m.reshape(height, width)
