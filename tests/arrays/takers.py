"""Every public function that takes arrays, and arrays to hand it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import nimprep
from nimprep import Camera, Frame, RoadProfile, kitti, metrics
from nimprep.kitti.calibration import Calibration
from nimprep.kitti.images import GroundTruth
from tests.derive.roads import CAMERA, ROADS, plane_of, road_depth
from tests.kitti.scenes import HEIGHT, MATRICES, WIDTH

REFUSED = "refused"
"""In place of what a masked pixel is read as: it is an error."""

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Argument:
    """An array to hand to a function.

    Attributes
    ----------
    array : array
        Plain: in C order, of the machine's bytes, and of the type that the function computes in.
    masked : number or REFUSED, optional
        What a masked element is read as; REFUSED = it is an error, None = as not evaluated.
    dtypes : tuple of str
        The types that must give the same result; the array's numbers are the same in all of them.
    like : str
        What the numbers are, for attacks: "depth", "disparity", "signed", "points" or "" = others.
    """

    array: Array
    masked: Any
    dtypes: tuple[str, ...] = ()
    like: str = ""


@dataclass(frozen=True)
class Taker:
    """A public function that takes arrays: how to call it, with a camera and the arrays by name.

    Attributes
    ----------
    name : str
        Of the function, "module.function", and what else tells a way to call it apart.
    absent : number
        What its result has exactly where there is no depth; None = that is not promised.
    beside : bool
        Whether it has that, too, where none of a pixel's four neighbours has depth.
    gives_depth : bool
        Whether its first result is depth: 0 or at least 0.1 mm.
    """

    name: str
    call: Callable[..., Any]
    arguments: dict[str, Argument] = field(default_factory=dict)
    absent: float | None = None
    beside: bool = False
    gives_depth: bool = False

    @property
    def function(self) -> str:
        """The function's public name."""
        return self.name.split()[0]


FLOATS = ("<f4", ">f4", "<f8", ">f8", "<f2", "g")
NUMBERS = ("<f8", ">f8", "<f4", "<i8")

rng = np.random.default_rng(5)


def _exact(values: Array) -> Array:
    """Return float32 numbers that half precision holds as well."""
    return values.astype(np.float16).astype(np.float32)


ROAD = _exact(road_depth(plane_of(*ROADS["rolled"])))
FULL = _exact(2 + rng.random(CAMERA.shape))
HOLES = np.where(rng.random(CAMERA.shape) < 0.1, 0, FULL).astype(np.float32)
DISPARITY = _exact(nimprep.disparity_from_depth(ROAD, CAMERA, 0.5))
TRANSFORMED = _exact(np.where(ROAD > 0, rng.standard_normal(CAMERA.shape), np.nan))
PROFILE = RoadProfile(3.0, (1.0, 0.125, 0.0), (80.0, 180.0))
MISSING = rng.random(CAMERA.shape) < 0.1
COLORS = rng.integers(0, 256, (*CAMERA.shape, 3), np.uint8)
LABEL = rng.integers(0, 3, CAMERA.shape, np.uint8)
PLANE = np.array([0.0, -1.0, 0.0, 2.0])
TO_ROAD = np.array([[1.0, 0, 0, 0], [0, 1, 0, -2], [0, 0, 1, 0]])
SCAN = _exact(rng.uniform((2, -3, -2, 0), (9, 3, 1, 1), (500, 4)))
CALIBRATION = Calibration(Path("calib.txt"), MATRICES)


def depth(array: Array = ROAD) -> Argument:
    return Argument(array, 0, FLOATS, "depth")


def disparity(array: Array = DISPARITY) -> Argument:
    return Argument(array, 0, FLOATS, "disparity")


def numbers(array: Array) -> Argument:
    return Argument(array, REFUSED, NUMBERS)


def colors(array: Array = COLORS) -> Argument:
    return Argument(array, REFUSED)


def _normals(**options: Any) -> Callable[..., Any]:
    def call(camera: Camera, depth_m: Any) -> Any:
        return nimprep.estimate_normals(depth_m, camera, **options)

    return call


def _fill(method: Any) -> Callable[..., Any]:
    def call(camera: Camera, depth_m: Any, rgb: Any = None) -> Any:
        return nimprep.fill_depth(depth_m, method, rgb)

    return call


def _overlay(camera: Camera, image: Any, confidence: Any, positive: Any, evaluated: Any) -> Any:
    return kitti.draw_overlay(image, confidence, GroundTruth(positive, evaluated))


def _calibrated(camera: Camera, p2: Any) -> Any:
    made = Calibration(Path("calib.txt"), MATRICES | {"P2": p2})
    return made.camera(HEIGHT, WIDTH), made.velo_to_cam, made.baseline_m


def _metric(name: str) -> Taker:
    counts = rng.integers(0, 99, (3, 3))
    return Taker(
        f"nimprep.metrics.{name}",
        lambda camera, confusion: getattr(metrics, name)(confusion),
        {"confusion": Argument(counts, REFUSED, ("<i8", ">i8", "<i4"))},
    )


TAKERS = (
    Taker(
        "nimprep.Camera from_matrix",
        lambda camera, matrix: Camera.from_matrix(matrix, 64, 48),
        {"matrix": numbers(np.array([[50.0, 0, 32], [0, 60, 24], [0, 0, 1]]))},
    ),
    Taker(
        "nimprep.Frame",
        lambda camera, **images: Frame("a", camera, **images),
        {
            "rgb": colors(),
            "depth_m": depth(),
            "label": Argument(LABEL, 255),
        },
    ),
    Taker(
        "nimprep.depth_from_disparity",
        lambda camera, disparity: nimprep.depth_from_disparity(disparity, camera),
        {"disparity": disparity()},
        gives_depth=True,
    ),
    Taker(
        "nimprep.disparity_from_depth",
        lambda camera, depth_m: nimprep.disparity_from_depth(depth_m, camera),
        {"depth_m": depth()},
        absent=0,
    ),
    Taker(
        "nimprep.encode_hha",
        lambda camera, depth_m, **known: nimprep.encode_hha(depth_m, camera, **known),
        {"depth_m": depth(), "missing": Argument(MISSING, True), "gravity": numbers(PLANE[:3])},
        absent=0,
    ),
    Taker(
        "nimprep.encode_hha alone",
        lambda camera, depth_m: nimprep.encode_hha(depth_m, camera),
        {"depth_m": depth()},
        absent=0,
    ),
    Taker(
        "nimprep.estimate_elevation",
        lambda camera, depth_m, plane: nimprep.estimate_elevation(depth_m, camera, plane),
        {"depth_m": depth(), "plane": numbers(PLANE)},
        absent=np.nan,
    ),
    Taker(
        "nimprep.estimate_gravity",
        lambda camera, depth_m, missing: nimprep.estimate_gravity(depth_m, camera, missing),
        {"depth_m": depth(FULL), "missing": Argument(MISSING, True)},
    ),
    Taker(
        "nimprep.estimate_normals nim", _normals(), {"depth_m": depth(HOLES)}, absent=0, beside=True
    ),
    Taker(
        "nimprep.estimate_normals sign filter",
        _normals(sign_filter=True),
        {"depth_m": depth(HOLES)},
        absent=0,
        beside=True,
    ),
    Taker(
        "nimprep.estimate_normals nim-edge",
        _normals(method="nim-edge"),
        {"depth_m": depth(HOLES)},
        absent=0,
        beside=True,
    ),
    *(
        Taker(
            f"nimprep.estimate_normals nim-edge, noise {noise}",
            _normals(method="nim-edge", noise=noise),
            {"depth_m": depth(HOLES)},
            absent=0,
            beside=True,
        )
        for noise in (0.01, 1e300, 5e-324)
    ),
    Taker(
        "nimprep.estimate_road_plane",
        lambda camera, depth_m: nimprep.estimate_road_plane(depth_m, camera),
        {"depth_m": depth()},
    ),
    Taker(
        "nimprep.estimate_road_profile",
        lambda camera, disparity: nimprep.estimate_road_profile(disparity),
        {"disparity": disparity()},
    ),
    *(
        Taker(
            f"nimprep.fill_depth {method}",
            _fill(method),
            {"depth_m": depth(HOLES)},
            gives_depth=True,
        )
        for method in ("nearest", "linear")
    ),
    Taker(
        "nimprep.fill_depth colorization",
        _fill("colorization"),
        {"depth_m": depth(HOLES), "rgb": colors()},
        gives_depth=True,
    ),
    Taker(
        "nimprep.restore_disparity",
        lambda camera, transformed: nimprep.restore_disparity(transformed, PROFILE),
        {"transformed": Argument(TRANSFORMED, np.nan, FLOATS, "signed")},
    ),
    Taker(
        "nimprep.road_plane",
        lambda camera, cam_to_road: nimprep.road_plane(cam_to_road),
        {"cam_to_road": numbers(TO_ROAD)},
    ),
    Taker(
        "nimprep.transform_disparity",
        lambda camera, disparity: nimprep.transform_disparity(disparity, PROFILE),
        {"disparity": disparity()},
        absent=np.nan,
    ),
    Taker("nimprep.kitti.Calibration", _calibrated, {"p2": numbers(np.rint(MATRICES["P2"]))}),
    Taker(
        "nimprep.kitti.draw_overlay",
        _overlay,
        {
            "image": colors(),
            "confidence": Argument(COLORS[..., 0].copy(), REFUSED),
            "positive": Argument(MISSING, None),
            "evaluated": Argument(~MISSING, False),
        },
    ),
    Taker(
        "nimprep.kitti.match_stereo",
        lambda camera, left, right: kitti.match_stereo(left, right),
        {"left": colors(COLORS[:20]), "right": colors(COLORS[:20])},
    ),
    Taker(
        "nimprep.kitti.stereo_depth",
        lambda camera, left, right: kitti.stereo_depth(left, right, CALIBRATION),
        {"left": colors(COLORS[:20]), "right": colors(COLORS[:20])},
    ),
    Taker(
        "nimprep.kitti.project_lidar",
        lambda camera, points: kitti.project_lidar(points, CALIBRATION, HEIGHT, WIDTH),
        {"points": Argument(SCAN, np.nan, FLOATS, "points")},
        gives_depth=True,
    ),
    Taker(
        "nimprep.kitti.transform_to_bev",
        lambda camera, image: kitti.transform_to_bev(image, CALIBRATION),
        {"image": Argument(FULL[:HEIGHT, :WIDTH].copy(), REFUSED)},
    ),
    Taker(
        "nimprep.metrics.confusion_matrix",
        lambda camera, label, prediction: metrics.confusion_matrix(label, prediction, 3),
        {
            "label": Argument(LABEL, 255, ("<i8", ">i4", "<u2")),
            "prediction": Argument(LABEL[::-1].copy(), REFUSED, ("<i8", ">i4", "<u2")),
        },
    ),
    Taker(
        "nimprep.metrics.count_confidences",
        lambda camera, **arrays: metrics.count_confidences(**arrays),
        {
            "confidence": Argument(COLORS[..., 0].copy(), REFUSED),
            "positive": Argument(MISSING, None),
            "evaluated": Argument(LABEL > 0, False),
        },
    ),
    Taker(
        "nimprep.metrics.precision_recall_curve",
        lambda camera, counts: metrics.precision_recall_curve(counts),
        {"counts": Argument(rng.integers(0, 99, (2, 256)), REFUSED, ("<i8", ">i8", "<i4"))},
    ),
    Taker(
        "nimprep.metrics.roc_auc",
        lambda camera, scores, positive: metrics.roc_auc(scores.reshape(-1), positive.reshape(-1)),
        {
            "scores": Argument(FULL, REFUSED, ("<f4", ">f4", "<f8", ">f8")),
            "positive": Argument(MISSING, REFUSED),
        },
    ),
    *(_metric(f"{name}_per_class") for name in ("precision", "recall", "f_score", "iou")),
    _metric("pixel_accuracy"),
)


def leaves(result: Any) -> list[Array]:
    """Return the arrays and numbers of a result, whatever holds them."""
    if isinstance(result, tuple | list):
        return [leaf for part in result for leaf in leaves(part)]
    if isinstance(result, Frame):
        return leaves([result.image(name) for name in ("rgb", "depth", "label")])
    if hasattr(result, "__dataclass_fields__"):
        return leaves([getattr(result, name) for name in result.__dataclass_fields__])
    return [np.asarray(result)]
