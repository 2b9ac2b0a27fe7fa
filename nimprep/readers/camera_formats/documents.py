"""Cameras in JSON and YAML, by the names that tools give their numbers.

Known are, beside nimprep's own (schemas/camera.schema.json): ROS sensor_msgs/CameraInfo and the
files of its camera_calibration, OpenCV's FileStorage, Open3D's PinholeCameraIntrinsic and
trajectories, librealsense's rs2_intrinsics, Cityscapes' camera.json, ORB-SLAM's settings, Kalibr's
camchain, nerfstudio's transforms.json; see the documentation of each.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from nimprep.errors import CameraError
from nimprep.readers.camera_formats.numbers import (
    CameraNumbers,
    Intrinsics,
    intrinsics_of_matrix,
    number_of,
    numbers_in,
    size_of,
)
from nimprep.readers.description import CameraSource
from nimprep.readers.distortion import Distortion, distortion_from, known_projection

_FOCAL = (("fx", "fy"), ("fl_x", "fl_y"))
_CENTRE = (("cx", "cy"), ("ppx", "ppy"), ("u0", "v0"))
_MATRIX = ("K", "k", "camera_matrix", "intrinsic_matrix", "cam_K", "intrinsics", "intrinsic")
_SIZE = (("width", "height"), ("image_width", "image_height"), ("w", "h"))
_COEFFICIENTS = (
    *("D", "d", "coeffs", "coefficients", "dist_coeffs", "distCoeffs"),
    *("distortion", "distortion_coeffs", "distortion_coefficients"),
)
_MODEL = ("distortion_model", "model", "camera_model", "Camera.type", "Camera1.type")
_PROJECTION = ("P", "p", "projection_matrix")
_PREFIXES = ("", "Camera.", "Camera1.")
_BROWN_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_SUSPECT = re.compile(r"distort|^dist|^radial|^tangential|coef|^(k\d+|p[12])$", re.IGNORECASE)
_DEEPEST = 5
_ROTATION_TOLERANCE = 1e-3
"""KITTI's rotations, which have 12 digits, are off by 1e-7 once several are multiplied."""


def numbers_of_document(document: Any, where: str, source: CameraSource) -> CameraNumbers | None:
    """Return the camera in a JSON or YAML document; None = there is none.

    Parameters
    ----------
    source : CameraSource
        Its `keys` say where each number stands, its `key` in which object.

    Raises
    ------
    CameraError
        It has several cameras, or one that contradicts itself.
    """
    if source.keys:
        return _numbers_by_path(document, where, source.keys)
    if source.key is not None:
        part = _at(document, source.key)
        if isinstance(part, (list, tuple)):
            part = {"K": part}
        found = dict(_cameras(part, where))
        if not found:
            raise CameraError(
                f"{where}: expected a camera at the key {source.key!r}, found none; "
                f"the file has {_names(document)}"
            )
    else:
        found = dict(_cameras(document, where))
    if len(set(found.values())) > 1:
        raise CameraError(
            f"{where}: expected one camera, found {', '.join(map(repr, list(found)[:6]))}; "
            "name one by the description's camera.key"
        )
    return next(iter(found.values()), None)


def _names(document: Any) -> str:
    names = list(document) if isinstance(document, Mapping) else []
    return ", ".join(repr(str(name)[:40]) for name in names[:8]) or "no keys"


def _at(document: Any, path: str) -> Any:
    """Return what stands at "a.b.0"; a key that has dots itself is found too."""
    if isinstance(document, Mapping) and path in document:
        return document[path]
    head, _, rest = path.partition(".")
    if isinstance(document, Mapping) and head in document:
        inner = document[head]
    elif isinstance(document, list) and head.isdecimal() and int(head) < len(document):
        inner = document[int(head)]
    else:
        return None
    return _at(inner, rest) if rest else inner


def _numbers_by_path(document: Any, where: str, keys: Mapping[str, str]) -> CameraNumbers:
    given = {name: number_of(_at(document, path)) for name, path in keys.items()}
    for name in ("fx", "fy", "cx", "cy"):
        if math.isnan(given.get(name, math.nan)):
            if name not in keys:
                raise CameraError(f"{where}: expected {name} among 'keys', found none; add it")
            path = keys[name]
            raise CameraError(
                f"{where}: expected a number for {name} at {path!r}, found "
                f"{str(_at(document, path))[:80]}; it has {_names(document)}"
            )
    parents = {path.rpartition(".")[0] for path in keys.values()}
    beside = [_at(document, p) if p else document for p in parents]
    lenses = [_distortion(each, where) for each in beside if isinstance(each, Mapping)]
    return CameraNumbers(
        (given["fx"], given["fy"], given["cx"], given["cy"]),
        "JSON by keys",
        size_of(given.get("width"), given.get("height")),
        given.get("baseline_m", math.nan),
        next(filter(None, lenses), None),
    )


def _cameras(document: Any, where: str, path: str = "") -> Iterator[tuple[str, CameraNumbers]]:
    """Yield the cameras of a document and where each stands, an outer one before those in it."""
    depth = path.count(".") + bool(path)
    if not isinstance(document, (Mapping, list)) or depth > _DEEPEST:
        return
    if isinstance(document, Mapping):
        found = _camera(document, where)
        if found is not None:
            yield path, found
            return
        inner = list(document.items())
    else:
        inner = [(str(place), item) for place, item in enumerate(document)]
    for name, item in inner[:1000]:
        for place, camera in _cameras(item, where, f"{path}.{name}" if path else str(name)):
            yield place, _with_baseline(camera, document)


def _with_baseline(camera: CameraNumbers, outer: Any) -> CameraNumbers:
    """Add Cityscapes' baseline, metres, which stands beside the camera."""
    baseline = number_of(_at(outer, "extrinsic.baseline"))
    if math.isnan(baseline) or not math.isnan(camera.baseline_m):
        return camera
    return replace(camera, format="Cityscapes camera", baseline_m=baseline)


def _first(document: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((document[name] for name in names if name in document), None)


def _pair(document: Mapping[str, Any], pairs: tuple[tuple[str, str], ...]) -> tuple[float, ...]:
    """Return the first two numbers of any of these names; () = there are none."""
    for first, second in pairs:
        for prefix in _PREFIXES:
            a = number_of(document.get(prefix + first))
            b = number_of(document.get(prefix + second))
            if not math.isnan(a + b):
                return a, b
    return ()


def _camera(document: Mapping[str, Any], where: str) -> CameraNumbers | None:
    """Return the camera that a mapping is; None = it is none itself."""
    focal, centre = _pair(document, _FOCAL), _pair(document, _CENTRE)
    said: Intrinsics | None = None
    if focal and centre:
        said = (focal[0], focal[1], centre[0], centre[1])
    name = next((n for n in _MATRIX if len(numbers_in(document.get(n))) in (4, 9, 16)), None)
    matrix = None
    if name is not None:
        numbers = numbers_in(document[name])
        matrix = (numbers[0], numbers[1], numbers[2], numbers[3])
        if len(numbers) > 4:
            matrix = intrinsics_of_matrix(numbers, f"{where}: {name}")
    if said and matrix and said != matrix:
        raise CameraError(
            f"{where}: expected one camera, found fx, fy, cx, cy {said} beside {name} {matrix}; "
            "remove those that are wrong"
        )
    intrinsics = said or matrix
    if intrinsics is None:
        return None
    _check_whole(document, where)
    resolution = numbers_in(document.get("resolution"))
    if len(resolution) != 2:
        resolution = _pair(document, _SIZE) or (0.0, 0.0)
    size = size_of(*resolution)
    rectified, shift = _projection(document, where)
    return CameraNumbers(
        intrinsics,
        _format(document, name),
        size,
        _baseline(document, intrinsics[0], shift),
        _distortion(document, where),
        rectified,
        pixel_origin=1 if number_of(document.get("pixel_origin")) == 1 else 0,
        cam_to_road=_transform(document.get("cam_to_road"), where),
        gravity=_gravity(document.get("gravity"), where),
    )


def _gravity(given: Any, where: str) -> tuple[float, ...] | None:
    """Return a direction's 3 numbers; None = the file says none."""
    if given is None:
        return None
    numbers = numbers_in(given)
    if len(numbers) == 3 and any(numbers):
        return numbers
    raise CameraError(
        f"{where}: expected gravity to be a direction, 3 numbers, not all of them 0, found "
        f"{str(given)[:80]}; give [x, y, z] with x right, y down and z forward, or leave it out"
    )


def _transform(given: Any, where: str) -> tuple[float, ...] | None:
    """Return a transform's 12 numbers; None = the file says none."""
    if given is None:
        return None
    numbers = numbers_in(given)
    if len(numbers) == 12:
        rotation = np.array(numbers).reshape(3, 4)[:, :3]
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
        if off <= _ROTATION_TOLERANCE and np.linalg.det(rotation) > 0:
            return numbers
    raise CameraError(
        f"{where}: expected cam_to_road to be a rotation and a shift, 3 rows of 4 numbers, found "
        f"{str(given)[:80]}; give [[r, r, r, t], ...] in metres, or leave it out"
    )


def _format(document: Mapping[str, Any], matrix: str | None) -> str:
    if "ppx" in document:
        return "RealSense intrinsics"
    if matrix == "intrinsic_matrix":
        return "Open3D camera"
    if matrix in ("K", "k") and ("D" in document or "d" in document):
        return "ROS camera_info"
    if matrix == "camera_matrix":
        return "OpenCV or ROS calibration"
    if any(str(name).startswith("Camera") for name in document):
        return "ORB-SLAM settings"
    return "camera"


def _check_whole(document: Mapping[str, Any], where: str) -> None:
    """Refuse a camera_info of a part of the image, or of pixels put together."""
    for name in ("binning_x", "binning_y", "roi.x_offset", "roi.y_offset"):
        value = number_of(_at(document, name))
        if value > (1 if name.startswith("binning") else 0):
            raise CameraError(
                f"{where}: expected a camera of the whole image, found {name} {value:g}; "
                "give the numbers of the images as they are"
            )


def _projection(document: Mapping[str, Any], where: str) -> tuple[Intrinsics | None, float]:
    """Return the camera of rectified images that P says, and fx times its shift to the left."""
    numbers = numbers_in(_first(document, _PROJECTION))
    if len(numbers) != 12 or not numbers[0] > 0:
        return None, 0.0
    return intrinsics_of_matrix(numbers, f"{where}: P"), -numbers[3]


def _baseline(document: Mapping[str, Any], fx: float, shift: float) -> float:
    said = number_of(_first(document, ("baseline_m", "Stereo.b")))
    times_fx = number_of(document.get("Camera.bf"))
    if not math.isnan(said):
        return said
    if not math.isnan(times_fx):
        return times_fx / fx if fx else math.nan
    return abs(shift) / fx if shift and fx else math.nan


def _distortion(document: Mapping[str, Any], where: str) -> Distortion | None:
    """Return the distortion that a mapping says, under whatever name; unknown ones are kept."""
    projection = str(document.get("camera_model", ""))[:80]
    if not known_projection(projection):
        raise CameraError(
            f"{where}: expected a pinhole or fisheye camera, found the model {projection!r}; "
            "undistort the images to a pinhole's"
        )
    # Kalibr's camera_model is a pinhole's where its distortion_model says more.
    model = next((str(document[name]) for name in _MODEL if name in document), None)
    listed = next((n for n in _COEFFICIENTS if n in document), None)
    if listed is not None and isinstance(document[listed], Mapping) and "k1" in document[listed]:
        document = {**document, **document[listed]}
        listed = None
    coefficients = () if listed is None else numbers_in(document[listed])
    named, used = _named(document, model)
    found = distortion_from(model, coefficients), distortion_from(model, named)
    if found[0] and found[1] and not _same(found[0], found[1]):
        raise CameraError(
            f"{where}: expected one distortion, found {found[0]} beside {found[1]}; "
            "remove the one that is wrong"
        )
    others = {*used, *_MODEL} | ({listed} if coefficients else set())
    for name, value in document.items():
        bare = str(name).rpartition(".")[2]
        if name in others or not _SUSPECT.search(bare):
            continue
        numbers = numbers_in(value) or numbers_in([value])
        if any(numbers) or (not numbers and value not in (None, "", [], {}, "[]")):
            return Distortion(f"what {str(name)[:40]!r} says", numbers)
    return found[0] or found[1]


def _named(document: Mapping[str, Any], model: str | None) -> tuple[tuple[float, ...], set[str]]:
    """Return coefficients that have names, and which: k1, k2, p1 and so on."""
    fisheye = distortion_from(model, (1.0,))
    names: tuple[str, ...] = _BROWN_NAMES
    if fisheye is not None and fisheye.model == "fisheye":
        names = ("k1", "k2", "k3", "k4")
    for prefix in _PREFIXES:
        there = {prefix + name for name in names if prefix + name in document}
        values = [number_of(document.get(prefix + name, 0)) for name in names]
        if there and not any(map(math.isnan, values)):
            while len(values) > 4 and values[-1] == 0:
                values.pop()
            # OpenCV's take 4, 5 or 8.
            more = 8 if len(values) > 5 else len(values)
            return (*values, *[0.0] * (more - len(values))), there
    return (), set()


def _same(one: Distortion, other: Distortion) -> bool:
    longest = max(len(one.coefficients), len(other.coefficients))
    padded = [(*d.coefficients, *[0.0] * (longest - len(d.coefficients))) for d in (one, other)]
    return one.model == other.model and padded[0] == padded[1]
