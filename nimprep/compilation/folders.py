"""The folders that compiled kernels are kept in: which are read, and which one is written to.

In turn: NUMBA_CACHE_DIR where it is set, the package's own folder, the user's cache, and a private
folder for temporary files. The first that can be written to is written to, and those before it are
read all the same: an image that was built by root holds everything that its users need.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numba
from numba.misc.appdirs import AppDirs

IN_TREE = Path(__file__).resolve().parent / "__pycache__"

SAID = "NIMPREP_CACHE_SAID"
"""Set in the environment once the user was told, so that processes started from here are quiet."""


@dataclass(frozen=True)
class Place:
    """A folder that kernels may be kept in.

    Attributes
    ----------
    folder : Path
    lasting : bool
        Whether it stays until somebody removes it.
    doubt : callable
        Returns in a few words why the folder must not even be read, "" where it may: what is in it
        is code.
    """

    folder: Path
    lasting: bool = True
    doubt: Callable[[Path], str] = lambda folder: ""

    def hindrance(self) -> str:
        """Make the folder where need be; return why nothing can be kept there, "" if it can."""
        try:
            doubt = self.doubt(self.folder)
            if not doubt:
                self.folder.mkdir(parents=True, exist_ok=True)
                tempfile.TemporaryFile(dir=self.folder).close()
        except OSError as error:
            return error.strerror or str(error)
        return doubt


class CacheFolders:
    """Decide once for this process; processes that start from it come to the same."""

    def __init__(self, find: Callable[[], list[Place]]) -> None:
        self._find = find
        self._decided = False
        self._chosen: Path | None = None

    @cached_property
    def _places(self) -> list[Place]:
        return self._find()

    def to_read(self) -> Iterator[Path]:
        """Yield the folders to look in, one by one; only after the first is one to write chosen."""
        for place in self._places:
            if not place.doubt(place.folder):
                yield place.folder
            if place.folder == self.to_write:
                return

    @property
    def wished(self) -> Path | None:
        """The folder within NUMBA_CACHE_DIR; None where that is not set."""
        return self._places[0].folder if _wished() else None

    @property
    def to_write(self) -> Path | None:
        """The folder to write to; None = there is none, and kernels are compiled in every run."""
        if not self._decided:
            self._decided = True
            self._decide()
        return self._chosen

    def _decide(self) -> None:
        found, lasting = [], False
        for place in self._places:
            reason = place.hindrance()
            if not reason:
                self._chosen, lasting = place.folder, place.lasting
                break
            found.append(f"{place.folder} ({reason})")
        if not found or (lasting and not _wished()):
            return
        instead = (
            "those missing are compiled in each run, which takes up to half a minute"
            if self._chosen is None
            else f"those missing are kept in {self._chosen}"
        )
        _say(
            f"compiled kernels: expected a folder to keep them in, found no way to write to "
            f"{', '.join(found)}; {instead}; set NUMBA_CACHE_DIR to a folder that can be written to"
        )

    def note_failure(self, path: Path, error: OSError) -> None:
        """Say that a kernel could not be kept."""
        _say(
            f"{path}: expected to keep a compiled kernel there, found {error.strerror or error}; "
            "it is compiled in each run; set NUMBA_CACHE_DIR to another folder"
        )


def _wished() -> str:
    return str(getattr(numba.config, "CACHE_DIR", ""))


def _say(line: str) -> None:
    if SAID not in os.environ:
        os.environ[SAID] = "1"
        warnings.warn(line, stacklevel=2)


def _places() -> list[Place]:
    package = IN_TREE.parent.parent
    # Installations apart, as each would write over the other's.
    name = f"nimprep_{hashlib.sha256(str(package).encode()).hexdigest()[:16]}"
    places = [Place(IN_TREE)]
    if _wished():
        places.insert(0, Place(Path(_wished()).absolute() / name))
    names: Any = AppDirs(appname="numba", appauthor=False)  # type: ignore[no-untyped-call]
    user = Path(names.user_cache_dir)
    # Relative where there is neither HOME nor such a user.
    if user.is_absolute():
        places.append(Place(user / name, doubt=_doubt_at_home))
    temporary = _temporary()
    if temporary is not None:
        places.append(Place(temporary / name, lasting=False, doubt=_doubt_among_others))
    return places


def _temporary() -> Path | None:
    """Return the folder for temporary files; None where there is none but the working one."""
    named = [os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP")]
    try:
        folder, working = Path(tempfile.gettempdir()), Path.cwd()
    except OSError:
        return None
    if folder == working and str(folder) not in (*named, "/tmp", "/var/tmp"):
        return None
    # One for each user and not one for each run: the next run finds it, and nothing piles up.
    return folder / f"nimprep-{_user()}"


def _user() -> int | None:
    return os.geteuid() if hasattr(os, "geteuid") else None


def _doubt_at_home(folder: Path) -> str:
    # Root with another's HOME, as sudo has it, would leave files that their owner cannot replace.
    if _user() != 0:
        return ""
    try:
        there = next(parent for parent in (folder, *folder.parents) if parent.exists())
        return "of another user" if there.stat().st_uid else ""
    except OSError as error:
        return error.strerror or str(error)


def _doubt_among_others(folder: Path) -> str:
    """Look at a folder where others may write beside it: they could have made it, or a link."""
    private = folder.parent
    try:
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
    except OSError as error:
        return error.strerror or str(error)
    if _user() is None:
        return ""
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != _user():
        return "not a folder of this user"
    return "a folder that others have access to" if found.st_mode & 0o077 else ""


FOLDERS = CacheFolders(_places)
