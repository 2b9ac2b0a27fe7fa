"""TartanGround and TartanAir V2: each environment says in a file of its own what its labels are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from nimprep.errors import LayoutError
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.readers.base import Reader
from nimprep.readers.description import Description
from nimprep.readers.folder import FolderReader
from nimprep.readers.label_map import with_map
from nimprep.schema import read_json

NAMES = "seg_label_map.json"
"""The file of an environment that names the numbers of its label images."""


def open_tartanground(root: Path, description: Description, **options: Any) -> Reader:
    """Open a folder of environments; labels are the numbers of their images, 255 where unnamed.

    Parameters are those of `FolderReader`.

    Raises
    ------
    LayoutError
        Two environments name their numbers differently: one store cannot hold both.
    """
    label = description.label
    if label is None or not options.get("labels", True) or options.get("label_map"):
        return FolderReader(root, description, **options)
    names, note = _names(root)
    classes = tuple(LabelClass(value, name, _color(value)) for value, name in names.items())
    mapped = with_map(label, {str(v): v for v in names}, classes, f"{root}: {NAMES}")
    described = replace(
        description,
        label=replace(mapped, default=IGNORE_LABEL),
        classes=classes,
        notes=(*description.notes, *note),
    )
    return FolderReader(root, described, **options)


def _names(root: Path) -> tuple[dict[int, str], tuple[str, ...]]:
    """Return what labels' numbers are called, and what is to be said of that."""
    known: dict[Path, dict[int, str]] = {}
    for path in sorted(root.glob(f"*/{NAMES}")):
        if any(path.parent.glob("Data_*/P*/seg_*")):
            known[path] = _read(path)
    if not known:
        note = f"no {NAMES} in any environment: what the numbers of labels mean is not known"
        return {value: f"number {value}" for value in range(IGNORE_LABEL)}, (note,)
    first, names = next(iter(known.items()))
    for path, other in known.items():
        if other != names:
            raise LayoutError(
                f"{path}: expected the same names of labels as {first.parent.name}, found others, "
                "as each environment counts anew; convert one environment at a time, or use "
                "--no-labels"
            )
    return names, ()


def _read(path: Path) -> dict[int, str]:
    """Return the names in a file, several of one number joined."""
    document = read_json(path, LayoutError)
    found = document.get("name_map") if isinstance(document, Mapping) else None
    if not isinstance(found, Mapping) or not all(type(n) is int for n in found.values()):
        raise LayoutError(
            f"{path}: expected an object name_map of names and numbers, found "
            f"{str(document)[:80]!r}; unpack the environment's seg_labels again"
        )
    names: dict[int, list[str]] = {}
    for name, value in sorted(found.items()):
        if 0 <= value < IGNORE_LABEL:
            names.setdefault(value, []).append(str(name))
    return {value: ", ".join(each) for value, each in sorted(names.items())}


def _color(value: int) -> tuple[int, int, int]:
    """Return a colour that no other number up to 254 has."""
    return (value * 67 % 256, value * 149 % 256, value)
