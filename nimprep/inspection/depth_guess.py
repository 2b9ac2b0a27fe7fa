"""Which encoding the depth or disparity images of one pattern have."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nimprep.inspection.conventions import Convention, conventions_in
from nimprep.inspection.encodings import (
    Clues,
    Encoding,
    cityscapes_offset,
    disparities_of,
    encodings_of,
    encodings_of_bytes,
)
from nimprep.inspection.examination import CameraFiles, Examination, Plane
from nimprep.inspection.kinds import Kind
from nimprep.inspection.planes import byte_order, float_order, floats_of
from nimprep.inspection.raw_depth import ground_of, planes_of, raw_depth_of


def depth_encodings(found: Examination, plane: Plane) -> list[Encoding]:
    """Return what the numbers of a pattern's images may mean, the likeliest first."""
    camera = camera_for(found, plane)
    clues = Clues(
        conventions=tuple(_conventions(found, plane)),
        numbers={} if camera is None else camera.calibration.numbers,
        **_stated(found),  # type: ignore[arg-type]
        named=plane.kind,
    )
    pixels = [sample.pixels for sample in plane.samples]
    if pixels[0].ndim == 3 and pixels[0].dtype == np.uint8:
        packed = float_order(pixels)
        if packed:
            planes = [floats_of(each, packed) for each in pixels]
            read = {"bytes": packed, "bytes_as": "float32"}
            return [
                replace(each, document={**each.document, **read})
                for each in encodings_of(planes, clues)
            ]
        order = byte_order(pixels)
        return encodings_of_bytes(pixels, order, clues) if order else []
    planes = planes_of(plane.samples, plane.guess.channel)
    kind, why = _kind(plane)
    if kind == Kind.DEPTH:
        return [_with(each, why) for each in encodings_of(planes, clues)]
    disparities = disparities_of(planes, clues)
    named = re.search(r"_disparity\.\w+$", plane.pattern) and planes[0].dtype == np.uint16
    if disparities and named:
        cameras = camera is not None and "baseline_m" in camera.calibration.numbers
        if cameras or re.search(r"leftImg8bit|gtFine", " ".join(p.pattern for p in found.planes)):
            disparities[0] = cityscapes_offset(disparities[0])
    return [_with(each, why) for each in disparities]


def _with(encoding: Encoding, why: str) -> Encoding:
    return replace(encoding, reasons=(*encoding.reasons, why)) if why else encoding


def _kind(plane: Plane) -> tuple[str, str]:
    """Return whether values are depth or disparity, and why where names say otherwise."""
    raw = raw_depth_of(planes_of(plane.samples, plane.guess.channel))
    ground = None if raw is None else ground_of(raw)
    if ground is None:
        return plane.kind, ""
    if plane.kind == Kind.DEPTH and ground.slope > 0 and ground.disparity_fit > 0.9:
        why = "named depth, but values grow evenly towards the bottom, as disparity does"
        return Kind.DISPARITY, why
    if plane.kind == Kind.DISPARITY and ground.slope < 0 and ground.depth_fit > 0.9:
        return Kind.DEPTH, "named disparity, but values fall towards the bottom, as depth does"
    return plane.kind, ""


def _conventions(found: Examination, plane: Plane) -> list[Convention]:
    root = found.survey.root
    names = [root.resolve().name, plane.name]
    names += [template.pattern for template in found.texts]
    names += [camera.template.pattern for camera in found.cameras]
    names += [p.template.members[0].path for p in found.planes]
    names += [template.pattern for template in found.others]
    names += [cloud.pattern for cloud in found.clouds]
    return conventions_in(names)


def _stated(found: Examination) -> dict[str, object]:
    for camera in found.cameras:
        if camera.calibration.depth_scale is not None:
            return {
                "stated": camera.calibration.depth_scale,
                "stated_where": camera.template.pattern,
            }
    return {}


def camera_for(found: Examination, plane: Plane) -> CameraFiles | None:
    """Return the camera files that most likely hold for a pattern's images."""
    whole = [c for c in found.cameras if {"fx", "fy", "cx", "cy"} <= c.calibration.numbers.keys()]
    return max(whole, key=lambda camera: _fitness(camera, plane), default=None)


def _fitness(camera: CameraFiles, plane: Plane) -> tuple[bool, bool, int]:
    name = camera.template.pattern.lower()
    width, _ = plane.samples[0].size
    numbers = camera.calibration.numbers
    fits = numbers.get("width", 2 * numbers["cx"]) < 1.5 * width
    depth = "depth" in name and plane.kind == Kind.DEPTH
    return fits, depth or "color" in name or "rgb" in name, len(camera.template.members)


def sorted_depth(planes: Sequence[Plane]) -> list[Plane]:
    """Return planes of depth, whole ones first."""
    order = ("sparse", "raw", "gt", "right", "pred", "est")

    def rank(plane: Plane) -> tuple[int, int]:
        name = plane.name.lower()
        later = sum(word in name for word in order)
        later -= any(word in name for word in ("bfx", "filled", "refined"))
        return later, -len(plane.template.members)

    return sorted(planes, key=rank)
