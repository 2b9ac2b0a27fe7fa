"""ScanNet: its own 16-bit labels by its table, and splits by its lists of scenes."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from nimprep.errors import LayoutError
from nimprep.files import read_file
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.images import read_header
from nimprep.readers.base import Reader
from nimprep.readers.description import Description, LabelSource, SplitSource
from nimprep.readers.folder import FolderReader
from nimprep.readers.label_map import with_map
from nimprep.readers.signs import Listings, probed
from nimprep.splits import SplitName

TABLE = "scannetv2-labels.combined.tsv"
"""What ScanNet's ids are among NYU's 40 classes, by the columns id and nyu40id."""

LISTS: dict[SplitName, str] = {
    "train": "scannetv2_train.txt",
    "val": "scannetv2_val.txt",
    "test": "scannetv2_test.txt",
}
"""Lists of scenes."""

_BESIDE = (".", "..", "../..")
_MOST_BYTES = 1 << 24


def open_scannet(root: Path, description: Description, **options: Any) -> Reader:
    """Open a folder of scenes.

    Parameters are those of `FolderReader`.

    Raises
    ------
    LayoutError
        Its table of labels is none, or a scene is in the lists of two splits.
    """
    description = _with_splits(root, _with_size(root, description))
    label = description.label
    if label is not None and options.get("labels", True) and not options.get("label_map"):
        description = _with_labels(root, description, label)
    return FolderReader(root, description, **options)


def _beside(root: Path, name: str) -> Path | None:
    return next((p for each in _BESIDE if (p := root / each / name).is_file()), None)


def _text(path: Path) -> str:
    return read_file(path, _MOST_BYTES, "a readable text", LayoutError).decode("utf-8-sig")


def _with_size(root: Path, description: Description) -> Description:
    """Return the description with the size that depth's camera holds for, if it is all there is."""
    camera, depth = description.camera, description.depth
    if description.size is None or camera is None or depth is None:
        return description
    found = Listings().find(root, probed(depth.files))
    if found is None:
        return description
    header = read_header(Path(found))
    return replace(description, camera=replace(camera, for_size=(header.width, header.height)))


def _with_splits(root: Path, description: Description) -> Description:
    """Return the description with the splits of ScanNet's lists of scenes, where they are."""
    scenes: dict[str, SplitName] = {}
    for split, name in LISTS.items():
        path = _beside(root, name)
        for scene in _text(path).split() if path is not None else ():
            if scenes.setdefault(scene, split) != split:
                raise LayoutError(
                    f"{path}: expected each scene in one split, found {scene!r} in "
                    f"{scenes[scene]} too; take it out of one list"
                )
    if not scenes:
        note = f"ScanNet's lists of scenes ({LISTS['train']}) are not there: frames are split anew"
        return replace(description, notes=(*description.notes, note))
    there = (p.name for p in root.iterdir() if p.is_dir() and p.name.startswith("scene"))
    names: dict[str, SplitName | Literal["skip"]] = {s: scenes.get(s, "skip") for s in there}
    return replace(
        description, no_split=False, split=SplitSource(of="scene{space}_{scan}", names=names)
    )


def _with_labels(root: Path, description: Description, label: LabelSource) -> Description:
    """Return the description with what the 16-bit ids of the exported scenes are."""
    if description.name == "scannet-25k":
        # Its labels are NYU's classes already.
        return description
    path = _beside(root, TABLE)
    where = f"{root}: {TABLE}"
    if path is None:
        note = (
            f"no {TABLE} beside the scenes: labels are ScanNet's own ids, those above 254 ignored; "
            "put it there to have NYU's 40 classes"
        )
        values = range(1, IGNORE_LABEL)
        classes = tuple(LabelClass(v, f"id {v}", (v * 67 % 256, v * 149 % 256, v)) for v in values)
        mapped = with_map(replace(label, ranges=None), {str(v): v for v in values}, classes, where)
        mapped = replace(mapped, default=IGNORE_LABEL)
        notes = (*description.notes, note)
        return replace(description, label=mapped, classes=classes, notes=notes)
    named = {str(raw): _class_of(label, nyu) for raw, nyu in _table(path).items()}
    mapped = with_map(label, {"0": IGNORE_LABEL, **named}, description.classes, where)
    return replace(description, label=mapped)


def _class_of(label: LabelSource, nyu: int) -> int:
    """Return the class that a description's map has for an id of NYU's 40; 255 = none."""
    known = (of for first, last, of in label.ranges or () if first <= nyu <= last)
    return next(known, IGNORE_LABEL)


def _table(path: Path) -> dict[int, int]:
    """Return NYU's id by ScanNet's."""
    found: dict[int, int] = {}
    for row in csv.DictReader(_text(path).splitlines(), delimiter="\t"):
        raw, nyu = row.get("id") or "", row.get("nyu40id") or ""
        if not (raw.isdecimal() and nyu.isdecimal()):
            raise LayoutError(
                f"{path}: expected columns id and nyu40id of whole numbers, found {raw!r} and "
                f"{nyu!r}; take ScanNet's own file"
            )
        found[int(raw)] = int(nyu)
    return found
