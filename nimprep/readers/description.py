"""The description of a folder dataset: what is where, in which unit, with which camera."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nimprep.errors import LayoutError
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.readers.patterns import capture
from nimprep.schema import check_json, read_json

MAX_FILES = 1 << 22
"""A dataset's folder with more files is refused: a link led somewhere it should not."""


@dataclass(frozen=True)
class Description:
    """Describe a dataset of one image file per frame and modality.

    Attributes
    ----------
    name : str
        What the store calls the dataset.
    rgb, depth, label : str
        Glob patterns below the dataset's folder with one ``{id}``, which may span folders;
        `label` is None where there are none.
    depth_scale : float
        Metres per raw depth unit.
    depth_invalid : tuple of float
        Raw values that mean "no depth".
    classes : tuple of LabelClass
        What the mapped labels mean.
    label_map : mapping of raw value, or (r, g, b), to class id; None = labels are class ids
    label_default : int, optional
        Class of raw values that the map does not name; None = they are an error.
    camera : str or dict, optional
        A camera file (with ``{id}``: one per frame), or the camera's numbers.
    group : str, optional
        Pattern over ids with one ``{group}``: the scene.
    """

    name: str
    rgb: str
    depth: str
    label: str | None = None
    depth_scale: float = 0.001
    depth_invalid: tuple[float, ...] = (0,)
    classes: tuple[LabelClass, ...] = ()
    label_map: Mapping[int | tuple[int, int, int], int] | None = field(default=None)
    label_default: int | None = None
    camera: str | dict[str, Any] | None = None
    group: str | None = None


def description_from_file(path: Path | str) -> Description:
    """Read a folder description (schemas/folder.schema.json).

    Raises
    ------
    LayoutError
        It is missing, no JSON, or does not fit the schema.
    """
    document = read_json(Path(path), LayoutError)
    check_json(document, "folder", str(path), LayoutError)
    label = document.get("label")
    classes = tuple(
        LabelClass(c["id"], c["name"], (c["color"][0], c["color"][1], c["color"][2]))
        for c in document.get("classes", [])
    )
    known = {c.id for c in classes} | {IGNORE_LABEL}
    label_map = label_default = None
    if label is not None:
        if not classes:
            raise LayoutError(f"{path}: expected 'classes' beside 'label', found none")
        if len(known) != len(classes) + 1:
            raise LayoutError(f"{path}: expected each class id once, found one twice")
        label_default = label.get("default")
        if "map" in label:
            label_map = {_raw_value(key): int(value) for key, value in label["map"].items()}
        for value in [*(label_map or {}).values(), label_default]:
            if value is not None and value not in known:
                raise LayoutError(f"{path}: expected labels mapped to classes, found {value}")
    if document.get("group", "{group}").count("{group}") != 1:
        raise LayoutError(f"{path}: expected one {{group}} in 'group', found several")
    depth = document["depth"]
    return Description(
        name=document["name"],
        rgb=document["rgb"],
        depth=depth["files"],
        label=None if label is None else label["files"],
        depth_scale=float(depth["scale_m"]),
        depth_invalid=tuple(depth.get("invalid", [0])),
        classes=classes,
        label_map=label_map,
        label_default=label_default,
        camera=document.get("camera"),
        group=document.get("group"),
    )


def _raw_value(key: str) -> int | tuple[int, int, int]:
    if key.startswith("#"):
        return int(key[1:3], 16), int(key[3:5], 16), int(key[5:7], 16)
    return int(key)


def files_by_id(root: Path, pattern: str) -> dict[str, Path]:
    """Return {frame id: file} for a pattern with ``{id}``.

    Hidden files and folders are passed over.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, its folder is missing, or two files give one id.
    """
    if pattern.count("{id}") != 1 or pattern.startswith("/") or ".." in pattern.split("/"):
        raise LayoutError(
            f"{root}: expected a pattern below the folder with one {{id}}, found {pattern!r}"
        )
    fixed = re.split(r"[^/]*[*?{]", pattern, maxsplit=1)[0]
    start = root / fixed
    # Path.is_dir raises where a name is too long for any file.
    if not os.path.isdir(start):  # noqa: PTH112
        raise LayoutError(f"{start}: expected a folder with files {pattern!r}, found none")
    found: dict[str, Path] = {}
    for path in _files_below(start, root):
        frame_id = capture(pattern, path.relative_to(root).as_posix(), "id")
        if frame_id is None:
            continue
        if not frame_id.isprintable():
            raise LayoutError(f"{path!a}: expected a printable file name, found another")
        if frame_id in found:
            raise LayoutError(
                f"{path}: expected one file per id {frame_id!r}, found "
                f"{found[frame_id]} too; put more of the path into {{id}}"
            )
        found[frame_id] = path
    return found


def _files_below(start: Path, root: Path) -> Iterator[Path]:
    """Yield files in order, each folder once; hidden ones are passed over.

    Links are followed, as datasets are often spread over disks, and only ever read through: to
    files wherever they are, to folders too unless they lead to the dataset's own folder or one
    above it. Such a link would bring in the whole disk, the dataset again included.
    """

    def refuse(error: OSError) -> None:
        raise LayoutError(
            f"{error.filename}: expected a readable folder, found {error.strerror}"
        ) from error

    seen: set[str] = set()
    count, home = 0, Path(os.path.realpath(root))
    for folder, subfolders, names in os.walk(start, onerror=refuse, followlinks=True):
        real = os.path.realpath(folder)
        if real in seen:
            subfolders.clear()
            continue
        if home.is_relative_to(real) and Path(folder) != root:
            raise LayoutError(
                f"{folder}: expected a link into the dataset or away from it, found one to {real}, "
                "which holds the dataset; remove the link"
            )
        seen.add(real)
        count += len(names) + 1
        if count > MAX_FILES:
            raise LayoutError(f"{start}: expected at most {MAX_FILES} files, found more")
        subfolders[:] = sorted(s for s in subfolders if not s.startswith("."))
        for name in sorted(n for n in names if not n.startswith(".")):
            path = Path(folder, name)
            # A pipe or a device would wait for ever; a link to nothing is an error when read.
            if path.is_file() or not path.exists():
                yield path


def group_of(frame_id: str, pattern: str | None) -> str:
    """Return the scene in a frame id by a pattern with ``{group}``; "" where it does not fit."""
    return "" if pattern is None else capture(pattern, frame_id, "group", lazy=True) or ""
