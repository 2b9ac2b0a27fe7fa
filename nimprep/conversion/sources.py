"""Telling a frame's source files apart from what they were before: sizes, times, contents."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

from nimprep.errors import DecodeError
from nimprep.readers import Reader

LARGE_FILE = 1 << 26
"""Of files of so many bytes the digest is kept: one that holds all frames is read once for them."""

FileState = tuple[str, int, int]
"""A file's name within the dataset, its bytes, and when it was changed, nanoseconds."""


def frame_state(reader: Reader, frame_id: str) -> tuple[FileState, ...]:
    """Return the state of the files a frame is read from.

    Raises
    ------
    DecodeError
        One is gone.
    """
    states = []
    for path in reader.sources(frame_id):
        try:
            found = path.stat()
        except OSError as error:
            raise DecodeError(
                f"{path}: expected a readable file, found {error.strerror}; mend it"
            ) from error
        states.append((_name(reader, path), found.st_size, found.st_mtime_ns))
    return tuple(states)


def frame_states(reader: Reader, *, skip_bad: bool = False) -> dict[str, tuple[FileState, ...]]:
    """Return the state of every frame's files.

    Parameters
    ----------
    skip_bad : bool
        A frame that has a file which cannot be asked for has no state, and is no error.

    Raises
    ------
    DecodeError
        A frame lacks a file: the first one, with the number of those.
    """
    states: dict[str, tuple[FileState, ...]] = {}
    bad: list[DecodeError] = []
    for frame_id in reader.ids:
        try:
            states[frame_id] = frame_state(reader, frame_id)
        except DecodeError as error:
            error.frame_id = frame_id
            bad.append(error)
            states[frame_id] = ()
    if bad and not skip_bad:
        if len(bad) > 1:
            bad[0].add_note(f"{len(bad)} of {len(reader.ids)} frames lack a file")
        raise bad[0]
    return states


def listed_state(state: tuple[FileState, ...]) -> list[list[Any]]:
    """Return a state as JSON has it."""
    return [list(file) for file in state]


def _name(reader: Reader, path: Path) -> str:
    within = path.is_relative_to(reader.root)
    return path.relative_to(reader.root).as_posix() if within else path.name


def changed_files(before: Iterable[FileState], after: Iterable[FileState]) -> list[str]:
    """Return the names of files that differ between two states of a frame."""
    old = {name: (size, time) for name, size, time in before}
    new = {name: (size, time) for name, size, time in after}
    return sorted(n for n in old.keys() | new.keys() if old.get(n) != new.get(n))


def frame_digest(reader: Reader, frame_id: str) -> str:
    """Return the SHA-256 of a frame's source files, names and contents.

    Raises
    ------
    DecodeError
        One cannot be read.
    """
    digest = hashlib.sha256()
    for path in reader.sources(frame_id):
        digest.update(f"{_name(reader, path)}\0".encode())
        try:
            digest.update(_file_digest(path))
        except OSError as error:
            raise DecodeError(
                f"{path}: expected a readable file, found {error.strerror}; mend it"
            ) from error
    return digest.hexdigest()


def _file_digest(path: Path) -> bytes:
    """Return the SHA-256 of a file; of a large one, which may hold many frames, once."""
    found = path.stat()
    if found.st_size < LARGE_FILE:
        return _read_digest(path, 0, 0)
    with _LARGE_FILES:
        return _large_digest(path, found.st_size, found.st_mtime_ns)


_LARGE_FILES = Lock()


def _read_digest(path: Path, size: int, changed_ns: int) -> bytes:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


_large_digest = lru_cache(maxsize=64)(_read_digest)
