"""A folder description in JSON, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nimprep.errors import LayoutError
from nimprep.frame import LabelClass
from nimprep.images import OrientationRule, Raw
from nimprep.readers.description import (
    MOST_SCALE_M,
    CameraSource,
    ColorSource,
    DepthSource,
    Description,
    ExtraSource,
    GravitySource,
    Invalid,
    LabelSource,
    Match,
    PlaneSource,
    SplitSource,
    TransformSource,
    metres_per_unit,
)
from nimprep.readers.label_map import check_classes, with_map
from nimprep.readers.reference import Reference
from nimprep.schema import check_json, load_schema, read_json
from nimprep.schema_wording import alike

_SCALES = {
    "depth": ("scale_m", "offset_m"),
    "distance": ("scale_m", "offset_m"),
    "disparity": ("scale_px", "offset_px"),
    "inverse": ("scale_per_m", "offset_per_m"),
    "points": ("scale_m", "offset_m"),
}
"""The keys of scale and offset, by what depth's values are."""


def description_from_file(path: Path | str) -> Description:
    """Read a folder description (schemas/folder.schema.json).

    Raises
    ------
    LayoutError
        It is missing, no JSON, or does not fit the schema.
    """
    return description_from_document(read_json(Path(path), LayoutError), str(path))


def description_from_document(document: Any, where: str) -> Description:
    """Return the description that a JSON object is.

    Raises
    ------
    LayoutError
        It does not fit the schema, or contradicts itself.
    """
    _refuse_units_per_metre(document, where)
    check_json(document, "folder", where, LayoutError)
    rgb = document["rgb"] if isinstance(document["rgb"], dict) else {"files": document["rgb"]}
    _check_range(rgb.get("range"), where)
    classes = _classes(document, where)
    depth, label = document.get("depth"), document.get("label")
    planes = document.get("planes", {})
    described = Description(
        name=document["name"],
        rgb=ColorSource(**_plane(rgb, "range", "channels")),
        depth=None if depth is None else _depth(depth, where),
        label=None if label is None else _label(label, classes, where),
        planes={name: ExtraSource(**_plane(plane, *plane)) for name, plane in planes.items()},
        id=document.get("id"),
        classes=classes,
        camera=_camera(document["camera"], where) if "camera" in document else None,
        gravity=_gravity(document.get("gravity"), where),
        group=_group(document, where),
        split=_split(document.get("split")),
        no_split=document.get("split") is False,
        match=_match(document.get("match")),
        size=_frozen(document.get("size")),
        split_by=document.get("split_by"),
        only={name: tuple(values) for name, values in document.get("only", {}).items()},
        hha_ground=document.get("hha_ground"),
        reference=Reference(**document["reference"]) if "reference" in document else None,
    )
    return _oriented(described, document.get("orientation", "apply"))


def _check_range(ends: Any, where: str) -> None:
    if ends is not None and not ends[0] < ends[1]:
        raise LayoutError(
            f"{where}: expected a range from less to more in 'rgb', found {ends}; turn it around"
        )


def _oriented(description: Description, rule: OrientationRule) -> Description:
    """Return the description with what becomes of EXIF orientations, of whatever kind of image."""
    depth, label = description.depth, description.label
    if depth is not None and depth.confidence is not None:
        depth = replace(depth, confidence=replace(depth.confidence, orientation=rule))
    planes = description.planes.items()
    return replace(
        description,
        rgb=replace(description.rgb, orientation=rule),
        depth=None if depth is None else replace(depth, orientation=rule),
        label=None if label is None else replace(label, orientation=rule),
        planes={name: replace(source, orientation=rule) for name, source in planes},
    )


def _refuse_units_per_metre(document: Any, where: str) -> None:
    """Raise `LayoutError` where a scale plainly counts units per metre."""
    depth = document.get("depth") if isinstance(document, dict) else None
    scale = depth.get("scale_m") if isinstance(depth, dict) else None
    if isinstance(scale, (int, float)) and MOST_SCALE_M < scale < 1e9:
        raise LayoutError(
            f"{where}: expected metres per unit as scale_m, found {scale:g}; "
            f"{metres_per_unit(scale)}"
        )


def _frozen(value: Any) -> Any:
    """Return a JSON value with tuples in the place of lists."""
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def _plane(document: Mapping[str, Any], *names: str) -> dict[str, Any]:
    """Return the fields of a `PlaneSource`, and those named, as far as they are given."""
    known = {*PlaneSource.__dataclass_fields__, *names}
    given = {name: _frozen(value) for name, value in document.items() if name in known}
    if "raw" in given:
        given["raw"] = Raw(**given["raw"])
    return given


def _classes(document: Mapping[str, Any], where: str) -> tuple[LabelClass, ...]:
    classes = tuple(
        LabelClass(c["id"], c["name"], (c["color"][0], c["color"][1], c["color"][2]))
        for c in document.get("classes", [])
    )
    if "label" in document and not classes:
        raise LayoutError(
            f"{where}: expected 'classes' beside 'label', found none; say what the ids mean"
        )
    if len({c.id for c in classes}) != len(classes):
        raise LayoutError(f"{where}: expected each class id once, found one twice")
    return classes


def _group(document: Mapping[str, Any], where: str) -> str | None:
    group: str | None = document.get("group")
    if group is not None and group.count("{group}") > 1:
        raise LayoutError(f"{where}: expected one {{group}} in 'group', found several")
    return group


def _depth(document: Mapping[str, Any], where: str) -> DepthSource:
    values = document.get("values", "depth")
    scale, offset = _SCALES[values]
    others = {key for keys in _SCALES.values() for key in keys} - {scale, offset}
    if wrong := sorted(others & set(document)):
        raise LayoutError(
            f"{where}: expected {scale} and {offset} with depth whose values are {values!r}, "
            f"found {wrong[0]}; say in 'values' what they are"
        )
    if scale not in document:
        raise LayoutError(f"{where}: expected {scale} in 'depth', found none; add it")
    _check_depth(document, values, where)
    plain = ("values", "baseline_m", "fx", "range_m", "clip_m", "rotate_right", "bytes", "bytes_as")
    given = _plane(document, *plain, "columns")
    confidence = document.get("confidence")
    camera, transform = document.get("camera"), document.get("depth_to_rgb")
    to_camera = document.get("to_camera")
    return DepthSource(
        **given,
        scale=float(document[scale]),
        offset=float(document.get(offset, 0)),
        invalid=tuple(map(_invalid, document.get("invalid", [0]))),
        confidence=None if confidence is None else PlaneSource(**_plane(confidence)),
        least_confidence=1.0 if confidence is None else float(confidence.get("least", 1)),
        camera=None if camera is None else _camera(camera, where),
        depth_to_rgb=None if transform is None else _transform(transform, where),
        to_camera=None if to_camera is None else TransformSource(**to_camera),
    )


def _check_depth(document: Mapping[str, Any], values: str, where: str) -> None:
    """Raise `LayoutError` where what is said of depth would be passed over, or contradicts."""
    _check_points(document, values, where)
    packed: str = document.get("bytes", "")
    stereo = [name for name in ("baseline_m", "fx") if name in document]
    wrong = {
        f"'values': 'disparity' beside {' and '.join(stereo)}": stereo
        and "scale_px" not in document,
        "'bytes' or 'channel'": packed and "channel" in document,
        "four channels as float32": document.get("bytes_as") == "float32" and len(packed) != 4,
        "each channel once in 'bytes'": len(set(packed)) != len(packed),
    }
    ranges = [document.get("range_m"), *document.get("invalid", [])]
    for ends in (ends for ends in ranges if isinstance(ends, list) and None not in ends):
        if ends[0] > ends[1]:
            raise LayoutError(
                f"{where}: expected a range from less to more in 'depth', found {ends}; "
                "turn it around"
            )
    for expected in (expected for expected, is_wrong in wrong.items() if is_wrong):
        found = {"values": values} | {n: document[n] for n in ("bytes", "channel") if n in document}
        raise LayoutError(f"{where}: expected {expected} of depth, found {found}; mend the two")


_OF_IMAGES = (
    *("offset_m", "invalid", "range_m", "clip_m", "rotate_right", "bytes", "channel", "byte_order"),
    *("key", "axes", "raw", "confidence", "camera", "depth_to_rgb"),
)
"""What is said of depth's images, and of no points."""


def _check_points(document: Mapping[str, Any], values: str, where: str) -> None:
    """Raise `LayoutError` where points lack their place, or images have that of points."""
    if values == "points" and "to_camera" not in document:
        raise LayoutError(
            f"{where}: expected 'to_camera' with depth whose values are points, found none; say "
            "which file has the transform"
        )
    wrong = _OF_IMAGES if values == "points" else ("to_camera", "columns")
    if lost := [name for name in wrong if name in document]:
        raise LayoutError(
            f"{where}: expected no {lost[0]!r} with depth whose values are {values!r}, found one; "
            "leave it out"
        )


def _invalid(value: Any) -> Invalid:
    return (value[0], value[1]) if isinstance(value, list) else value


def _transform(rows: Any, where: str) -> tuple[tuple[float, ...], ...]:
    """Return a 3x4 or 4x4 transform as 4x4."""
    last = [0, 0, 0, 1]
    if len(rows) == 4 and rows[3] != last:
        raise LayoutError(
            f"{where}: expected {last} as the last row of depth_to_rgb, found {rows[3]}; "
            "leave it out"
        )
    return tuple(tuple(map(float, row)) for row in [*rows[:3], last])


def _label(document: Mapping[str, Any], classes: tuple[LabelClass, ...], where: str) -> LabelSource:
    source = LabelSource(**_plane(document, "default"))
    if source.default is not None:
        check_classes([source.default], classes, where)
    if "colors" in document:
        of_names = {name: int(value) for name, value in document["colors"]["map"].items()}
        check_classes(of_names.values(), classes, where)
        source = replace(source, names=document["colors"]["files"], named=of_names)
    named = document.get("map")
    if named is None:
        return source
    return with_map(source, {key: int(value) for key, value in named.items()}, classes, where)


def _camera(given: Any, where: str) -> CameraSource:
    if isinstance(given, str):
        return CameraSource(files=given)
    if given is False:
        return CameraSource(unknown=True)
    if "folders" in given:
        each = given["folders"].items()
        return CameraSource(folders=tuple((name, _camera(camera, where)) for name, camera in each))
    if "fov_deg" in given:
        return CameraSource(**given)
    if "files" not in given:
        _refuse_misspelt(given, where)
        said = {name: given[name] for name in ("distortion", "nominal") if name in given}
        if not isinstance(said.get("distortion"), str):
            # Coefficients are among the numbers.
            said.pop("distortion", None)
        numbers = {name: value for name, value in given.items() if name not in said}
        return CameraSource(numbers=numbers, **said)
    return CameraSource(**{name: _frozen(value) for name, value in given.items()})


def _refuse_misspelt(camera: Mapping[str, Any], where: str) -> None:
    """Raise `LayoutError` where a key of a camera's numbers is nearly one that is known.

    Camera files of other programs have keys that are passed over; here that would lose the size.
    """
    known = load_schema("camera")["properties"]
    for key in camera:
        meant = None if key in known else alike(key, [name for name in known if name not in camera])
        if meant is not None:
            raise LayoutError(
                f"{where}: expected keys of a camera that are known, found {key!r}; "
                f"did you mean {meant!r}?"
            )


def _gravity(document: Any, where: str) -> tuple[float, ...] | GravitySource | None:
    """Return what is said of gravity.

    Raises
    ------
    LayoutError
        Its columns do not hold what its values are said to be.
    """
    if not isinstance(document, dict):
        if document is not None and not any(document):
            raise LayoutError(
                f"{where}: expected a direction as 'gravity', found {document}; give numbers of "
                "which one is not 0"
            )
        return _frozen(document)  # type: ignore[no-any-return]
    source = GravitySource(**{name: _frozen(value) for name, value in document.items()})
    rotation = source.values in ("camera_to_world", "world_to_camera")
    needed = ("qx", "qy", "qz", "qw") if rotation else ("x", "y", "z")
    if missing := [name for name in needed if name not in source.columns]:
        raise LayoutError(
            f"{where}: expected the columns {', '.join(needed)} of gravity's {source.values!r}, "
            f'found no {missing[0]}; name them in "columns", "" for those to pass over'
        )
    if rotation != (source.down is not None) or (source.down is not None and not any(source.down)):
        expected = (
            "the direction of gravity in the world, such as [0, 0, -1]," if rotation else "no"
        )
        raise LayoutError(
            f"{where}: expected {expected} 'down' with gravity's {source.values!r}, found "
            f"{source.down}; mend it"
        )
    _check_rotation(source.sensor_to_camera, where)
    return source


def _check_rotation(rows: tuple[tuple[float, ...], ...] | None, where: str) -> None:
    if rows is None:
        return
    matrix = np.array(rows)
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-3 or np.linalg.det(matrix) < 0:
        raise LayoutError(
            f"{where}: expected a rotation as sensor_to_camera, found {rows}; give the sensor's "
            "axes in the camera's frame as its columns"
        )


def _split(document: Any) -> SplitSource | None:
    return SplitSource(**document) if isinstance(document, dict) else None


def _match(document: Any) -> Match | None:
    if document is None:
        return None
    return Match(**{name: _frozen(value) for name, value in document.items()})
