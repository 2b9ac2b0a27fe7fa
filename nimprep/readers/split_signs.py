"""What looks like a split of the dataset's authors and is none that is taken, to be said."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from nimprep.readers.matching import Matched
from nimprep.readers.split_lists import CALLED, ENDINGS

_WORDS = frozenset({*CALLED, "trainval", "eval", "evaluation"})
_MOST_FOLDERS = 256
"""So many folders are looked at for lists."""
_SHOWN = 3


def split_note(root: Path, matched: Matched) -> tuple[str, ...]:
    """Return what is to be said of folders and lists that are called like splits.

    Of the frames' folders those that are test's or val's by a word of their name, such as test_set;
    of lists those in the dataset's folder and two levels below, of which none is a frame's.
    """
    found = [*_folders(root, matched), *sorted(_lists(root, matched))]
    if not found:
        return ()
    more = f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    named = ", ".join(found[:_SHOWN]) + more
    return (
        f"no official split is taken, though {named} may be of one: frames of the authors' test "
        'may be in train; say "split" in the description (false if there is none), or give '
        "--split-file",
    )


def _words(name: str) -> set[str]:
    return {word.removesuffix("set") for word in re.findall(r"[a-z]+", name.lower())} & _WORDS


def _folders(root: Path, matched: Matched) -> list[str]:
    """Return folders of frames' colour images that are called like splits, the fullest first."""
    counts: Counter[str] = Counter()
    for place in matched.places["rgb"].values():
        parts = place.path.relative_to(root).parts[:-1]
        for level, part in enumerate(parts):
            if _words(part):
                counts["/".join((*parts[: level + 1], ""))] += 1
                break
    # One folder that holds all says nothing of who is in which split.
    if set(counts.values()) == {len(matched.places["rgb"])}:
        return []
    return [name for name, _ in counts.most_common()]


def _is_list(stem: str) -> bool:
    # Numbers are those of frames, of which something is told in a file each.
    return bool(_words(stem)) and not re.search(r"[0-9]{2}", stem)


def _entries(folder: Path) -> list[Path]:
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError:
        return []


def _lists(root: Path, matched: Matched) -> Iterator[str]:
    """Yield lists that are called like splits."""
    images = {place.path.parent for of in matched.places.values() for place in of.values()}
    folders = [root]
    for level in range(3):
        below: list[Path] = []
        for folder in folders[:_MOST_FOLDERS]:
            if folder in images and folder != root:
                continue
            for path in _entries(folder):
                if path.is_dir():
                    below.append(path)
                elif path.suffix.lower() in ENDINGS and _is_list(path.stem):
                    yield path.relative_to(root).as_posix()
        folders = below if level < 2 else []
