"""A dataset one folder too deep or too high: the one that was meant."""

from __future__ import annotations

import os
from pathlib import Path

_MOST_FOLDERS = 200


def nearby_dataset(root: Path) -> Path | None:
    """Return the folder with a known layout within a folder, at most 2 deep, or above it.

    Only folders' names are looked at, of at most 200 folders.
    """
    looked = 0
    level = [root]
    for _ in range(2):
        level = [inner for folder in level for inner in _folders(folder)][:_MOST_FOLDERS]
        for folder in level:
            looked += 1
            if _is_known(folder):
                return folder
            if looked >= _MOST_FOLDERS:
                return None
    above = Path(os.path.abspath(root)).parent  # noqa: PTH100 - "." has no parent otherwise
    return above if _is_known(above) and above != root else None


def _folders(folder: Path) -> list[Path]:
    try:
        with os.scandir(folder) as entries:
            names = sorted(e.name for e in entries if not e.name.startswith(".") and e.is_dir())
    except OSError:
        return []
    return [folder / name for name in names[:_MOST_FOLDERS]]


def _is_known(folder: Path) -> bool:
    """Tell whether a folder has all that GMRP's or KITTI road's layout needs."""
    if all((folder / name).is_dir() for name in ("rgb", "depth_u16")):
        return True
    return any(
        (folder / split / "image_2").is_dir() and (folder / split / "calib").is_dir()
        for split in ("training", "testing")
    )
