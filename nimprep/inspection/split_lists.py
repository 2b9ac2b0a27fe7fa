"""Text files that list the frames of train, val and test."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from nimprep.errors import DecodeError
from nimprep.files import read_file
from nimprep.inspection.examination import Examination
from nimprep.inspection.words import words_of
from nimprep.readers.split_lists import CALLED

_MOST_BYTES = 1 << 24


@dataclass(frozen=True)
class SplitLists:
    """Hold lists of frames.

    Attributes
    ----------
    files : mapping of split to path
    counts : mapping of split to the number of lines
    whole : bool
        Every frame is in one.
    twice : bool
        A frame is in several: they are no split.
    """

    files: dict[str, str]
    counts: dict[str, int]
    whole: bool
    twice: bool


def split_lists(found: Examination, frames: Sequence[tuple[str, ...]]) -> SplitLists | None:
    """Return the list files that name frames, each of which has these names."""
    known = {name for names in frames for name in names}
    files: dict[str, str] = {}
    entries: dict[str, set[str]] = {}
    paths = [member.path for t in found.texts for member in t.members[:50]]
    for path in sorted(paths, key=lambda path: (path.count("/"), path)):
        name = path.rpartition("/")[2]
        split = next((CALLED[w] for w in words_of(name.rpartition(".")[0]) if w in CALLED), None)
        if split is None or split in files:
            continue
        named = _named(found, path, known)
        if named:
            files[split], entries[split] = path, named
    if not files:
        return None
    every = set().union(*entries.values())
    twice = sum(map(len, entries.values())) > len(every)
    counts = {split: len(named) for split, named in entries.items()}
    return SplitLists(files, counts, _covers(every, frames), twice)


def _named(found: Examination, path: str, known: set[str]) -> set[str]:
    """Return what lines of a file name, where most name an image."""
    try:
        data = read_file(found.survey.root / path, _MOST_BYTES)
    except DecodeError:
        return set()
    names, hits = set(), 0
    for line in data.decode("utf-8", "replace").splitlines():
        columns = line.split()
        if not columns or line.startswith("#"):
            continue
        names.add(columns[0])
        hits += any(_is_known(column, known) for column in columns)
    return names if names and hits >= 0.5 * len(names) else set()


def _stem(column: str) -> str:
    name = column.rpartition("/")[2]
    return re.sub(r"\.[A-Za-z]\w{1,4}$", "", name)


def _is_known(column: str, known: set[str]) -> bool:
    return _stem(column) in known


def _covers(named: set[str], frames: Sequence[tuple[str, ...]]) -> bool:
    stems = {_stem(name) for name in named}
    return all(any(name in stems for name in names) for names in frames)
