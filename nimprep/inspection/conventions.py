"""What datasets' names usually go with: hints on depth's numbers, which values may contradict."""

from __future__ import annotations

import re
from dataclasses import dataclass

MILLIMETRE = 0.001


@dataclass(frozen=True)
class Convention:
    """Say what a name goes with.

    Attributes
    ----------
    pattern : str
        Looked for in all patterns and the folder's name, case does not count.
    scale : float
        Metres (or pixels of disparity) per raw unit.
    points : float
    about : str
    along_ray : bool
        It is distance along the ray.
    """

    pattern: str
    scale: float
    points: float
    about: str
    along_ray: bool = False


_STAMPS = r"^(rgb|color)/\d{9,}\.\d+|^depth/\d{9,}\.\d+"

CONVENTIONS: tuple[Convention, ...] = (
    Convention(
        r"proj_depth|velodyne_raw|depth_annotated|dense_depth|sparse_depth|depth-map|"
        r"lidar_depth|drive_\d{4}_sync|velodyne_raw",
        1 / 256,
        5,
        "LiDAR depth in images is mostly written as KITTI's: 256 units per metre",
    ),
    Convention(r"(?<!v)kitti(?!2)|velodyne|lidar", 1 / 256, 2, "KITTI has 256 units per metre"),
    Convention(
        rf"{_STAMPS}|^(rgb|depth)\.txt$|^associat\w*\.txt$|freiburg|^groundtruth\.txt$|\bicl|eth3d",
        1 / 5000,
        4,
        "TUM RGB-D's way of naming goes with its 5000 units per metre",
    ),
    Convention(
        r"replica|(^|/)results/(frame|depth)\d|cam_params",
        1 / 6553.5,
        5,
        "Replica as rendered for SLAM has 6553.5 units per metre",
    ),
    Convention(
        r"matterport|undistorted_depth|_d\d_\d|(^|/)mp3d",
        1 / 4000,
        5,
        "Matterport has 4000 units per metre",
    ),
    Convention(
        r"vkitti|(^|/)Scene\d\d/|synthia",
        0.01,
        4,
        "Virtual KITTI's and SYNTHIA's depth is in centimetres",
    ),
    Convention(
        r"_domain_depth|taskonomy|2d-?3d-?s|depth_zbuffer",
        1 / 512,
        4,
        "Stanford 2D-3D-S and Taskonomy have 512 units per metre",
    ),
    Convention(r"carla|(^|/)Town\d\d", 1000 / 65535, 5, "CARLA's far plane is at 1000 m"),
    Convention(r"apollo", 0.005, 3, "ApolloScape has 200 units per metre"),
    Convention(
        r"scene\d{4}_\d\d|scannet|seq-\d\d/frame-\d|depth_bfx|depth_u16|\bmm\b|_mm\b|iphone|"
        r"realsense|kinect|gmrp",
        MILLIMETRE,
        2,
        "sensors' depth, ScanNet's and SUN RGB-D's is in millimetres",
    ),
    Convention(r"hypersim|depth_meters", 1, 3, "Hypersim has distance along the ray", True),
    Convention(r"euclid|distance|(^|[/_])range", 1, 2, "named as a distance", True),
)


def conventions_in(names: list[str]) -> list[Convention]:
    """Return the conventions that any of the names goes with."""
    return [
        convention
        for convention in CONVENTIONS
        if any(re.search(convention.pattern, name, re.IGNORECASE) for name in names)
    ]
