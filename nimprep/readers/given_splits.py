"""The split that the user gives: a JSON file, or lists of frames as datasets have them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from nimprep.errors import DecodeError, SplitError
from nimprep.readers.base import Reader
from nimprep.readers.split_lists import (
    CALLED,
    ENDINGS,
    FrameNames,
    listed_splits,
    lists_beside,
)
from nimprep.splits import splits_from_file


def given_splits(path: Path | str, files: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the split of each frame; "none" of those that are not named.

    Parameters
    ----------
    files : mapping of frame id to paths
        Below the dataset's folder, with "/", as lists may name frames by; empty = by ids alone.
    path : path
        A split file (schemas/split.schema.json); or a list of a split's frames, called by it, such
        as train.txt, which those of the other splits lie beside; or the folder of the lists.

    Raises
    ------
    SplitError
        It is none of these, or names a frame that is not there, or one in two splits.
    """
    path = Path(path)
    if not path.exists():
        raise SplitError(
            f"{path}: expected a split file (schemas/split.schema.json) or a list such as "
            "train.txt, found nothing; check the path"
        )
    if not _are_lists(path):
        return splits_from_file(path, tuple(files))
    lists = lists_beside(path if path.is_dir() else path.parent)
    if not path.is_dir() and path not in [each for _, each in lists]:
        raise SplitError(
            f"{path}: expected a list called {', '.join(CALLED)}, found {path.name!r}; name it by "
            "its split"
        )
    if not lists:
        raise SplitError(f"{path}: expected lists such as train.txt, found none; add them")
    listed = listed_splits(lists, FrameNames(files))
    if listed.unknown:
        raise SplitError(
            f"{listed.unknown[0]} is neither id nor file of any of the {len(files)} frames "
            f"({len(listed.unknown)} lines are like it): expected those alone, found another; "
            "check the list belongs to this dataset"
        )
    return {i: listed.of_frame.get(i, "none") for i in files}


def split_files(path: Path) -> list[Path]:
    """Return the files that a given split is read from."""
    if not _are_lists(path):
        return [path]
    return [each for _, each in lists_beside(path if path.is_dir() else path.parent)]


def _are_lists(path: Path) -> bool:
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            json = file.read(64).lstrip().startswith(b"{")
    except OSError:
        # Reading it says so.
        return False
    return path.suffix.lower() in ENDINGS and not json


def files_of_frames(reader: Reader) -> dict[str, list[str]]:
    """Return the files of each of a reader's frames, as `given_splits` takes them."""
    return {frame_id: _files(reader, frame_id) for frame_id in reader.ids}


def _files(reader: Reader, frame_id: str) -> list[str]:
    try:
        files = reader.sources(frame_id)
    except DecodeError:
        return []
    return [p.relative_to(reader.root).as_posix() for p in files if p.is_relative_to(reader.root)]
