"""A command of nimprep's that stands still at a point of its code for as long as a test wants.

Both sides wait for each other by pipes, so no test has to be quicker than the command is. Run as a
program it takes the point, how many calls to let pass, two descriptors and the command.
"""

from __future__ import annotations

import functools
import importlib
import itertools
import os
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tests.processes import PATIENCE_S, Processes, same_code

RECORD = "nimprep.conversion.journal:Journal.record"
"""A unit's shards are written and its record is kept."""


@contextmanager
def held(
    processes: Processes, point: str, *command: object, let_pass: int = 0
) -> Iterator[subprocess.Popen[str]]:
    """Start a command and give it once it stands still; it goes on when the context ends.

    Parameters
    ----------
    point : str
        The function after whose call it stands still, as ``module:Class.method``.
    *command
        nimprep's arguments.
    let_pass : int
        Calls that come before.
    """
    arrived, arrive = os.pipe()
    gate, open_gate = os.pipe()
    process = processes.start(
        [sys.executable, "-m", "tests.held", point, let_pass, arrive, gate, *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=same_code(),
        pass_fds=(arrive, gate),
    )
    os.close(arrive)
    os.close(gate)
    try:
        _await(arrived, process)
        yield process
    finally:
        os.close(open_gate)
        os.close(arrived)


def _await(arrived: int, process: subprocess.Popen[str]) -> None:
    """Return when a process says that it stands still; fail where it never will."""
    within, _, _ = select.select([arrived], [], [], PATIENCE_S)
    if not within or os.read(arrived, 1) != b".":
        # Not pipes that somebody else may hold open: what it has said by now is enough.
        process.kill()
        said = process.communicate()
        raise AssertionError(f"expected the command to stand still, found it ended: {said}")


def stand_still(point: str, let_pass: int, arrive: int, gate: int) -> None:
    """Let this process say so and stand still after a call, until the gate's other end closes."""
    module, _, name = point.partition(":")
    *path, last = name.split(".")
    owner: Any = functools.reduce(getattr, path, importlib.import_module(module))
    function = getattr(owner, last)
    calls = itertools.count()

    @functools.wraps(function)
    def run(*arguments: Any, **named: Any) -> Any:
        result = function(*arguments, **named)
        if next(calls) == let_pass:
            os.write(arrive, b".")
            os.read(gate, 1)  # nothing ever comes
        return result

    setattr(owner, last, run)


def _main() -> None:
    point, let_pass, arrive, gate, *command = sys.argv[1:]
    stand_still(point, int(let_pass), int(arrive), int(gate))
    from nimprep.cli import main

    main(command, prog_name="nimprep")


if __name__ == "__main__":
    _main()
