"""Processes that tests start: they end with the test, their children too."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from types import TracebackType
from typing import Any

PATIENCE_S = 300
"""How long something may take that takes moments: then a test that would hang fails."""


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
