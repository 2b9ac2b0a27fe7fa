"""The classes that label images have, by the values or colours in them."""

from __future__ import annotations

import colorsys
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_file
from nimprep.inspection.examination import Examination, Plane
from nimprep.inspection.kinds import Kind
from nimprep.inspection.samples import decoded

_MOST_FILES = 150
_MOST_CLASSES = 254
_IGNORED = 255
_COLOUR_LINE = re.compile(
    r"^\s*([A-Za-z][\w \-/]*?)[\s,:]+(\d{1,3})[\s,]+(\d{1,3})[\s,]+(\d{1,3})\s*$"
)


@dataclass(frozen=True)
class Labels:
    """Hold what a description says of labels, without their files.

    Attributes
    ----------
    document : dict
    classes : list of dict
    notes : list of str
    """

    document: dict[str, Any]
    classes: list[dict[str, Any]]
    notes: list[str]


def labels_of(found: Examination, plane: Plane) -> Labels:
    """Return classes as they are found, under names that say no more than their values."""
    images, whole = _images(found, plane)
    colours = plane.kind == Kind.COLOUR_LABEL
    made = _by_colour(found, images) if colours else _by_value(plane, images)
    if not whole:
        if not colours:
            # Only values that a map leaves out have a default.
            ids = {str(each["id"]): each["id"] for each in made.classes}
            made.document.setdefault("map", ids)
        made.document["default"] = _IGNORED
        made.notes.append(
            f"{len(images)} of {plane.count} labels were looked at: values in "
            "others alone are ignored (default 255)"
        )
    if plane.guess.channel:
        made.document["channel"] = plane.guess.channel
    return made


def _images(found: Examination, plane: Plane) -> tuple[list[npt.NDArray[Any]], bool]:
    """Return label images, and whether they are all that there are."""
    if plane.held is not None and plane.held.key:
        images = [sample.pixels for sample in plane.samples]
        return images, len(images) == plane.count
    members = plane.template.members
    step = -(-len(members) // _MOST_FILES)
    images = []
    pixels = 0
    for member in members[::step]:
        if pixels > 60_000_000:
            return images, False
        try:
            image = decoded(found.survey.root / member.path).pixels
        except DecodeError:
            continue
        pixels += image.size
        images.append(image)
    return images, step == 1


def _by_value(plane: Plane, images: list[npt.NDArray[Any]]) -> Labels:
    place = "RGBA".index(plane.guess.channel) if plane.guess.channel else 0
    counts: dict[int, int] = {}
    for image in images:
        plane_values = image if image.ndim == 2 else image[..., place]
        for value, count in zip(*np.unique(plane_values, return_counts=True), strict=True):
            counts[int(value)] = counts.get(int(value), 0) + int(count)
    values = sorted(counts)
    mask = _IGNORED in values and len(values) <= 3 and set(values) <= {0, 127, 128, _IGNORED}
    if values[0] < 0 or (values[-1] > _IGNORED or mask):
        return _renumbered(values, counts)
    kept = [value for value in values if value != _IGNORED]
    palette = plane.samples[0].palette
    classes = [_named(value, value, _color(value, palette)) for value in kept]
    notes = ["255 is taken for ignored pixels"] if _IGNORED in values else []
    if not classes:
        return _renumbered(values, counts)
    return Labels({}, classes, notes)


def _renumbered(values: list[int], counts: dict[int, int]) -> Labels:
    """Number values that are no class ids from 0 on; the rarest of too many are ignored."""
    kept = sorted(sorted(values, key=lambda value: -counts[value])[:_MOST_CLASSES])
    kept = [value for value in kept if 0 <= value <= 99_999]
    classes = [_named(k, value, _color(k, None)) for k, value in enumerate(kept)]
    document: dict[str, Any] = {"map": {str(value): k for k, value in enumerate(kept)}}
    notes = ["label values are numbered anew from 0 on"]
    if len(kept) < len(values):
        document["default"] = _IGNORED
    return Labels(document, classes, notes)


def _by_colour(found: Examination, images: list[npt.NDArray[Any]]) -> Labels:
    seen: dict[int, int] = {}
    weights = np.array([65536, 256, 1])
    for image in images:
        numbers, counts = np.unique(image[..., :3].astype(np.int64) @ weights, return_counts=True)
        for number, count in zip(numbers, counts, strict=True):
            seen[int(number)] = seen.get(int(number), 0) + int(count)
    names = _colour_names(found)
    kept = sorted(sorted(seen, key=lambda number: -seen[number])[:_MOST_CLASSES])
    document: dict[str, Any] = {"map": {f"#{number:06x}": k for k, number in enumerate(kept)}}
    if len(kept) < len(seen):
        document["default"] = _IGNORED
    classes = [
        {
            "id": k,
            "name": names.get(number, f"#{number:06x}"),
            "color": [number >> 16, number >> 8 & 255, number & 255],
        }
        for k, number in enumerate(kept)
    ]
    return Labels(document, classes, [] if names else ["classes are named by their colours"])


def _colour_names(found: Examination) -> dict[int, str]:
    """Return names of colours that a text beside the images gives: "Road 100 60 100"."""
    names: dict[int, str] = {}
    for template in found.texts[:20]:
        try:
            text = read_file(found.survey.root / template.members[0].path, 1 << 16)
        except DecodeError:
            continue
        for line in text.decode("utf-8", "replace").splitlines()[:300]:
            match = _COLOUR_LINE.match(line)
            if match and all(int(number) < 256 for number in match.groups()[1:]):
                red, green, blue = (int(number) for number in match.groups()[1:])
                names.setdefault(65536 * red + 256 * green + blue, match[1].strip())
    return names


def _named(class_id: int, value: int, color: list[int]) -> dict[str, Any]:
    return {"id": class_id, "name": f"class {value}", "color": color}


def _color(value: int, palette: npt.NDArray[np.uint8] | None) -> list[int]:
    """Return a class's colour: its palette's, else one far from those of its neighbours."""
    if palette is not None and value < len(palette):
        return [int(part) for part in palette[value]]
    if value == 0:
        return [0, 0, 0]
    parts = colorsys.hsv_to_rgb(value * 0.618034 % 1, 0.75, 0.95)
    return [round(255 * part) for part in parts]
