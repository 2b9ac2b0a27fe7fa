"""SUN RGB-D: folders of images, with the labels and the split of its toolbox where they are there.

SUNRGBD2Dseg.mat has the labels of all frames, by number; SUNRGBDMeta.mat says which frame a number
is, and allsplit.mat whose frames are train and test.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import Frame, LabelClass
from nimprep.images import hdf5_cell_count, read_hdf5_cell
from nimprep.modality import MODALITIES
from nimprep.readers.base import Reader, WrappedReader
from nimprep.readers.description import Description, LabelSource, SplitSource
from nimprep.readers.folder import FolderReader
from nimprep.readers.label_map import map_from_text, with_map
from nimprep.readers.label_values import label_of_values
from nimprep.readers.matlab import matlab_variable, texts_of
from nimprep.readers.split_lists import FrameNames
from nimprep.splits import SplitName

LABELS = "SUNRGBD2Dseg.mat"
FRAMES = "SUNRGBDMeta.mat"
SPLIT = "allsplit.mat"

_CELLS = "SUNRGBD2Dseg/seglabel"
_PARTS = ("", "Metadata", "traintestSUNRGBD", "traintestsplit")
_SPLITS: Mapping[SplitName, str] = {"train": "alltrain", "test": "alltest"}


def open_sunrgbd(
    root: Path,
    description: Description,
    *,
    lists: Path | str | None = None,
    **keywords: Any,
) -> Reader:
    """Open SUN RGB-D.

    Parameters
    ----------
    description : Description
        With labels of the 37 classes.
    lists : path, optional
        allsplit.mat, or the folder that it is in; None = in SUNRGBDtoolbox in or beside the folder.

    Others are those of `FolderReader`.

    Raises
    ------
    LayoutError
        A file of the toolbox is not where it is said to be, or not what it is called.
    DecodeError
        One is damaged.
    """
    label, classes = description.label, description.classes
    text = keywords.pop("label_map", None)
    if label is not None and text is not None:
        named = map_from_text(text)
        label = with_map(LabelSource(files=label.files), named, classes, "--label-map")
    wanted = label is not None and keywords.get("labels", True)
    description = replace(description, label=None, classes=())
    path = _found(root, LABELS) if wanted else None
    if wanted and path is None:
        note = f"no labels: {LABELS} of SUNRGBDtoolbox.zip is neither in nor beside the folder"
        description = replace(description, notes=(*description.notes, note))
    # The toolbox names frames by their folders, which are not known before they are looked for.
    ids = FolderReader(root, replace(description, no_split=True), **keywords).ids
    names = FrameNames(dict.fromkeys(ids, ()))
    described = _with_split(description, _split(root, lists, names))
    reader: Reader = FolderReader(root, described, **keywords)
    if path is None or label is None:
        return reader
    return _Labelled(reader, path, _numbers(path, names), label, classes)


_BOXES = ("", "SUNRGBDtoolbox", "SUNRGBDtoolbox/SUNRGBDtoolbox")


def _found(root: Path, name: str) -> Path | None:
    """Return a file of the toolbox, in the dataset's folder or beside it; None = there is none."""
    for outer in (root, root.parent):
        for inner in (f"{box}/{part}".strip("/") for box in _BOXES for part in _PARTS):
            if (outer / inner / name).is_file():
                return outer / inner / name
    return None


def _frame(names: FrameNames, path: str) -> str | None:
    """Return the frame of a folder as the toolbox names it, below its authors' own."""
    return names.find(re.sub("/+", "/", path).strip("/"), loose=True)


def _split(root: Path, lists: Path | str | None, names: FrameNames) -> dict[str, SplitName] | None:
    """Return the split of the authors' for each frame that is in one; None = it is not there."""
    path = _found(root, SPLIT) if lists is None else Path(lists)
    if lists is not None and path is not None and path.is_dir():
        path = _found(path, SPLIT) or path / SPLIT
    if path is None:
        return None
    if not path.is_file():
        raise LayoutError(
            f"{path}: expected the official split {SPLIT}, found none; leave out --lists to split "
            "anew"
        )
    found: dict[str, SplitName] = {}
    for split, name in _SPLITS.items():
        for folder in texts_of(matlab_variable(path, name), path, name):
            frame_id = _frame(names, folder)
            if frame_id is not None and found.setdefault(frame_id, split) != split:
                raise LayoutError(
                    f"{path}: expected each frame in one split, found {frame_id!r} in both; give "
                    "the dataset's whole folder"
                )
    return found


def _with_split(description: Description, split: dict[str, SplitName] | None) -> Description:
    if split is None:
        note = (
            f"the official split (5285 train, 5050 test) is not known, as {SPLIT} of "
            "SUNRGBDtoolbox.zip is neither in nor beside the folder: frames are split anew; "
            "--lists says where it is"
        )
        return replace(description, no_split=True, notes=(*description.notes, note))
    if not split:
        note = f"{SPLIT} names none of the frames: they are split anew"
        return replace(description, no_split=True, notes=(*description.notes, note))
    return replace(description, split=SplitSource(frames=split))


def _numbers(path: Path, names: FrameNames) -> dict[str, int]:
    """Return which label of the file is each frame's."""
    listed = path.parent / FRAMES
    if not listed.is_file():
        raise LayoutError(
            f"{listed}: expected {FRAMES} beside {LABELS}, as it says which frame a label is of, "
            "found none; unpack SUNRGBDtoolbox.zip there, or use --no-labels"
        )
    frames = matlab_variable(listed, "SUNRGBDMeta", {"sequenceName", "rgbpath"})
    count = hdf5_cell_count(path, _CELLS)
    if not isinstance(frames, list) or len(frames) != count:
        there = len(frames) if isinstance(frames, list) else "no"
        raise LayoutError(
            f"{path}: expected as many labels under {_CELLS!r} as {FRAMES} has frames, found "
            f"{count} and {there}; give the two as they were published"
        )
    numbers: dict[str, int] = {}
    for number, frame in enumerate(frames):
        frame_id = _frame(names, _folder(frame, listed))
        if frame_id is not None and numbers.setdefault(frame_id, number) != number:
            raise LayoutError(
                f"{listed}: expected each frame once, found {frame_id!r} twice; give the dataset's "
                "whole folder"
            )
    return numbers


def _folder(frame: Mapping[str, Any], path: Path) -> str:
    """Return the folder of a frame: its sequence, or that of its colour image."""
    name, image = frame.get("sequenceName"), frame.get("rgbpath")
    if isinstance(image, str) and image.count("/") > 1:
        return image.rsplit("/", 2)[0]
    if isinstance(name, str) and name:
        return name
    raise DecodeError(
        f"{path}: expected 'rgbpath' or 'sequenceName' of each frame, found none; give the file as "
        "it was published"
    )


class _Labelled(WrappedReader):
    """Add the labels of the toolbox's file to the frames of a folder."""

    def __init__(
        self,
        reader: Reader,
        path: Path,
        numbers: Mapping[str, int],
        label: LabelSource,
        classes: tuple[LabelClass, ...],
    ) -> None:
        super().__init__(reader)
        self.info = replace(reader.info, classes=classes)
        self._path, self._numbers, self._label, self._classes = path, numbers, label, classes

    def _number(self, frame_id: str) -> int:
        if frame_id not in self._numbers:
            raise DecodeError(
                f"{self._path.parent / FRAMES}: expected label of frame {frame_id!r}, found none"
            )
        return self._numbers[frame_id]

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the frame's files, and those with all labels."""
        self._number(frame_id)
        labels = (self._path, self._path.parent / FRAMES)
        return (*self._reader.sources(frame_id), *labels)

    def read(self, frame_id: str, modalities: Collection[str] = MODALITIES) -> Frame:
        """Return the frame with its label."""
        number = self._number(frame_id)
        frame = self._reader.read(frame_id, modalities)
        if "label" not in modalities:
            return frame
        raw = read_hdf5_cell(self._path, _CELLS, number).T
        if raw.shape != frame.camera.shape:
            (h, w), found = frame.camera.shape, "x".join(map(str, raw.shape[::-1]))
            raise DecodeError(
                f"{self._path}: expected a label of {w}x{h} pixels for frame {frame_id!r}, found "
                f"{found}; give the file as it was published"
            )
        return replace(frame, label=label_of_values(raw, self._label, self._classes, self._path))
