"""Which files make a frame: patterns are looked for below the dataset's folder, and paired."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from nimprep.errors import LayoutError
from nimprep.readers.description import Description
from nimprep.readers.frames import match_frames
from nimprep.readers.patterns import capture, placeholders
from nimprep.readers.tree import check_pattern, found_files

Key = TypeVar("Key", bound=Hashable)


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

    Raises
    ------
    LayoutError
        The pattern leaves the folder, its folder is missing, or two files give one id.
    """
    if pattern.count("{id}") != 1:
        raise LayoutError(f"{root}: expected a pattern with one {{id}}, found {pattern!r}")
    found: dict[str, Path] = {}
    for path, values in found_files(root, pattern):
        _add(found, values["id"], path)
    return found


def files_for(
    root: Path, pattern: str, captured: Mapping[str, Mapping[str, str]]
) -> dict[str, Place]:
    """Return each frame's file: that whose placeholders stand for what the frame's do.

    Parameters
    ----------
    pattern : str
        Of its placeholders those count that frames have. With fewer than a frame has, frames
        share a file: the camera of a scene; with none of them, all do.
    captured : mapping of frame id to mapping of placeholder to str
        As `Matched.captured`.

    Returns
    -------
    dict of frame id to Place
        Frames without such a file are not in it.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, its folder is missing, or a frame has two such files.
    """
    known = next(iter(captured.values()), {})
    names = [name for name in placeholders(pattern) if name in known]
    check_pattern(root, pattern)
    if not placeholders(pattern) and not set("*?") & set(pattern):
        return dict.fromkeys(captured, Place(root / pattern))
    wanted = {i: tuple(values[name] for name in names) for i, values in captured.items()}
    frame_of = {key: i for i, key in wanted.items()}
    found: dict[tuple[str, ...], Path] = {}
    for path, values in found_files(root, pattern):
        key = tuple(values[name] for name in names)
        if key in frame_of:
            _add(found, key, path, frame_of[key])
    return {i: Place(found[key]) for i, key in wanted.items() if key in found}


def _add(found: dict[Key, Path], key: Key, path: Path, frame_id: object = None) -> None:
    """Keep a frame's file, the only one."""
    if key in found:
        raise LayoutError(
            f"{path}: expected one file per id {frame_id or key!r}, found {found[key]} too; put "
            "more of the path into placeholders, or narrow the pattern"
        )
    found[key] = path


def group_of(frame_id: str, pattern: str | None) -> str:
    """Return the scene in a frame id by a pattern with ``{group}``; "" where it does not fit."""
    return "" if pattern is None else capture(pattern, frame_id, "group", lazy=True) or ""
