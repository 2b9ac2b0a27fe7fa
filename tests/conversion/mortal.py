"""A process that runs conversions in children that can be killed, each started within milliseconds.

It imports what they need once and forks; it has no threads of its own, which a fork would break.
Run as a program it takes a line of JSON per request on stdin, and answers each with one. Children
die or stand still where their code has come to, never after so much time.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

from tests.held import RECORD, stand_still
from tests.processes import Processes, same_code

CALLS = {"open", "os.listdir", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.scandir"}
"""What a conversion asks of the file system, by the names of Python's audit events."""


def append(source: Path, store: Path, **options: Any) -> None:
    """Append as a nightly job would."""
    import nimprep

    nimprep.append_frames(source, store, workers=2, skip_existing=True, on_error="skip", **options)


def convert(source: Path, store: Path, **options: Any) -> None:
    """Make or replace a store."""
    import nimprep

    nimprep.convert(source, store, **options)


def merge(source: Path, store: Path, **options: Any) -> None:
    """Join all stores of a folder."""
    import nimprep

    nimprep.merge_stores(sorted(source.glob("*.zarr")), store, **options)


TASKS = {"append": append, "convert": convert, "merge": merge}


def die_at_step(step: int, atomic: bool) -> None:
    """Kill this process before the so-manieth change that publishing a store makes to the disk.

    The removal of a folder is one.

    Parameters
    ----------
    atomic : bool
        Whether two folders can change names at once, which is no step: steps are around it.
    """
    import nimprep.store.writer as writer
    from nimprep.conversion.workspace import LocalWorkspace

    publish = LocalWorkspace.publish

    def publish_and_die(self: LocalWorkspace, *arguments: Any) -> None:
        steps = itertools.count()

        def hook(event: str, found: tuple[Any, ...]) -> None:
            if _changes(event, found) and next(steps) == step:
                os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        publish(self, *arguments)

    LocalWorkspace.publish = publish_and_die  # type: ignore[method-assign]
    if not atomic:
        writer.swap_folders = lambda a, b: False


def _changes(event: str, found: tuple[Any, ...]) -> bool:
    """Tell whether an audit event is a change to the disk."""
    if event == "open":
        return bool(found[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
    # What is removed below an open folder is part of that one's removal.
    return event in {"os.rename", "os.mkdir", "shutil.rmtree"} or (
        event in {"os.remove", "os.rmdir"} and found[1] == -1
    )


def count_calls(number: int | None) -> itertools.count[int]:
    """Count this process's calls of the file system, and kill it before one of them.

    Parameters
    ----------
    number : int, optional
        That one's number from 0; None = it lives.
    """
    calls = itertools.count()

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in CALLS and next(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(hook)
    return calls


class Mortals:
    """Start children, one after the other, by the program in this file."""

    def __init__(self, processes: Processes) -> None:
        self._server: subprocess.Popen[str] = processes.start(
            [sys.executable, "-m", "tests.conversion.mortal"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=same_code(),
        )
        self.calls: int | None = None
        """How often the last child that was not killed called the file system."""

    def start(
        self,
        task: str,
        source: Path,
        store: Path,
        *,
        step: int | None = None,
        atomic: bool = True,
        call: int | None = None,
        hold: bool = False,
        **options: Any,
    ) -> None:
        """Start a child.

        Parameters
        ----------
        task : str
            One of `TASKS`.
        step, atomic
            Where it dies while a store is published: see `die_at_step`.
        call : int, optional
            The call of the file system before which it dies.
        hold : bool
            Whether it stands still once its first record is kept; then this waits until it does.
        **options
            The task's own.
        """
        given = [task, str(source), str(store), step, atomic, call, hold, options]
        stands = self._ask(given)
        assert stands == hold, "expected it to stand still, found it ended"

    def _ask(self, request: object) -> Any:
        assert self._server.stdin is not None
        assert self._server.stdout is not None
        self._server.stdin.write(f"{json.dumps(request)}\n")
        self._server.stdin.flush()
        return json.loads(self._server.stdout.readline())

    def wait(self) -> int:
        """Let the child go on and wait for it; return its exit code, -9 where it was killed."""
        status, calls = self._ask("wait")
        if calls is not None:
            self.calls = calls
        return int(status)

    def run(self, *arguments: Any, **named: Any) -> int:
        """Start a child and wait for it."""
        self.start(*arguments, **named)
        return self.wait()

    def end(self) -> None:
        """Kill the child that a test has left, if it has."""
        self._ask("kill")


class Child:
    """One child of the program, at its other end."""

    def __init__(self, request: list[Any]) -> None:
        self._said, say = os.pipe()
        gate, self._gate = os.pipe()
        self.number = os.fork()
        if self.number == 0:
            os.close(self._said)
            os.close(self._gate)
            _live(request, say, gate)
        os.close(say)
        os.close(gate)

    def stands_still(self) -> bool:
        """Return once it stands still, or false once it has ended instead."""
        return os.read(self._said, 1) == b"."

    def wait(self) -> tuple[int, int | None]:
        """Let it go on; return its exit code, and its calls unless it was killed."""
        os.close(self._gate)
        status = os.waitstatus_to_exitcode(os.waitpid(self.number, 0)[1])
        with open(self._said, "rb") as said:  # noqa: PTH123
            calls = said.read().lstrip(b".")
        return status, int(calls) if calls else None


def _live(request: list[Any], say: int, gate: int) -> None:
    """Do a child's task and end."""
    task, source, store, step, atomic, call, hold, options = request
    warnings.simplefilter("ignore")
    try:
        if step is not None:
            die_at_step(step, atomic)
        if hold:
            stand_still(RECORD, 0, say, gate)
        calls = count_calls(call)
        TASKS[task](Path(source), Path(store), **options)
        os.write(say, b"%d" % next(calls))
    except BaseException as error:
        print(repr(error), file=sys.stderr, flush=True)
        os._exit(1)
    os._exit(0)


def _warm_up() -> None:
    """Import what a task does, of which each child would else spend most of its time."""
    import cv2  # noqa: F401
    import jsonschema  # noqa: F401
    import numpy as np
    import zarr  # noqa: F401

    import nimprep
    import nimprep.conversion.append
    import nimprep.conversion.merge
    import nimprep.kernels.quantisation
    import nimprep.kernels.sums
    import nimprep.readers.folder
    import nimprep.readers.gmrp

    # Whoever is killed leaves what it wrote to the system.
    os.fsync = lambda descriptor: None  # type: ignore[assignment]
    camera = nimprep.Camera(fx=30.0, fy=30.0, cx=15.5, cy=11.5, width=32, height=24)
    depth = np.linspace(1, 3, 24 * 32, dtype=np.float32).reshape(24, 32)
    nimprep.estimate_normals(depth, camera, num_threads=1)
    nimprep.encode_hha(depth, camera, num_threads=1)


def _serve() -> None:
    _warm_up()
    child: Child | None = None
    for line in sys.stdin:
        request = json.loads(line)
        answer: object = None
        if isinstance(request, list):
            child = Child(request)
            answer = child.stands_still() if request[-2] else False
        elif child is not None:
            # Until somebody asks, so that a number is nobody else's as long as it may be killed.
            if request == "kill":
                os.kill(child.number, signal.SIGKILL)
            answer = child.wait()
            child = None
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    _serve()
