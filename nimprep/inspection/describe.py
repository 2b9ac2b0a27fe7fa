"""A folder description to start from, of what was found."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.inspection.arrangement import Arrangement, Part
from nimprep.inspection.calibrations import Calibration
from nimprep.inspection.camera_forms import camera_form
from nimprep.inspection.examination import Examination
from nimprep.inspection.kinds import Kind
from nimprep.inspection.label_values import labels_of
from nimprep.inspection.split_lists import split_lists
from nimprep.inspection.templates import Member

_PLACEHOLDER = re.compile(r"\{(\w+)\}")


@dataclass
class Described:
    """Hold a description, and what in it is a guess.

    Attributes
    ----------
    document : dict
        Of schemas/folder.schema.json.
    notes : list of str
    """

    document: dict[str, Any]
    notes: list[str] = field(default_factory=list)


def describe(found: Examination, made: Arrangement) -> Described:
    """Return the description of a dataset whose patterns are arranged."""
    name = re.sub(r"[^\w.\-]+", "-", found.survey.root.resolve().name) or "dataset"
    document: dict[str, Any] = {"format": "nimprep-folder", "version": "1.1", "name": name}
    result = Described(document, list(made.notes))
    placeholders = list(dict.fromkeys(_PLACEHOLDER.findall(made.color.files)))
    if placeholders not in ([], ["id"]):
        document["id"] = "/".join(f"{{{name}}}" for name in placeholders)
    document["rgb"] = _color(made)
    if made.depth is not None and made.encoding is not None:
        document["depth"] = _depth(made, result)
    elif found.clouds:
        result.notes.append("LiDAR scans are no depth images, and are left out")
    if made.label is not None:
        labels = labels_of(found, made.label.plane)
        missing = _missing(made, made.label)
        document["label"] = {
            "files": made.label.files,
            **_array(made.label),
            **labels.document,
            **missing,
        }
        document["classes"] = labels.classes
        result.notes += labels.notes
    _add_thermal(made, document)
    if made.camera is not None:
        document["camera"] = _camera(made, found.survey.root)
    if "scene" in placeholders and placeholders != ["scene"]:
        document["group"] = "{scene}"
    _add_split(found, made, document, placeholders, result)
    if made.stamp_unit is not None:
        document["match"] = {"by": "{id}", "unit_s": made.stamp_unit}
    _add_size(made, document, result)
    return result


def _array(part: Part) -> dict[str, Any]:
    """Return what a description says of an array in a container, or of bare numbers."""
    held, raw = part.plane.held, part.plane.raw
    if raw is not None:
        return {"raw": {"dtype": raw.dtype, "width": raw.width, "height": raw.height}}
    if held is None or not held.key:
        return {}
    plain = held.axes in ("HW", "HWC")
    return {"key": held.key} if plain else {"key": held.key, "axes": held.axes}


def _color(made: Arrangement) -> Any:
    if array := _array(made.color):
        return {"files": made.color.files, **array}
    pixels = made.color.plane.samples[0].pixels
    if pixels.dtype.itemsize > 1:
        most = max(float(s.pixels.max()) for s in made.color.plane.samples)
        return {"files": made.color.files, "range": [0, most]}
    return made.color.files


def _depth(made: Arrangement, result: Described) -> dict[str, Any]:
    assert made.depth is not None
    assert made.encoding is not None
    depth: dict[str, Any] = {
        "files": made.depth.files,
        **_array(made.depth),
        **made.encoding.document,
    }
    if made.mask is not None:
        depth["confidence"] = {"files": made.mask.files, "least": 1}
    if made.depth.plane.guess.channel:
        depth["channel"] = made.depth.plane.guess.channel
    result.notes.append(f"depth's encoding is a guess: {made.encoding.name}; see the evidence")
    if "scale_px" in depth:
        numbers = {} if made.camera is None else made.camera.calibration.numbers
        if "baseline_m" not in numbers:
            result.notes.append(
                "no stereo baseline found, which disparity needs: add baseline_m to depth"
            )
        elif not (made.camera and made.camera.calibration.keys):
            depth["baseline_m"] = numbers["baseline_m"]
    if made.camera is None:
        values = depth.get("values")
        needs = f"which {values} needs" if values else "convert assumes a nominal one"
        result.notes.append(f"no camera found, {needs}; add 'camera', or give --intrinsics")
    return {**depth, **_missing(made, made.depth)}


def _missing(made: Arrangement, part: Part) -> dict[str, str]:
    """Return what to do where fewer files are than colour images."""
    fewer = 0 < part.matched < made.color.matched
    return {"missing": "none"} if fewer else {}


def _add_thermal(made: Arrangement, document: dict[str, Any]) -> None:
    if made.color.plane.kind == Kind.COLOUR_AND_THERMAL:
        document["planes"] = {
            "thermal": {"files": made.color.files, "channel": "A", "dtype": "uint8"}
        }
    elif made.thermal is not None:
        dtype = str(made.thermal.plane.samples[0].pixels.dtype)
        if dtype in ("uint8", "int8", "uint16", "int16"):
            channels = made.thermal.plane.samples[0].channels
            which = {} if channels == 1 else {"channel": "R"}
            document["planes"] = {"thermal": {"files": made.thermal.files, "dtype": dtype, **which}}


def _camera(made: Arrangement, root: Path) -> Any:
    assert made.camera is not None
    says = made.camera.calibration
    camera: dict[str, Any] = {"files": made.camera_files}
    if not says.table:
        camera |= camera_form(root / made.camera.template.members[0].path, says)
    else:
        camera["columns"] = [_column(name, made) for name in says.table]
    size = _size_meant(made, says)
    if size is not None:
        camera["for_size"] = list(size)
    return camera if len(camera) > 1 else made.camera_files


def _column(name: str, made: Arrangement) -> str:
    if name in ("fx", "fy", "cx", "cy", "width", "height", "baseline_m"):
        return name
    low = name.lower()
    if low in ("frame", "id", "image", "frame_id", "frameid"):
        return "id"
    return "camera" if low.startswith("cam") and "{camera}" in made.color.files else ""


def _size_meant(made: Arrangement, says: Calibration) -> tuple[int, int] | None:
    """Return the size that camera numbers hold for, where images differ in theirs."""
    sizes = [made.color.plane.samples[0].size]
    if made.depth is not None:
        sizes.append(made.depth.plane.samples[0].size)
    if "width" in says.numbers or len(set(sizes)) == 1:
        return None
    return min(sizes, key=lambda size: abs(size[0] / 2 - says.numbers["cx"]))


def _add_split(
    found: Examination,
    made: Arrangement,
    document: dict[str, Any],
    placeholders: list[str],
    result: Described,
) -> None:
    if "split" in placeholders:
        document["split"] = {"of": "{split}"}
        return
    members = made.color.plane.template.members
    lists = split_lists(found, [_names(made, member) for member in members])
    if lists is None:
        return
    if lists.twice:
        result.notes.append("lists of train, val and test name the same frames: not taken")
        document["split"] = False
        return
    rest = {} if lists.whole else {"rest": "skip"}
    document["split"] = {"lists": lists.files, **rest}
    counts = ", ".join(f"{split} {count}" for split, count in lists.counts.items())
    result.notes.append(f"splits by lists: {counts}")


def _names(made: Arrangement, member: Member) -> tuple[str, ...]:
    """Return what a list may call a frame: its image's name, and what {id} stands for in it."""
    name = made.color.files.rpartition("/")[2]
    if "{id}" not in name or name.count("{") > 1:
        return (member.stem,)
    head, _, tail = name.partition("{id}")
    tail = tail.rpartition(".")[0]
    return member.stem, member.stem[len(head) : len(member.stem) - len(tail)]


def _add_size(made: Arrangement, document: dict[str, Any], result: Described) -> None:
    """Say to which size images are brought, where they differ."""
    parts = [part for part in (made.color, made.depth, made.label) if part is not None]
    sizes = {part.plane.samples[0].size for part in parts}
    if len(sizes) < 2:
        return
    document["size"] = "rgb" if made.depth is None else "depth"
    text = " and ".join(f"{width}x{height}" for width, height in sorted(sizes))
    result.notes.append(
        f"images of {text}: taken for registered, and brought to {document['size']}'s size"
    )
