"""The files below a dataset's folder: each once, in order, litter passed over."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.readers.patterns import captures

MAX_FILES = 1 << 22
"""A dataset's folder with more files is refused: a link led somewhere it should not."""

_ARCHIVES = frozenset({".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar"})
_MOST_NAMES = 8

_LITTER = ("__macosx", "thumbs.db", "desktop.ini")
"""What systems leave in folders, beside what is hidden; in small letters."""


def found_files(root: Path, pattern: str) -> Iterator[tuple[Path, dict[str, str]]]:
    """Yield the files that a pattern finds, in order, and what its placeholders stand for.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, or its folder is missing; or a placeholder stands for what
        cannot be printed. A pattern without any is a file, there or not.
    """
    check_pattern(root, pattern)
    if not set("*?{") & set(pattern):
        yield root / pattern, {}
        return
    fixed = re.split(r"[^/]*[*?{]", pattern, maxsplit=1)[0]
    start = root / fixed
    # Path.is_dir raises where a name is too long for any file.
    if not os.path.isdir(start):  # noqa: PTH112
        raise LayoutError(
            f"{start}: expected a folder with files {pattern!r}, found none; {_folders_near(start)}"
        )
    for path in _files_below(start, root):
        found = captures(pattern, path.relative_to(root).as_posix())
        if found is None:
            continue
        if not all(value.isprintable() for value in found.values()):
            raise LayoutError(f"{path!a}: expected a printable file name, found another")
        yield path, found


def check_root(root: Path) -> None:
    """Raise `LayoutError` where what should be a dataset's folder is none."""
    if root.is_dir():
        return
    found, step = "nothing", "check the path"
    if root.suffix.lower() in _ARCHIVES:
        found, step = "an archive", "unpack it, and give the folder"
    elif root.exists():
        found, step = "a file", "give the folder that holds all of them"
    raise LayoutError(f"{root}: expected a dataset's folder, found {found}; {step}")


def _folders_near(missing: Path) -> str:
    """Return what to compare a missing folder with: those beside it, or where it should begin."""
    there = next(parent for parent in missing.parents if os.path.isdir(parent))  # noqa: PTH112
    names = sorted(p.name for p in there.iterdir() if p.is_dir() and counts(p.name))
    if not names:
        return f"{there} holds no folders"
    more = ", ..." if len(names) > _MOST_NAMES else ""
    return f"folders in {there} are {', '.join(names[:_MOST_NAMES])}{more}"


def check_pattern(root: Path, pattern: str) -> None:
    """Raise `LayoutError` where a pattern does not stay below the dataset's folder."""
    if "\\" in pattern:
        raise LayoutError(
            f"{root}: expected a pattern with '/' between folders, found a backslash in "
            f"{pattern!r}; use / on every system"
        )
    if pattern.startswith("/") or ".." in pattern.split("/"):
        raise LayoutError(
            f"{root}: expected a pattern below the folder, found {pattern!r}; leave out .. and a "
            "leading /"
        )


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
        subfolders[:] = sorted(filter(counts, subfolders))
        for name in sorted(filter(counts, names)):
            path = Path(folder, name)
            # A pipe or a device would wait for ever; a link to nothing is an error when read.
            if path.is_file() or not path.exists():
                yield path


def counts(name: str) -> bool:
    """Tell whether a name is looked at: it is not hidden, and no litter of systems."""
    return not name.startswith(".") and name.lower() not in _LITTER
