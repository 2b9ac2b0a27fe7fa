"""How a training is shown: a bar to a person, plain lines where nobody looks at a terminal."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from typing import Any

from nimprep.cli.echo import echo

_EVERY_S = 30
"""Seconds between lines where there is no terminal."""


class _Lines:
    """Print a line now and then, and one for each epoch."""

    def __init__(self) -> None:
        self._done = self._first = self._steps = 0
        self._began = self._said = time.monotonic()

    def begin(self, done: int, steps: int) -> None:
        """Take how many steps are done already, of how many."""
        self._done, self._first, self._steps = done, done, steps
        self._began = self._said = time.monotonic()

    def step(self, number: int, loss: float) -> None:
        """Say a step's loss, not more often than every half minute."""
        self._done = number
        now = time.monotonic()
        if now - self._said >= _EVERY_S:
            self._said = now
            left = (now - self._began) / (number - self._first) * (self._steps - number)
            self._write(f"step {number}/{self._steps}: loss {loss:.4f}, {_duration(left)} left")

    def epoch(self, line: Mapping[str, Any], seconds_left: float) -> None:
        """Say an epoch's figures."""
        parts = [f"epoch {line['epoch']}: loss {line['loss']:.4f}"]
        for name, said in (("iou", "IoU"), ("f_score", "F-score")):
            value = (line["val"] or {}).get(name)
            parts += [] if value is None else [f"{said} {100 * value:.2f}"]
        parts += ["best so far"] if line["best"] and line["val"] else []
        parts += [f"{_duration(seconds_left)} left"] if self._done < self._steps else []
        self._said = time.monotonic()
        self._write(", ".join(parts))

    def say(self, text: str) -> None:
        """Say a sentence."""
        self._write(text)

    def end(self) -> None:
        """No more is to come."""

    def _write(self, text: str) -> None:
        echo(text, err=True)


class _Bar(_Lines):
    """Draw a bar, above which the lines stand."""

    def __init__(self) -> None:
        super().__init__()
        self._bar: Any = None
        self._scores = ""

    def begin(self, done: int, steps: int) -> None:
        """Begin the bar where the run stands."""
        from tqdm import tqdm

        super().begin(done, steps)
        self._bar = tqdm(
            total=steps, initial=done, unit="step", file=sys.stderr, dynamic_ncols=True
        )

    def step(self, number: int, loss: float) -> None:
        """Move the bar, and show the loss."""
        self._done = number
        self._bar.set_postfix_str(f"loss {loss:.4f}{self._scores}", refresh=False)
        self._bar.update()

    def epoch(self, line: Mapping[str, Any], seconds_left: float) -> None:
        """Print an epoch's line, and show its IoU from now on."""
        iou = (line["val"] or {}).get("iou")
        self._scores = "" if iou is None else f", IoU {100 * iou:.2f}"
        super().epoch(line, seconds_left)

    def end(self) -> None:
        """Leave the bar as it stands."""
        if self._bar is not None:
            self._bar.close()

    def _write(self, text: str) -> None:
        if self._bar is not None:
            self._bar.clear()
        echo(text, err=True)
        if self._bar is not None:
            self._bar.refresh()


class _Quiet(_Lines):
    """Say what a person might take for granted and is not, and nothing else."""

    def step(self, number: int, loss: float) -> None:
        """Take a step's loss."""

    def epoch(self, line: Mapping[str, Any], seconds_left: float) -> None:
        """Take an epoch's figures."""


def watcher_for(quiet: bool) -> _Lines:
    """Return what shows a training on stderr."""
    if quiet:
        return _Quiet()
    # Of several processes' bars none could be read.
    alone = os.environ.get("WORLD_SIZE", "1") == "1"
    return _Bar() if alone and sys.stderr.isatty() else _Lines()


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"
