"""Where exported files go: inside the place that was asked for, whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath, PurePosixPath

from nimprep.errors import LayoutError, NimprepError

_LONGEST_NAME = 255
"""Bytes in a file's name, on the file systems in use."""


def check_free(out: Path) -> None:
    """Raise `LayoutError` unless `out` is a new name or an empty folder."""
    try:
        taken = out.is_symlink() or (out.exists() and not out.is_dir())
        first = min((p.name for p in out.iterdir()), default=None) if out.is_dir() else None
    except OSError as error:
        raise LayoutError(f"{out}: expected a writable place, found {error.strerror}") from error
    if taken:
        raise LayoutError(f"{out}: expected a new or empty folder, found a file or link")
    if first is not None:
        raise LayoutError(
            f"{out}: expected a new or empty folder, found {first!r} in it; choose another or "
            "empty it"
        )


def check_new(out: Path) -> None:
    """Raise `LayoutError` where there is anything at `out` already."""
    if out.is_symlink() or out.exists():
        raise LayoutError(f"{out}: expected a new file's name, found it there; choose another")


@contextmanager
def whole(out: Path) -> Iterator[Path]:
    """Give a hidden folder beside `out` to write in, which is gone afterwards.

    `publish` gives it, or a file in it, the name of `out`; without that nothing is left.

    Raises
    ------
    LayoutError
        The place cannot be written.
    """
    partial = out.absolute().with_name(f".{out.absolute().name}.{secrets.token_hex(4)}.partial")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
        yield partial
    except OSError as error:
        if isinstance(error, NimprepError):
            raise
        raise LayoutError(f"{out}: expected to write it, found {error.strerror}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def publish(finished: Path, out: Path) -> None:
    """Give a finished file or folder its name, unless something has come there meanwhile."""
    check_free(out) if finished.is_dir() else check_new(out)
    finished.replace(out.absolute())


def files_of(ids: Iterable[str], suffix: str) -> dict[str, PurePosixPath]:
    """Return a path for each frame, by id; an id with "/" lies in subfolders.

    A store may come from anywhere, so ids are not to be trusted: each path stays below the folder
    it is joined to, and no two are the same or in each other's way.

    Raises
    ------
    LayoutError
        An id can be no such path.
    """
    files: dict[str, PurePosixPath] = {}
    for frame_id in ids:
        parts = frame_id.split("/")
        if frame_id in files:
            raise LayoutError(f"frame {frame_id!r}: expected each id once, found it twice")
        if not all(map(_is_plain, [*parts[:-1], parts[-1] + suffix])) or not parts[-1]:
            raise LayoutError(
                f"frame {frame_id!r}: expected an id that can be a file's name below a folder, "
                "found one that cannot; leave it out with --frames, or use --format rerun"
            )
        files[frame_id] = PurePosixPath(f"{frame_id}{suffix}")
    taken = set(files.values())
    for frame_id, path in files.items():
        blocked = taken.intersection(path.parents)
        if blocked:
            raise LayoutError(
                f"frame {frame_id!r}: expected room for its folder, found frame file "
                f"{str(min(blocked))!r} of that name; leave one of the two out with --frames"
            )
    return files


def _is_plain(name: str) -> bool:
    """Say whether a name is one file's or folder's: no way up, no drive, not hidden, not empty."""
    return (
        not name.startswith(".")
        and name.isprintable()
        and PurePath(name).parts == (name,)
        and len(os.fsencode(name)) <= _LONGEST_NAME
    )


def write_new(path: Path, data: bytes) -> None:
    """Write a file that is not there yet, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # Where case does not count, two ids may be one name: the second must not replace the first.
    with path.open("xb") as file:
        file.write(data)
