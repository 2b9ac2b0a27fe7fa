"""nimprep as an administrator installs it: for users who can write neither there nor at home."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import nimprep
from nimprep.compilation.folders import SAID
from tests.cli.world import make_world
from tests.processes import PATIENCE_S

PACKAGE = Path(nimprep.__file__).parent
TESTS = Path(__file__).parent.parent


@dataclass(frozen=True)
class Installation:
    """A copy of the package that cannot be written to, and a world that can.

    Attributes
    ----------
    root : Path
        Holds `site` with the package and its tests, `home`, which cannot be made, and `world`.
    """

    root: Path

    @property
    def in_tree(self) -> Path:
        """Where compiled kernels would be kept first."""
        return self.root / "site" / "nimprep" / "compilation" / "__pycache__"

    def run(
        self, *arguments: str | Path, temporary: str, cache_dir: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        """Call Python there as a user with no rights but to the world.

        Parameters
        ----------
        temporary : str
            The folder for temporary files, within `root`.
        cache_dir : Path, optional
            NUMBA_CACHE_DIR.
        """
        (self.root / temporary).mkdir(exist_ok=True, mode=0o777)
        (self.root / temporary).chmod(0o777)
        named = {"HOME": self.root / "locked" / "home", "TMPDIR": self.root / temporary}
        if cache_dir is not None:
            named["NUMBA_CACHE_DIR"] = cache_dir
        inherited = {
            name: value
            for name, value in os.environ.items()
            if name not in (SAID, "XDG_CACHE_HOME", "NUMBA_CACHE_DIR")
        }
        return subprocess.run(
            [*without_rights(), sys.executable, *map(str, arguments)],
            cwd=self.root / "world",
            env=inherited
            | {name: str(value) for name, value in named.items()}
            | {"PYTHONPATH": str(self.root / "site"), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            timeout=5 * PATIENCE_S,
            check=False,
        )


def install(root: Path) -> Installation:
    """Make an installation in an empty folder that everybody may enter."""
    unwanted = shutil.ignore_patterns("__pycache__", "data")
    shutil.copytree(PACKAGE, root / "site" / "nimprep", ignore=unwanted)
    shutil.copytree(TESTS, root / "site" / "tests", ignore=unwanted)
    if not (PACKAGE / "schemas").is_dir():
        shutil.copytree(PACKAGE.parent / "schemas", root / "site" / "nimprep" / "schemas")
    (root / "locked").mkdir()
    make_world(root / "world")
    for path in root.rglob("*"):
        path.chmod(path.stat().st_mode | (0o777 if path.is_dir() else 0o666))
    for folder in (root / "site", root / "locked"):
        lock(folder)
    return Installation(root)


def lock(folder: Path) -> None:
    """Take away the right to write from everybody, the folder's owner included."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)


def unlock(folder: Path) -> None:
    """Let the owner write again, and so remove it."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode | 0o200)


@cache
def without_rights() -> tuple[str, ...]:
    """Return what begins a command that is to run as somebody who is stopped by a file's mode."""
    if os.geteuid() != 0:
        return ()
    nobody = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups")
    reading = ("--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search")
    # In turn: somebody else; the same, with a right to read where Python is in root's own folder;
    # root without the right to pass over modes.
    ways = (
        nobody,
        (*nobody, *reading),
        ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner"),
    )
    for way in ways:
        # A second process, as setpriv itself may still enter any folder.
        start = "import subprocess, sys; subprocess.run([sys.executable, '-c', ''], check=True)"
        done = subprocess.run([*way, sys.executable, "-c", start], capture_output=True, check=False)
        if done.returncode == 0:
            return way
    raise AssertionError("expected util-linux's setpriv to give up root's rights")
