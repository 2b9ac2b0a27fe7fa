"""Opening a dataset known by name: its description, with what the folder and the options change."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from inspect import signature
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from nimprep.errors import LayoutError, OptionError
from nimprep.readers.base import Reader
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.datasets import FLAGS, Dataset, merged
from nimprep.readers.description import Description, DistortionRule, Size
from nimprep.readers.description_file import description_from_document
from nimprep.readers.folder import FolderReader
from nimprep.readers.layouts import READERS
from nimprep.readers.recognition import place_of, refusal
from nimprep.readers.signs import Listings, probed
from nimprep.readers.tree import check_root


def open_named(
    root: Path | str,
    *,
    dataset: Dataset,
    labels: bool = True,
    camera: GivenCamera | None = None,
    depth_scale: float | None = None,
    label_map: str | None = None,
    distortion: DistortionRule | None = None,
    size: Size | None = None,
    label_set: str | None = None,
    variations: Sequence[str] | None = None,
    camera_index: int | None = None,
    lists: Path | str | None = None,
    official: bool = True,
    depth: bool = True,
    gravity: Sequence[float] | None = None,
) -> Reader:
    """Open a folder of a dataset that is known by name.

    Parameters
    ----------
    dataset : Dataset
        What its file says.
    label_set : str, optional
        Which of its label sets.
    variations : sequence of str, optional
        Of its scenes; None = the usual ones.
    camera_index : int, optional
        Which of its cameras; None = the usual ones.
    lists : path, optional
        File, or folder, of its lists of splits.

    Others are those of `FolderReader`.

    Raises
    ------
    LayoutError
        Files of a kind are not there at all; it is said what they come in.
    OptionError
        An option is given that this form of the dataset has not, or a label set that is none.
    """
    root = Path(root)
    check_root(root)
    listings = Listings()
    if (told := refusal(root, listings, dataset.name)) is not None:
        raise LayoutError(told)
    found = dataset.found(root, listings)
    chosen = {"variations": variations, "camera_index": camera_index}
    document = described(found, label_set, chosen, lists=lists is not None)
    description = description_from_document(document, f"{found.name}.json")
    description = replace(description, notes=tuple(_default_notes(found, chosen)))
    if not labels:
        description = replace(description, label=None, classes=())
    if not depth and "depth" not in (description.size,):
        description = replace(description, depth=None)
    description = _without_labels_of_test(root, description, listings)
    _check_unpacked(root, description, found, listings, given=camera is not None)
    description = _with_lists(root, description, found, lists, listings)
    keywords: dict[str, Any] = {
        "labels": labels,
        "camera": camera,
        "depth_scale": depth_scale,
        "label_map": label_map,
        "distortion": distortion,
        "size": size,
        "official": official,
        "depth": depth,
        "gravity": gravity,
    }
    return _opened(
        root, description, found, keywords, {**chosen, "label_set": label_set, "lists": lists}
    )


def _opened(
    root: Path,
    description: Description,
    dataset: Dataset,
    keywords: Mapping[str, Any],
    own: Mapping[str, Any],
) -> Reader:
    """Return the reader: of any folder, or the dataset's code, with what of `own` that takes."""
    if "code" not in dataset.document:
        return FolderReader(root, description, **keywords)
    opened = resolve_name(dataset.document["code"])
    taken = {name: own[name] for name in own if name in signature(opened).parameters}
    reader: Reader = opened(root, description, **keywords, **taken)
    return reader


def described(
    dataset: Dataset,
    label_set: str | None = None,
    chosen: Mapping[str, Any] | None = None,
    *,
    lists: bool = False,
) -> dict[str, Any]:
    """Return a dataset's description (schemas/folder.schema.json), as options have it.

    Parameters
    ----------
    dataset : Dataset
        As it is in a folder: see `Dataset.found`.
    label_set : str, optional
    chosen : mapping of option to what it chooses, optional
        Of ``variations`` and ``camera_index``; None = the usual ones.
    lists : bool
        Whether lists of splits are given.

    Raises
    ------
    OptionError
        This form of the dataset has not an option, or a label set of that name.
    """
    chosen = chosen or {}
    given = {"label_set": label_set, "lists": lists or None, **chosen}
    for name in (n for n, value in given.items() if value is not None):
        if name not in dataset.options:
            raise OptionError(
                f"{FLAGS[name]}: expected none with this form of {dataset.name} "
                f"({dataset.document['description']['name']}), found one; leave it out"
            )
    if label_set is not None and label_set not in dataset.options["label_set"]["choices"]:
        known = " or ".join(dataset.options["label_set"]["choices"])
        raise OptionError(
            f"--labels: expected {known} with the reader {dataset.name}, found {label_set!r}; "
            "choose one"
        )
    document = merged(dataset.document["description"], dataset.choice(label_set))
    only = {
        said["placeholder"]: values
        for name, said in dataset.options.items()
        if "placeholder" in said and (values := _values(chosen.get(name), said)) is not None
    }
    return {**document, **({"only": only} if only else {})}


def description_in(dataset: Dataset, root: Path, place: Path) -> dict[str, Any]:
    """Return a dataset's description as one for a folder that it lies in, to be written and edited.

    Parameters
    ----------
    root : Path
        The folder.
    place : Path
        In which the dataset lies: it, or one within it.
    """
    listings = Listings()
    # A copy: it is to be edited, and the dataset's own is not.
    document = deepcopy(described(dataset.found(place, listings)))
    split = document.get("split")
    if "lists" in dataset.options and isinstance(split, dict) and "lists" in split:
        there = {n: f for n, f in split["lists"].items() if listings.find(place, f) is not None}
        document["split"] = {**split, "lists": there} if there else False
    inner = place.relative_to(root).as_posix()
    return document if inner == "." else {k: _below(inner, k, v) for k, v in document.items()}


_PATTERNS = frozenset({"rgb", "camera", "files", "pairs"})
"""Keys of a description whose value, where it is text, is a pattern."""


def _below(inner: str, key: str, value: Any) -> Any:
    """Return what a description says, its patterns being below a folder within."""
    if isinstance(value, Mapping):
        lists = key == "lists"
        return {k: _below(inner, "files" if lists else k, v) for k, v in value.items()}
    return f"{inner}/{value}" if key in _PATTERNS and isinstance(value, str) else value


def _default_notes(dataset: Dataset, chosen: Mapping[str, Any]) -> Iterator[str]:
    """Yield what is said of frames that are left out though nobody asked for that."""
    for name, said in dataset.options.items():
        if "default" in said and "placeholder" in said and chosen.get(name) is None:
            values = ", ".join(said["default"])
            yield f"frames of {said['placeholder']} {values} alone; {FLAGS[name]} takes others"


def _values(chosen: Any, said: Mapping[str, Any]) -> list[str] | None:
    if chosen is None:
        return said.get("default")
    return [str(chosen)] if isinstance(chosen, (int, str)) else [str(each) for each in chosen]


def _without_labels_of_test(
    root: Path, description: Description, listings: Listings
) -> Description:
    """Return the description without labels where all there is are frames of a test without any."""
    label, split = description.label, description.split
    if label is None or split is None or split.of is None or not split.names:
        return description
    if listings.find(root, probed(label.files)) is not None or listings.cut:
        return description
    others = [called for called, name in split.names.items() if name != "test"]
    if any(listings.find(root, description.rgb.files.replace(split.of, c)) for c in others):
        return description
    note = "no labels: all frames are of the test split, and it has none here"
    notes = (*description.notes, note)
    return replace(description, label=None, classes=(), notes=notes)


_WAYS = {
    "depth": ", or leave depth out with --modalities rgb,label",
    "label": ", or use --no-labels",
    "camera": ", or give --camera",
    "colors": ", or use --no-labels",
}
"""What else can be done where there is no file of a kind."""


def _check_unpacked(
    root: Path, description: Description, dataset: Dataset, listings: Listings, *, given: bool
) -> None:
    """Raise `LayoutError` where there is no file of a kind: its archive was not unpacked, say."""
    wanted = {n: s.files for n, s in description.sources() if s.missing != "none"}
    if description.camera is not None and description.camera.files and not given:
        wanted["camera"] = description.camera.files
    if description.depth is not None and description.depth.to_camera is not None:
        wanted["to_camera"] = description.depth.to_camera.files
    if description.label is not None and description.label.names:
        wanted["colors"] = description.label.names
    for name, pattern in wanted.items():
        if listings.find(root, probed(pattern)) is not None or listings.cut:
            continue
        comes = dataset.document.get("unpack", {}).get(name)
        step = f"unpack {comes} there" if comes else "compare the names there with it"
        outer = _outer(root, dataset.name, name, listings)
        if outer is not None:
            raise LayoutError(
                f"{root}: expected {name} files of {dataset.name} like {pattern!r}, found them not "
                f"there but in {outer}; did you mean {outer}?"
            )
        raise LayoutError(
            f"{root}: expected {name} files of {dataset.name} like {pattern!r}, found none; "
            f"{step}{_WAYS.get(name, '')}"
        )


def _outer(root: Path, name: str, kind: str, listings: Listings) -> Path | None:
    """Return the folder above that is the dataset and has files of a kind; None = there is none."""
    layout = READERS[name]
    for folder in Path(os.path.abspath(root)).parents[:2]:  # noqa: PTH100 - "." has no parents
        if layout.dataset is None or place_of(layout, folder, listings) is None:
            continue
        pattern = layout.dataset.found(folder, listings).pattern(kind)
        if pattern is not None and listings.find(folder, probed(pattern)) is not None:
            return folder
    return None


def _with_lists(
    root: Path,
    description: Description,
    dataset: Dataset,
    given: Path | str | None,
    listings: Listings,
) -> Description:
    """Return the description with where its lists of splits are, which may be elsewhere.

    Raises
    ------
    LayoutError
        None is where they were said to be.
    """
    split, said = description.split, dataset.options.get("lists")
    if said is None or split is None:
        return description
    folders = [root / each for each in said["beside"]]
    if given is not None:
        # One of the lists stands for its folder, in which the others are.
        folders = [Path(given).parent if Path(given).is_file() else Path(given)]
    for folder in folders:
        there = {n: f for n, f in split.lists.items() if listings.find(folder, f) is not None}
        if there:
            found = replace(split, lists=there, folder=folder)
            return replace(description, split=found)
    if given is not None:
        named = ", ".join(split.lists.values())
        raise LayoutError(
            f"{given}: expected the folder of {dataset.name}'s lists ({named}), found none of "
            "them; leave out --lists to split anew"
        )
    note = (
        f"the official lists of its split ({', '.join(split.lists.values())}) are not there: "
        "frames are split anew; --lists says where they are"
    )
    return replace(description, split=None, no_split=True, notes=(*description.notes, note))
