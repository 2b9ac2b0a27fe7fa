"""NYU Depth V2's labelled set as its authors have it: one file, with splits and classes beside.

nyu_depth_v2_labeled.mat holds every frame and the scene of each; splits.mat, which says whose
frames are train and test, and classMapping40.mat, which makes 40 classes of 894, lie beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from nimprep.errors import LayoutError
from nimprep.images import hdf5_cell_count, read_header
from nimprep.readers.description import Description, LabelSource, SplitSource
from nimprep.readers.folder import FolderReader
from nimprep.readers.label_map import with_map
from nimprep.readers.matlab import matlab_variable, numbers_of, texts_of
from nimprep.splits import SplitName

SPLITS = "splits.mat"
CLASSES = "classMapping40.mat"

_SPLITS: Mapping[SplitName, str] = {"train": "trainNdxs", "test": "testNdxs"}


def open_nyuv2(
    root: Path,
    description: Description,
    *,
    lists: Path | str | None = None,
    **keywords: Any,
) -> FolderReader:
    """Open nyu_depth_v2_labeled.mat with what lies beside it.

    Parameters
    ----------
    description : Description
        With labels of the 40 classes.
    lists : path, optional
        splits.mat, or the folder that it is in; None = beside the file.

    Others are those of `FolderReader`.

    Raises
    ------
    LayoutError
        splits.mat is not where `lists` says, or is of another set of frames.
    DecodeError
        A file is damaged, or not what it is called.
    """
    frames = read_header(root / description.rgb.files, description.rgb.layout).frames or 0
    if keywords.get("labels", True) and keywords.get("label_map") is None:
        description = _with_classes(root, description)
    description = _with_splits(root, description, frames, lists)
    groups = _scenes(root / description.rgb.files, frames)
    return FolderReader(root, replace(description, groups=groups), **keywords)


def _id(number: int) -> str:
    return f"{number:06d}"


def _with_classes(root: Path, description: Description) -> Description:
    """Return the description with what the 894 values are of the 40 classes; or without labels."""
    label, path = description.label, root / CLASSES
    if label is None:
        return description
    if not path.is_file():
        note = (
            f"no labels: the file has 894 classes, and {CLASSES}, which makes 40 of them, is not "
            "beside it"
        )
        return replace(description, label=None, classes=(), notes=(*description.notes, note))
    of_40 = {value: made for first, last, made in label.ranges or () for value in (first, last)}
    mapped = numbers_of(matlab_variable(path, "mapClass"), path, "mapClass")
    if not mapped or not set(mapped) <= of_40.keys():
        raise LayoutError(
            f"{path}: expected classes 1 to 40 as 'mapClass', found {sorted(set(mapped))[:5]} and "
            "so on; give the file as it was published"
        )
    named = {"0": of_40[0], **{str(n): of_40[value] for n, value in enumerate(mapped, 1)}}
    plain = LabelSource(files=label.files, key=label.key, axes=label.axes)
    return replace(description, label=with_map(plain, named, description.classes, str(path)))


def _with_splits(
    root: Path, description: Description, frames: int, lists: Path | str | None
) -> Description:
    """Return the description with the authors' split; or free, and that is said."""
    path = root / SPLITS if lists is None else Path(lists)
    path = path / SPLITS if path.is_dir() else path
    if not path.is_file():
        if lists is not None:
            raise LayoutError(
                f"{path}: expected the official split {SPLITS}, found none; leave out --lists to "
                "split anew"
            )
        note = (
            f"the official split (795 train, 654 test) is not known, as {SPLITS} is not beside the "
            "file: frames are split anew; --lists says where it is"
        )
        return replace(description, no_split=True, notes=(*description.notes, note))
    found: dict[str, SplitName] = {}
    for split, name in _SPLITS.items():
        numbers = numbers_of(matlab_variable(path, name), path, name)
        _check_numbers(numbers, frames, path, name)
        for number in numbers:
            if found.setdefault(_id(number - 1), split) != split:
                raise LayoutError(
                    f"{path}: expected each frame in one split, found {number} in both; give the "
                    "file as it was published"
                )
    return replace(description, split=SplitSource(frames=found))


def _check_numbers(numbers: Sequence[int], frames: int, path: Path, name: str) -> None:
    """Raise `LayoutError` where numbers, counted from 1, are of frames that are not there."""
    wrong = [number for number in numbers if not 1 <= number <= frames]
    if wrong:
        raise LayoutError(
            f"{path}: expected numbers of frames from 1 to {frames} as {name!r}, found {wrong[0]}; "
            "give the split of this file"
        )


def _scenes(path: Path, frames: int) -> dict[str, str] | None:
    """Return the scene of each frame; None = the file does not say it."""
    if hdf5_cell_count(path, "scenes") != frames:
        return None
    scenes = texts_of(matlab_variable(path, "scenes"), path, "scenes")
    return {_id(number): scene for number, scene in enumerate(scenes)}
