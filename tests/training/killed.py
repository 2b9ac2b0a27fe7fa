"""A training in children that are killed where their code has come to, each started at once.

Run as a program with a store and a folder: trains there once undisturbed, and once killed at each
of `KILLS`, one after the other, and then to the end. It prints the children's exit codes.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.training.stores import SMALL

OPTIONS: dict[str, Any] = {
    **SMALL,
    "network": "fusenet",
    "setup": "nim-rgb+d",
    "epochs": 6,
    "lr": 0.02,
    "checkpoint_steps": 3,
    "batch": 1,
    "log_steps": 1,
    "schedule": "plateau",
    "period": 1,
    "gamma": 0.5,
    "scale": (0.8, 1.4),
}
"""Dropout, augmentation, momentum and a schedule that looks back: all that a run has to keep."""

KILLS = [
    ("nimprep.training.loop:save_checkpoint", 1),
    ("nimprep.training.loop:Loop._step", 2),
    ("nimprep.training.loop:Loop._step", 4),
    ("nimprep.training.state:save_whole", 1),
    ("nimprep.training.precision:Precision.step", 3),
    ("nimprep.training.loop:score_split", 1),
    ("nimprep.training.log:Log.write", 6),
    ("torch:save", 2),
    ("nimprep.files:_settle", 3),
    ("nimprep.training.loop:Loop._keep", 3),
]
"""Functions, and before which of their calls in its life a child dies."""


def die_before(place: str, number: int) -> None:
    """Kill this process before the so-manieth call of a function."""
    module, _, name = place.partition(":")
    *owners, name = name.split(".")
    owner: Any = import_module(module)
    for part in owners:
        owner = getattr(owner, part)
    function: Callable[..., Any] = getattr(owner, name)
    calls = 0

    def counted(*arguments: Any, **named: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*arguments, **named)

    setattr(owner, name, counted)


def run_child(store: Path, out: Path, kill: tuple[str, int] | None) -> int:
    """Train in a child, and return its exit code."""
    child = os.fork()
    if child == 0:
        try:
            if kill is not None:
                die_before(*kill)
            from nimprep.training import train

            train(store, out, **OPTIONS)
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main(store: Path, out: Path) -> None:
    """Train in children."""
    import torch

    import nimprep.training.run  # noqa: F401 - once, not in every child

    torch.set_num_threads(1)
    # Whoever is killed leaves what it wrote to the system.
    os.fsync = lambda descriptor: None  # type: ignore[assignment]
    codes = [run_child(store, out / "undisturbed", None)]
    codes += [run_child(store, out / "killed", kill) for kill in KILLS]
    codes += [run_child(store, out / "killed", None)]
    print(*codes)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
