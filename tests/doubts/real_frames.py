"""Real frames of the reference data, as far as signs are measured on them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.completion import fill_depth
from nimprep.images import read_depth
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.layout import list_road_files
from nimprep.kitti.lidar import project_lidar, read_velodyne


@dataclass(frozen=True)
class RealFrame:
    """A frame read rightly; `raw` where it is a file of integers."""

    name: str
    depth_m: npt.NDArray[np.float32]
    camera: Camera
    raw: npt.NDArray[Any] | None = None


def dense_frames(data: Path) -> Iterator[RealFrame]:
    """Yield the frames whose depth is dense: GMRP, KITTI road, KITTI filled, ORFD, NYUv2."""
    raw = read_depth(data / "gmrp/depth_u16/000001.png")
    yield _from_raw("gmrp", raw, 1000, Camera.from_fov(69.4, 1280, 720))
    for files in list_road_files(data / "kitti_road"):
        calibration = read_calibration(files.calibration)
        if files.depth.is_file():
            raw = read_depth(files.depth)
            yield _from_raw(files.id, raw, 1000, calibration.camera(*raw.shape))
        if files.right_image.is_file():
            for sparse in (False, True):
                depth = frame_depth(files, "stereo", sparse)
                yield RealFrame(f"stereo {files.id}", depth, calibration.camera(*depth.shape))
    sparse = kitti_scan(data)
    filled, _ = fill_depth(sparse.depth_m, "linear")
    yield RealFrame("filled scan", filled, sparse.camera)
    folder = data / "orfd/testing/y0613_1242"
    k = (folder / "calib/1623721491895.txt").read_text().split("\n")[0].split()[1:]
    camera = Camera.from_matrix(np.array(k, float).reshape(3, 3), 1280, 720)
    yield _from_raw("orfd", read_depth(folder / "dense_depth/1623721491895.png"), 256, camera)
    numbers = json.loads((data / "nyu_hha/camera.json").read_text())
    for name in ("depth_raw", "depth_filled"):
        raw = read_depth(data / f"nyu_hha/{name}.png")
        fx, fy, cx, cy = (numbers[key] for key in ("fx", "fy", "cx", "cy"))
        camera = Camera(fx, fy, cx - 1, cy - 1, raw.shape[1], raw.shape[0])
        yield _from_raw(name, raw, 10_000, camera)


def kitti_scan(data: Path) -> RealFrame:
    """Return a LiDAR scan as it falls on the image."""
    folder = data / "kitti_lidar"
    calibration = read_calibration(folder / "calib/000000.txt")
    points = read_velodyne(folder / "velodyne/000000.bin")
    depth = project_lidar(points, calibration, 370, 1224)
    return RealFrame("scan", depth, calibration.camera(370, 1224))


def rendered_depth(data: Path) -> Iterator[RealFrame]:
    """Yield scenes of objects, rendered; their unit is nobody's metre."""
    for name in ("android", "demo"):
        depth = np.fromfile(data / f"normals_3f2n/{name}/depth.bin", np.float32).reshape(480, 640)
        yield RealFrame(
            name, np.where(depth == 1, 0, depth), Camera(1400, 1380, 319, 259, 640, 480)
        )


def _from_raw(name: str, raw: npt.NDArray[Any], per_metre: int, camera: Camera) -> RealFrame:
    depth = raw / np.float32(per_metre)
    depth[raw == 65535] = 0
    return RealFrame(name, depth, camera, raw)
