"""A dataset one folder too deep or too high: the one that was meant."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

_MOST_FOLDERS = 200
_LEVELS_ABOVE = 5
"""As deep as a folder of images may lie: Scene01/clone/frames/rgb/Camera_0."""


def nearby_dataset(root: Path, is_known: Callable[[Path], bool]) -> Path | None:
    """Return the folder that is a dataset within a folder, at most 2 deep, or above it, at most 5.

    Of at most 200 folders within it is asked.

    Parameters
    ----------
    is_known : callable
        Tells whether a folder is a dataset.
    """
    looked = 0
    level = [root]
    for _ in range(2):
        level = [inner for folder in level for inner in _folders(folder)][:_MOST_FOLDERS]
        for folder in level:
            looked += 1
            if is_known(folder):
                return folder
            if looked >= _MOST_FOLDERS:
                return None
    return dataset_above(root, is_known)


def dataset_above(root: Path, is_known: Callable[[Path], bool]) -> Path | None:
    """Return the folder above another, at most 5 levels, that is a dataset."""
    above = Path(os.path.abspath(root))  # noqa: PTH100 - "." has no parent otherwise
    return next((each for each in above.parents[:_LEVELS_ABOVE] if is_known(each)), None)


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            names = sorted(e.name for e in entries if not e.name.startswith(".") and e.is_dir())
    except OSError:
        return []
    return [folder / name for name in names[:_MOST_FOLDERS]]
