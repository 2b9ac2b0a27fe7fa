"""Where exported files go: inside the place that was asked for."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path, PurePath, PurePosixPath
from urllib.parse import quote, unquote

from nimprep.errors import LayoutError

_LONGEST_NAME = 255
"""Bytes in a file's name, on the file systems in use."""

ENDINGS = ("png", "jpg")
"""Readers of lists cut these off, wherever they stand."""


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


def flat_names(ids: Iterable[str], suffix: str) -> dict[str, str]:
    """Return a name for each frame, by id, for layouts whose files lie in one folder.

    An id of letters, digits, "_", "-" and "." is its own name; all else is percent-encoded, "/" as
    %2F, and so is what readers take for a file's ending: `id_of` gives the id back.

    Raises
    ------
    LayoutError
        An id can be no such name.
    """
    names: dict[str, str] = {}
    for frame_id in ids:
        if frame_id in names:
            raise LayoutError(f"frame {frame_id!r}: expected each id once, found it twice")
        try:
            name = quote(frame_id, safe="").replace("~", "%7E")
        except UnicodeEncodeError:
            name = ""
        for ending in ENDINGS:
            name = name.replace(f".{ending}", f"%2E{ending}")
        name = f"%2E{name[1:]}" if name.startswith(".") else name
        if not name or not _is_plain(name + suffix):
            raise LayoutError(
                f"frame {frame_id!r}: expected an id that can be a file's name, found one that "
                "cannot; leave it out with --frames"
            )
        names[frame_id] = name
    return names


def id_of(name: str) -> str:
    """Return the id that a flat name stands for."""
    return unquote(name)


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
