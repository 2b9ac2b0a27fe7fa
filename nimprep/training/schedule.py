"""How the learning rate goes through a training."""

from __future__ import annotations

import math
from typing import Any

from nimprep.training.options import TrainOptions


class Schedule:
    """Say by what the learning rate is multiplied at each step.

    It is a function of the step alone, but for "plateau", which looks at the scores.

    Parameters
    ----------
    options : TrainOptions
        Completed by a recipe.
    steps : int
        Of one epoch.
    """

    def __init__(self, options: TrainOptions, steps: int) -> None:
        self._kind = options.schedule
        self._gamma = float(options.gamma or 0)
        self._period = int(options.period or 1)
        self._power = float(options.power or 0)
        self._warmup = options.warmup * steps
        self._steps = steps
        self._total = options.epochs * steps
        self._plateau: dict[str, float] = {"factor": 1.0, "best": -math.inf, "since": 0}

    def factor(self, step: int) -> float:
        """Return the factor of a step, counted from 0."""
        rising = min(1.0, (step + 1) / self._warmup) if self._warmup > 0 else 1.0
        return rising * self._falling(step)

    def _falling(self, step: int) -> float:
        epoch, done = step // self._steps, step / self._total
        match self._kind:
            case "exponential":
                return float(self._gamma**epoch)
            case "step":
                return float(self._gamma ** (epoch // self._period))
            case "poly":
                return float((1 - done) ** self._power)
            case "cosine":
                return (1 + math.cos(math.pi * done)) / 2
            case "plateau":
                return self._plateau["factor"]
        return 1.0

    def end_epoch(self, score: float) -> None:
        """Take an epoch's score, of which more is better; NaN is no better."""
        state = self._plateau
        if score > state["best"]:
            state["best"], state["since"] = score, 0
            return
        state["since"] += 1
        if state["since"] >= self._period:
            state["factor"] *= self._gamma
            state["since"] = 0

    def state_dict(self) -> dict[str, Any]:
        """Return what is not a function of the step."""
        return dict(self._plateau)

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from such a state."""
        self._plateau = dict(state)
