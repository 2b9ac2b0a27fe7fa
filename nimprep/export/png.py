"""Frames as PNGs in GMRP's raw layout, and what else `convert` needs to get the store back::

OUT/
  rgb/000001.png         8-bit colour
  depth_u16/000001.png   16-bit, millimetres; 0 = no depth (depth/ where a store has another unit)
  label/000001.png       8-bit class ids; 255 = ignore
  thermal/000001.png     and other planes of the dataset's own, as the description says
  camera.json            of all frames, or camera/000001.json ... where they differ
  description.json       the folder as `convert --description` reads it: classes, cameras, scenes
  split.json             as `convert --split-file` reads it

Modalities that are asked for by name stand in folders of their names (``hha/000001.png``,
``normal/000001.png``), encoded as `nimprep.export.encoding` says and ``encodings.json`` repeats.

The cameras hold the transform to the road where a frame has one, so that what is derived from the
folder is what the store has, the direction of gravity too. How it was derived is for the options of
`convert`, which are the same again where the store was made by its defaults. Planes of negative
integers that have one for none are left out, which is said, unless they are asked for by name.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from nimprep.depth_unit import MILLIMETRE, unit_words
from nimprep.derive.recipe import Recipe, recipe_from
from nimprep.errors import StoreError
from nimprep.export.encoding import FILE, describe_encoding, encode_image, folder_of
from nimprep.export.places import write_new
from nimprep.kitti.images import png_bytes
from nimprep.modality import Modality
from nimprep.plane import definition_of
from nimprep.readers.matching import group_of
from nimprep.schema import json_bytes
from nimprep.splits import split_document
from nimprep.store.reader import Store

RAW = ("rgb", "depth", "label")
"""What GMRP ships; what is derived from these, convert makes again."""

OPTIONAL = frozenset({"depth"})
"""What a dataset may lack of single frames, which the store then holds as no value throughout."""

GROUP_PATTERNS = (
    "{group}/*",
    "{group}/**",
    "*/{group}/*",
    "*/{group}/**",
    "*/*/{group}/**",
    "**/{group}_*",
    "**/{group}-*",
)
"""Patterns over ids that are tried to say the scenes, which a description cannot list."""


def write_frame(
    store: Store, index: int, folder: Path, file: PurePosixPath, modalities: Sequence[str]
) -> set[str]:
    """Write a frame's images, each at the frame's own size, numbers as the store has them.

    Depth of which no pixel has any is not written: the dataset had none of the frame, and a file
    of it would be a damaged one. Returned is what was left out.
    """
    height, width = store.camera(index).shape
    blank = set()
    for name in modalities:
        image, modality = store.arrays[name].read(index)[:height, :width], store.modality(name)
        if name in OPTIONAL and not image.any():
            blank.add(name)
            continue
        encoded = encode_image(image, modality)
        write_new(folder / folder_of(modality) / file, png_bytes(np.ascontiguousarray(encoded)))
    return blank


def raw_modalities(store: Store) -> list[str]:
    """Return what of the layout's own the store has.

    Raises
    ------
    StoreError
        It has nothing of it.
    """
    there = [name for name in RAW if name in store.arrays]
    if not there:
        raise StoreError(
            f"{store.path}: expected one of {', '.join(RAW)} for --format png, "
            f"found {', '.join(store.modalities)}; name what to write with --modalities"
        )
    planes = [store.modality(p.name) for p in store.planes if p.name in store.arrays]
    if left := [plane.name for plane in planes if not _is_describable(plane)]:
        warnings.warn(
            f"{store.path}: {', '.join(left)}: a description has no words for PNGs of negative "
            "integers and none, so they are left out; name them with --modalities, or use "
            "--format npz",
            stacklevel=2,
        )
    for name in there:
        _say_how_it_comes_back(store, store.modality(name))
    return there + [plane.name for plane in planes if _is_describable(plane)]


def _say_how_it_comes_back(store: Store, modality: Modality) -> None:
    """Warn where `convert` would not take up by itself the unit that a store has."""
    if modality.has_other_unit and modality.step < MILLIMETRE:
        warnings.warn(
            f"{store.path}: depth in {unit_words(modality.step)}: to get all of it back, convert "
            f"the folder with --depth-unit {modality.step:.10g}",
            stacklevel=2,
        )


def _is_describable(plane: Modality) -> bool:
    """Return whether a description can say what the PNGs of a plane hold."""
    return np.dtype(plane.dtype).kind == "u" or not plane.has_none


def _plane_entry(plane: Modality) -> dict[str, Any]:
    """Return what a description says of a plane's PNGs, whose integers are moved up from 0."""
    entry = {"files": f"{plane.name}/{{id}}.png", **definition_of(plane)}
    if least := int(np.iinfo(plane.dtype).min):
        offset = plane.offset + least * plane.scale
        entry |= {"source_scale": plane.scale, "source_offset": offset}
    return entry


def write_encodings(store: Store, folder: Path, modalities: Sequence[str]) -> None:
    """Write how each folder's numbers are to be read."""
    entries = {name: describe_encoding(store.modality(name)) for name in modalities}
    document = {"format": "nimprep-encodings", "version": "1.0", "modalities": entries}
    write_new(folder / FILE, json_bytes(document))


def write_records(
    store: Store,
    numbers: Sequence[int],
    folder: Path,
    modalities: Sequence[str],
    blank: Collection[str] = (),
) -> None:
    """Write the cameras, the splits and the description.

    Parameters
    ----------
    blank : collection of str
        Modalities of which some frame has no file.
    """
    cameras = {store.ids[i]: camera_document(store, i) for i in numbers}
    shared = shared_camera(list(cameras.values()))
    if shared is not None:
        pattern = "camera.json"
        write_new(folder / pattern, json_bytes(shared))
    else:
        pattern = "camera/{id}.json"
        for frame_id, camera in cameras.items():
            write_new(folder / "camera" / f"{frame_id}.json", json_bytes(camera))
    splits = {i: split for i, split in store.splits.items() if i in cameras}
    write_new(folder / "split.json", json_bytes(split_document(splits)))
    if {"rgb", "depth"} <= set(modalities):
        description = describe(store, numbers, pattern, modalities, blank)
        write_new(folder / "description.json", json_bytes(description))


def camera_document(store: Store, index: int) -> dict[str, Any]:
    """Return a frame's camera (schemas/camera.schema.json), and where it came from."""
    baseline_m, transform = float(store.tables.baseline[index]), store.cam_to_road(index)
    gravity = store.given_gravity(index)
    return {
        **store.camera(index).to_dict(),
        **({} if math.isnan(baseline_m) else {"baseline_m": baseline_m}),
        **({} if transform is None else {"cam_to_road": transform.tolist()}),
        **({} if gravity is None else {"gravity": gravity.tolist()}),
        # No part of a camera, but a nominal one should not pass for a calibration.
        "origin": store.about.calibration["origin"],
    }


def shared_camera(cameras: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the one camera of all frames, without its size where they have several; or None."""
    for left_out in ((), ("width", "height")):
        kept = [{k: v for k, v in camera.items() if k not in left_out} for camera in cameras]
        if all(camera == kept[0] for camera in kept):
            return kept[0]
    return None


def describe(
    store: Store,
    numbers: Sequence[int],
    camera: str,
    modalities: Sequence[str],
    blank: Collection[str] = (),
) -> dict[str, Any]:
    """Return the description of the exported folder (schemas/folder.schema.json)."""
    depth = describe_encoding(store.modality("depth"))
    document: dict[str, Any] = {
        "format": "nimprep-folder",
        "version": "1.0",
        "name": store.about.dataset,
        "rgb": "rgb/{id}.png",
        "depth": {"files": depth["files"], "scale_m": depth["scale"]},
        "camera": camera,
    }
    planes = [plane for plane in store.planes if plane.name in modalities]
    if entries := {plane.name: _plane_entry(plane) for plane in planes if _is_describable(plane)}:
        document |= {"version": "1.1", "planes": entries}
    if "label" in modalities and store.classes:
        document["label"] = {"files": "label/{id}.png"}
        document["classes"] = [
            {"id": c.id, "name": c.name, "color": list(c.color)} for c in store.classes
        ]
    if "depth" in blank:
        document["depth"]["missing"] = "none"
        document["version"] = "1.1"
    made = store.attributes["modalities"]
    if "hha" in made and recipe_from(made).ground != Recipe().ground:
        document |= {"version": "1.1", "hha_ground": recipe_from(made).ground}
    return document | _belongings(store, {store.ids[i]: store.tables.group[i] for i in numbers})


def _belongings(store: Store, groups: dict[str, str]) -> dict[str, Any]:
    """Return the scenes' pattern and whose dataset it is; warn of what cannot be said there."""
    found: dict[str, Any] = {}
    if pattern := group_pattern(groups):
        found["group"] = pattern
    elif any(groups.values()):
        warnings.warn(
            f"{store.path}: the scenes are no part of the frames' ids, so that no description can "
            "say them: they are left out",
            stacklevel=2,
        )
    references = store.about.references
    if len(references) == 1:
        found |= {"version": "1.1", "reference": references[0]}
    elif references:
        warnings.warn(
            f"{store.path}: a description says whose one dataset is, and these are "
            f"{len(references)}: nimprep info {store.path} has their licences",
            stacklevel=2,
        )
    return found


def group_pattern(groups: dict[str, str]) -> str | None:
    """Return a pattern that gives each id its scene; None where none does, or there is none."""
    if not any(groups.values()):
        return None
    for pattern in GROUP_PATTERNS:
        if all(group_of(frame_id, pattern) == group for frame_id, group in groups.items()):
            return pattern
    return None
