"""Which files make a frame: patterns are looked for below the dataset's folder, and paired."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.readers.description import Description
from nimprep.readers.frames import match_frames
from nimprep.readers.patterns import capture

MAX_FILES = 1 << 22
"""A dataset's folder with more files is refused: a link led somewhere it should not."""


@dataclass(frozen=True)
class Place:
    """Name a file, and which of the frames in it, where it holds many; None = all of it is one."""

    path: Path
    index: int | None = None


@dataclass(frozen=True)
class Matched:
    """Hold which files make which frame.

    Attributes
    ----------
    ids : tuple of str
        Every frame, sorted, those that lack something among them.
    places : mapping of kind of image to mapping of frame id to Place
    lacking : mapping of frame id to str
        Why a frame is bad, as a whole message.
    captured : mapping of frame id to mapping of placeholder to str
        What the placeholders stand for in the frame's colour image.
    notes : tuple of str
        One line each: what was passed over, and why.
    """

    ids: tuple[str, ...]
    places: Mapping[str, Mapping[str, Place]]
    lacking: Mapping[str, str] = field(default_factory=dict)
    captured: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def of(self, frame_id: str) -> dict[str, Place]:
        """Return the frame's files by kind of image."""
        return {name: by_id[frame_id] for name, by_id in self.places.items() if frame_id in by_id}


def matched_frames(root: Path, description: Description, wanted: Collection[str]) -> Matched:
    """Find the files of every frame.

    Parameters
    ----------
    wanted : collection of str
        Kinds of image that will be read; the others need not be there.

    Raises
    ------
    LayoutError
        A folder is missing or empty, there are no frames, or one lacks a file.
    """
    found: dict[str, dict[str, Path]] = {}
    for name, source in description.sources():
        if name not in wanted:
            continue
        try:
            found[name] = files_by_id(root, source.files)
        except LayoutError as error:
            if source is not description.label:
                raise
            raise LayoutError(f"{error}; use --no-labels to convert without") from error
    ids = match_frames(found, root)
    places = {name: {i: Place(path) for i, path in files.items()} for name, files in found.items()}
    return Matched(ids, places, captured={i: {"id": i} for i in ids})


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
