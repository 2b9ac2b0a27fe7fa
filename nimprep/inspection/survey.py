"""Which files lie below a folder, bounded in number whatever lies there."""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass
from pathlib import Path

MAX_FILES = 300_000
"""So many are looked at by name; what lies beyond is said not to have been."""

MAX_PER_FOLDER = 100_000
MAX_PROBLEMS = 20
_DEEPEST = 40

_LITTER = {"thumbs.db", "desktop.ini", "__macosx", "@eadir", "__pycache__", "lost+found"}


@dataclass(frozen=True)
class Survey:
    """Hold the files below a folder.

    Attributes
    ----------
    root : Path
    files : tuple of str
        Below the root, with "/", sorted within each folder.
    cut : bool
        There are more than were listed.
    problems : tuple of str
        One line each: what could not be looked at.
    stores : tuple of str
        Folders that are Zarr stores; what is in them is not listed.
    """

    root: Path
    files: tuple[str, ...]
    cut: bool = False
    problems: tuple[str, ...] = ()
    stores: tuple[str, ...] = ()


def survey_folder(root: Path) -> Survey:
    """List the files below a folder, folder by folder; hidden ones and litter are passed over.

    Links are followed as readers do: to files and to folders elsewhere, each folder once, none that
    leads to the folder itself or above it.
    """
    home = os.path.realpath(root)
    seen, queue = {home}, deque([""])
    files: list[str] = []
    problems: list[str] = []
    stores: list[str] = []
    cut = False
    while queue and len(files) < MAX_FILES:
        folder = queue.popleft()
        names, subfolders = _listed(root, folder, problems)
        if "zarr.json" in names and folder:
            stores.append(folder.rstrip("/"))
            continue
        cut |= len(names) > MAX_PER_FOLDER
        files += [folder + name for name in names[:MAX_PER_FOLDER]]
        for name in subfolders:
            if folder.count("/") > _DEEPEST:
                problems.append(f"{folder[:80]}...: folders more than {_DEEPEST} deep")
                break
            real = os.path.realpath(root / (folder + name))
            if Path(home).is_relative_to(real):
                problems.append(f"{folder}{name}: a link to a folder that holds this one")
            elif real not in seen:
                seen.add(real)
                queue.append(f"{folder}{name}/")
    cut |= bool(queue) or len(files) > MAX_FILES
    return Survey(
        root, tuple(files[:MAX_FILES]), cut, tuple(problems[:MAX_PROBLEMS]), tuple(stores)
    )


def _listed(root: Path, folder: str, problems: list[str]) -> tuple[list[str], list[str]]:
    """Return the names of files and of folders in a folder, sorted."""
    names: list[str] = []
    subfolders: list[str] = []
    try:
        with os.scandir(root / folder) as entries:
            for entry in entries:
                if entry.name.startswith(".") or entry.name.lower() in _LITTER:
                    continue
                if not entry.name.isprintable():
                    problems.append(f"{folder}{entry.name!a}: a name that cannot be printed")
                    continue
                try:
                    if entry.is_dir():
                        subfolders.append(entry.name)
                    elif entry.is_file():
                        names.append(entry.name)
                    elif entry.is_symlink():
                        problems.append(f"{folder}{entry.name}: a link to nothing")
                except OSError as error:
                    problems.append(f"{folder}{entry.name}: {error.strerror}")
    except OSError as error:
        problems.append(f"{folder or '.'}: cannot be listed ({error.strerror})")
    return sorted(names), sorted(subfolders)
