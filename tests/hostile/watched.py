"""Run `info` and `validate` on stores and print, as JSON, every other thing that Python was asked.

python -m tests.hostile.watched GOOD_STORE STORES...

An audit hook sees what is opened, listed, imported, compiled, run, written and connected to,
whichever library asks for it. The good store comes first and unwatched, so that imports and
compiled kernels are loaded.
"""

from __future__ import annotations

import json
import os
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nimprep.cli import main

FILES = ("open", "os.listdir", "os.scandir", "os.readlink", "os.mkdir", "os.remove", "os.rename")
FILES += ("os.rmdir", "os.chmod", "os.link", "os.symlink", "os.truncate", "os.chdir")
NEVER = ("exec", "compile", "import", "pickle.", "subprocess.", "os.system", "os.exec", "os.posix")
NEVER += ("os.fork", "os.spawn", "socket.", "ctypes.", "urllib.", "ftplib.", "http.", "shutil.")
NEVER += ("tempfile.", "glob.", "marshal.", "code.", "sqlite3.", "webbrowser.")

watching: list[Path] = []
seen: list[str] = []


def inside(path: Any) -> bool:
    """Tell whether a path leads into the store, links followed."""
    if not isinstance(path, (str, bytes, os.PathLike)):
        return True  # a descriptor, of something that was opened before
    real = Path(os.path.realpath(os.fsdecode(path)))
    return real.is_relative_to(watching[0])


def hook(event: str, arguments: tuple[Any, ...]) -> None:
    """Note what neither `info` nor `validate` has any need for."""
    if not watching:
        return
    harmless = event == "open" and str(arguments[0]).startswith(("/proc/self/", "/sys/fs/cgroup/"))
    if event in FILES and not harmless and not inside(arguments[0]):
        seen.append(f"{event} {arguments[0]!r}")
    elif event.startswith(NEVER):
        seen.append(f"{event} {arguments!r:.200}")


def run(command: list[str]) -> int:
    """Run a command as the command line would; return its exit code."""
    try:
        main(command, standalone_mode=False)
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def watched(store: Path, action: Callable[[], int]) -> tuple[int, list[str]]:
    """Run something while watching; return its exit code and what was seen."""
    seen.clear()
    watching.append(Path(os.path.realpath(store)))
    try:
        code = action()
    finally:
        watching.clear()
    return code, list(seen)


def misbehave() -> int:
    """Do what should be seen, so that seeing nothing means something."""
    Path(__file__).read_bytes()
    os.listdir("/")  # noqa: PTH208
    pickle.loads(pickle.dumps(Path))
    eval("1")
    return 0


def main_() -> None:
    """Print a list of [store, command, exit code, what was seen]."""
    good, *stores = (Path(argument) for argument in sys.argv[1:])
    commands = (["info"], ["info", "--json"], ["validate", "--deep", "--quiet"], ["split"])
    sys.stdout, real = open(os.devnull, "w"), sys.stdout  # noqa: PTH123, SIM115
    for command in commands:
        run([*command, str(good)])
    "\x1b".encode("unicode_escape")  # imports its codec when first asked for
    sys.addaudithook(hook)
    code, what = watched(good, misbehave)
    found: list[Any] = [["misbehaving", "", code, what]]
    for store in (good, *stores):
        for command in commands:
            code, what = watched(store, lambda c=command, s=store: run([*c, str(s)]))
            found.append([str(store), " ".join(command), code, what])
    json.dump(found, real)


if __name__ == "__main__":
    main_()
