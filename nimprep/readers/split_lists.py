"""Text files that list a split's frames: a frame per line, by its id or by a file of its."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from nimprep.errors import SplitError
from nimprep.files import read_file
from nimprep.splits import SplitName

MAX_BYTES = 1 << 28
"""A list of more bytes is no list."""

ENDINGS = (".txt", ".lst", ".csv")

CALLED: dict[str, SplitName] = {
    "train": "train",
    "training": "train",
    "val": "val",
    "valid": "val",
    "validation": "val",
    "dev": "val",
    "test": "test",
    "testing": "test",
}
"""What splits are called, in small letters."""


class Line(NamedTuple):
    """Say what stands where in a list: its number from 1, and the ways to read its columns."""

    number: int
    ways: tuple[tuple[str, ...], ...]


class FrameNames:
    """Find frames by what lists call them.

    Parameters
    ----------
    files : mapping of frame id to files
        Paths below the dataset's folder, with "/".
    """

    def __init__(self, files: Mapping[str, Iterable[str]]) -> None:
        self._ids = files.keys()
        self._known: dict[str, str | None] = {}
        for frame_id, paths in files.items():
            for path in paths:
                self._add(path, frame_id)
                self._add(path.removesuffix(PurePosixPath(path).suffix), frame_id)
        self._ends: dict[str, str | None] | None = None

    def _add(self, name: str, frame_id: str) -> None:
        same = self._known.setdefault(name, frame_id) == frame_id
        if not same:
            # A file of several frames names none.
            self._known[name] = None

    def find(self, name: str, *, loose: bool = False) -> str | None:
        """Return the frame of this id, file, or end of a file's path; None = of no one frame.

        A path may begin with folders above the dataset's, and lack its ending. Then it is all of
        the path below the dataset's folder, unless `loose`: what is not there, such as another
        scene, is not to be taken for what is.
        """
        name = name.replace("\\", "/").removeprefix("./").strip("/")
        whole = True
        while name:
            for each in (name, name.removesuffix(PurePosixPath(name).suffix)):
                found = each if each in self._ids else self._known.get(each)
                if found is not None:
                    return found
            if (whole or loose) and (found := self._by_end().get(name)) is not None:
                return found
            whole = False
            name = name.partition("/")[2]
        return None

    def _by_end(self) -> dict[str, str | None]:
        """Return the frames by the ends of their files' paths."""
        if self._ends is None:
            self._ends = {}
            for path, frame_id in self._known.items():
                rest = path
                while rest:
                    if self._ends.setdefault(rest, frame_id) != frame_id:
                        self._ends[rest] = None
                    rest = rest.partition("/")[2]
        return self._ends


class Listed(NamedTuple):
    """Say which frames lists name, and which lines name none, as a message says them.

    `twice` are frames in the lists of several splits, where these may be.
    """

    of_frame: dict[str, SplitName]
    unknown: list[str]
    twice: tuple[str, ...] = ()


def listed_splits(
    lists: Iterable[tuple[SplitName, Path]], names: FrameNames, *, last: bool = False
) -> Listed:
    """Read the lists of splits.

    Parameters
    ----------
    last : bool
        A frame in the lists of several splits is in the last of train, val and test, so that
        nothing is trained on that is tested; without, it is an error.

    Raises
    ------
    SplitError
        One cannot be read; a line names two frames; or a frame is in the lists of two splits.
    """
    lists = list(lists)
    listed = _listed(lists, names, loose=False, last=last)
    # Folders above the dataset's, and others below it that the lists do not know.
    return listed if listed.of_frame else _listed(lists, names, loose=True, last=last)


_ORDER: tuple[SplitName, ...] = ("train", "val", "test")


def _listed(
    lists: Iterable[tuple[SplitName, Path]], names: FrameNames, *, loose: bool, last: bool
) -> Listed:
    found: dict[str, SplitName] = {}
    twice: dict[str, None] = {}
    unknown: list[str] = []
    for split, path in lists:
        for line in _lines(path):
            frame_id = _frame(path, line, names, loose=loose)
            if frame_id is None:
                # A table's first line says what its columns are.
                if line.number > 1 or path.suffix.lower() != ".csv":
                    unknown.append(f"{path}: line {line.number}: {' '.join(line.ways[-1])[:80]!r}")
            elif found.setdefault(frame_id, split) != split and last:
                twice[frame_id] = None
                found[frame_id] = max(split, found[frame_id], key=_ORDER.index)
            elif found[frame_id] != split:
                raise SplitError(
                    f"{path}: line {line.number}: expected each frame in one split, found "
                    f"{frame_id!r} in {found[frame_id]} too; take it out of one list"
                )
    return Listed(found, unknown, tuple(twice))


def lists_beside(path: Path) -> list[tuple[SplitName, Path]]:
    """Return the lists of splits in a folder, by their names.

    Raises
    ------
    SplitError
        Two are of one split.
    """
    found: dict[SplitName, Path] = {}
    for each in sorted(path.iterdir()):
        split = CALLED.get(each.stem.lower())
        if split is None or each.suffix.lower() not in ENDINGS or not each.is_file():
            continue
        if split in found:
            raise SplitError(
                f"{each}: expected one list of {split}, found {found[split]} too; remove one"
            )
        found[split] = each
    return list(found.items())


def _lines(path: Path) -> Iterator[Line]:
    data = read_file(path, MAX_BYTES, "a readable list", SplitError)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SplitError(
            f"{path}: expected a list in UTF-8, found other bytes; save it as text"
        ) from error
    for number, line in enumerate(text.splitlines(), 1):
        plain = line.strip()
        if plain and not plain.startswith("#"):
            ways = ((plain,), re.split(r"\s*[,;\t]\s*", plain), plain.split())
            yield Line(number, tuple(tuple(dict.fromkeys(way)) for way in ways))


def _frame(path: Path, line: Line, names: FrameNames, *, loose: bool) -> str | None:
    """Return the frame that a line names, in any of its columns; None = none."""
    for way in line.ways:
        sought = (names.find(name, loose=loose) for name in way)
        found = {frame_id for frame_id in sought if frame_id is not None}
        if len(found) > 1:
            a, b = sorted(found)[:2]
            raise SplitError(
                f"{path}: line {line.number}: expected one frame, found {a!r} and {b!r}; give each "
                "a line"
            )
        if found:
            return found.pop()
    return None
