"""Signs of a layout: patterns of files, looked for until the first is found."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from nimprep.readers.tree import counts

Sign = str | tuple[str, ...]
"""A pattern of files, or several of which one will do."""

MOST_FOLDERS = 4000
"""So many folders are looked into at most; a dataset shows itself in its first ones."""

_MOST_ENTRIES = 200_000
"""So many names of one folder are read: whatever it holds, some of it comes among them."""

_BRACES = re.compile(r"\{([^{}]*,[^{}]*)\}")
_PLACEHOLDER = re.compile(r"\{\w+\}")


class Listing(NamedTuple):
    """Hold what is in a folder: names of folders and of files."""

    folders: tuple[str, ...]
    files: tuple[str, ...]


class Listings:
    """List folders, each once, as far as there are not too many."""

    def __init__(self, most: int = MOST_FOLDERS) -> None:
        self._known: dict[str, Listing] = {}
        self._left = most

    @classmethod
    def of_names(cls, names: Iterable[str]) -> Listings:
        """Return the listings of an archive: of the files' names in it, with "/", nothing else."""
        folders: dict[str, dict[str, None]] = {".": {}}
        files: dict[str, list[str]] = {}
        for name in names:
            *parents, last = name.strip("/").split("/")
            place = "."
            for parent in parents:
                folders.setdefault(place, {})[parent] = None
                place = parent if place == "." else f"{place}/{parent}"
            if not name.endswith("/"):
                files.setdefault(place, []).append(last)
        made = cls(0)
        for place in {**folders, **files}:
            made._known[place] = Listing(tuple(folders.get(place, ())), tuple(files.get(place, ())))
        return made

    @property
    def cut(self) -> bool:
        """Whether there were more than are looked into: what was not found may be there."""
        return self._left <= 0

    def of(self, folder: str) -> Listing:
        """Return what is in a folder; nothing where it cannot be read, or too many were."""
        if folder not in self._known:
            if self.cut:
                return Listing((), ())
            self._left -= 1
            self._known[folder] = _listed(folder)
        return self._known[folder]

    def find(self, root: Path | str, pattern: str) -> str | None:
        """Return a file, or folder, that a pattern fits, below a folder; None = there is none.

        Parameters
        ----------
        pattern : str
            ``*``, ``?`` and ``[0-9]`` stay within a folder, ``**`` is any folders or none,
            ``{a,b}`` is either, a ``{placeholder}`` is one character or more. Case does not
            count. One that ends with ``/`` is of folders.
        """
        for each in expanded(pattern):
            parts = tuple(each.rstrip("/").split("/"))
            found = next(self._fitting(str(root), parts, each.endswith("/")), None)
            if found is not None:
                return found
        return None

    def leads_through(self, root: str, pattern: str, parts: tuple[str, ...]) -> bool:
        """Return whether a file that a pattern fits lies in a folder, whose names are the parts."""
        for each in expanded(pattern):
            levels = each.split("/")
            if "**" in levels[: len(parts)]:
                return True
            fit = len(levels) > len(parts) and all(
                _fitting_name(level).fullmatch(part)
                for level, part in zip(levels, parts, strict=False)
            )
            rest = "/".join(levels[len(parts) :])
            if fit and self.find(Path(root, *parts), rest) is not None:
                return True
        return False

    def has(self, root: Path | str, sign: Sign) -> bool:
        """Return whether a sign is there below a folder."""
        patterns = (sign,) if isinstance(sign, str) else sign
        return any(self.find(root, pattern) is not None for pattern in patterns)

    def _fitting(self, folder: str, parts: tuple[str, ...], of_folders: bool) -> Iterator[str]:
        first, rest = parts[0], parts[1:]
        listing = self.of(folder)
        if first == "**":
            yield from self._fitting(folder, rest, of_folders)
            for name in listing.folders:
                yield from self._fitting(_joined(folder, name), parts, of_folders)
            return
        fits = _fitting_name(first)
        names = listing.folders if rest or of_folders else listing.files
        for name in names:
            if fits.fullmatch(name):
                path = _joined(folder, name)
                if rest:
                    yield from self._fitting(path, rest, of_folders)
                else:
                    yield path


def _joined(folder: str, name: str) -> str:
    # A Path takes ten times as long.
    return name if folder == "." else f"{folder}{os.sep}{name}"


def expanded(pattern: str) -> list[str]:
    """Return the patterns that one with ``{a,b}`` stands for."""
    found = _BRACES.search(pattern)
    if found is None:
        return [pattern]
    head, tail = pattern[: found.start()], pattern[found.end() :]
    return [each for word in found[1].split(",") for each in expanded(f"{head}{word}{tail}")]


def probed(pattern: str) -> str:
    """Return a description's pattern as one of a sign: what spans folders there does so here."""
    return "/".join(
        f"**/{part}" if "{id}" in part and not part.startswith("**") else part
        for part in pattern.split("/")
    )


@lru_cache(maxsize=512)
def _fitting_name(part: str) -> re.Pattern[str]:
    """Return the expression that names of one level fit."""
    made = []
    for piece in re.split(r"(\{\w+\}|\*|\?|\[[^\]]+\])", part):
        if _PLACEHOLDER.fullmatch(piece):
            made.append(".+")
        elif piece in ("*", "?"):
            made.append("." + piece.replace("?", ""))
        else:
            made.append(piece if piece.startswith("[") else re.escape(piece))
    return re.compile("".join(made), re.IGNORECASE | re.DOTALL)


def _listed(folder: str) -> Listing:
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in islice(entries, _MOST_ENTRIES):
                if counts(entry.name):
                    (folders if entry.is_dir() else files).append(entry.name)
    except OSError:
        return Listing((), ())
    return Listing(tuple(sorted(folders)), tuple(files))
