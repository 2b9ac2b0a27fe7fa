"""What a training says as it goes: lines of JSON, TensorBoard, and to whoever watches."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from nimprep.errors import ArrayError, LayoutError
from nimprep.folders import told

LOG = "log.jsonl"
TENSORBOARD = "tensorboard"
"""Names within a run's folder."""


class Watcher(Protocol):
    """Be told how a training goes on; all numbers count from 1."""

    def begin(self, done: int, steps: int) -> None:
        """Take how many steps are done already, of how many."""

    def step(self, number: int, loss: float) -> None:
        """Take a step's loss."""

    def epoch(self, line: Mapping[str, Any], seconds_left: float) -> None:
        """Take what the log says of an epoch."""

    def say(self, text: str) -> None:
        """Take a sentence for the person who waits."""

    def end(self) -> None:
        """No more is to come, after an error too."""


class Silence:
    """Watch, and say nothing."""

    def begin(self, done: int, steps: int) -> None:
        """Take how many steps are done already."""

    def step(self, number: int, loss: float) -> None:
        """Take a step's loss."""

    def epoch(self, line: Mapping[str, Any], seconds_left: float) -> None:
        """Take an epoch's line."""

    def say(self, text: str) -> None:
        """Take a sentence."""

    def end(self) -> None:
        """No more is to come."""


class Log:
    """Write a run's log: a line of JSON for each so many steps, and for each epoch.

    Parameters
    ----------
    folder : Path
    length : int
        Bytes of it that stand: what is behind them tells of steps that a kill took back.
    tensorboard : bool
        Whether TensorBoard gets the same numbers.
    step : int
        The steps that are done.
    """

    def __init__(self, folder: Path, length: int, tensorboard: bool, step: int) -> None:
        self._path = folder / LOG
        with told(self._path, LayoutError):
            folder.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("ab")
            self._file.truncate(min(length, self._path.stat().st_size))
        self._board = _board(folder / TENSORBOARD, step) if tensorboard else None

    @property
    def length(self) -> int:
        """Bytes written."""
        return self._path.stat().st_size

    def write(self, line: Mapping[str, Any]) -> None:
        """Write a line; "step" is one of its keys."""
        with told(self._path, LayoutError):
            self._file.write(json.dumps(line).encode() + b"\n")
            self._file.flush()
        if self._board is not None:
            # A step's and an epoch's loss are two curves.
            shown = {n: v for n, v in line.items() if n not in ("epoch", "time", "step")}
            if "epoch" in line:
                shown = {"val": shown.pop("val") or {}, "epoch": shown}
            for name, value in _scalars("", shown):
                self._board.add_scalar(name, value, line["step"])

    def close(self) -> None:
        """End it."""
        self._file.close()
        if self._board is not None:
            self._board.close()


def _scalars(prefix: str, line: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return the numbers in a line, named by their place."""
    found: list[tuple[str, float]] = []
    for name, value in line.items():
        if isinstance(value, Mapping):
            found += _scalars(f"{prefix}{name}/", value)
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            found.append((f"{prefix}{name}", float(value)))
    return found


def check_tensorboard(asked: bool) -> None:
    """Raise `ArrayError` where TensorBoard is asked for and not installed."""
    if asked and find_spec("tensorboard") is None:
        raise ArrayError(
            "tensorboard: expected TensorBoard, found none installed; pip install "
            "'nimprep[tensorboard]'"
        )


def _board(folder: Path, step: int) -> Any:
    from torch.utils.tensorboard import SummaryWriter

    writer: Any = SummaryWriter(str(folder), purge_step=step + 1)
    return writer
