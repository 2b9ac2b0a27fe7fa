"""Processes that tests start: they end with the test, and one that is left is found and named."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

PATIENCE_S = 120
"""How long something may take that takes moments: then a test that would hang fails."""

GRACE_S = 10
"""How long a process that a test left may take to end by itself."""

_SUBREAPER = 36  # PR_SET_CHILD_SUBREAPER of Linux's prctl


class Processes:
    """Start processes, each in a session of its own; when the context ends they do, children too.

    Whoever shares them between tests makes one in a fixture; a test takes the fixture `processes`.
    """

    def __init__(self) -> None:
        self._started: list[subprocess.Popen[Any]] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for process in self._started:
            kill(process)

    def start(self, command: list[Any], **options: Any) -> subprocess.Popen[Any]:
        """Start a process with what `subprocess.Popen` takes."""
        process = subprocess.Popen([str(a) for a in command], start_new_session=True, **options)
        self._started.append(process)
        return process


def kill(process: subprocess.Popen[Any]) -> None:
    """End a process and its children, however far they are, and wait for it."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout, process.stderr):
        if pipe is not None:
            pipe.close()
    process.wait()


def same_code() -> dict[str, str]:
    """Return an environment in which `python -m` finds the code that the tests themselves run."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}


Child = tuple[int, str]
"""A process by its number and when it started, which together are no other's."""


def adopt_orphans() -> None:
    """Become the parent of processes whose own parent ends, so that none is out of sight."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)


def children() -> dict[Child, str]:
    """Return this process's children that live, with their commands; none where no /proc is."""
    if sys.platform != "linux":
        return {}
    try:
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
    except ChildProcessError:
        return {}  # as after most tests, without a look at every process
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            command = (
                (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            )
        except OSError:
            continue  # it has ended
        state, parent, start = fields[0], int(fields[1]), fields[19]
        # Python's own helper of shared memory lives as long as the process that first needed it.
        if parent == os.getpid() and state not in "ZX" and "resource_tracker" not in command:
            found[int(folder.name), start] = command.strip()
    return found


def end_child(child: Child) -> bool:
    """Return whether a child ends by itself, as one whose pipe was closed does; if not, kill it."""
    number, _ = child
    try:
        descriptor = os.pidfd_open(number)
    except ProcessLookupError:
        return True
    try:
        by_itself = bool(select.select([descriptor], [], [], GRACE_S)[0])
        if not by_itself:
            signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(number, 0)
        return by_itself
    finally:
        os.close(descriptor)
