"""What one step of a store's depth is, metres: how it is said, and which one a dataset needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Literal

from nimprep.errors import ArrayError

MILLIMETRE = 0.001
"""The unit of a store that needs no other."""

MOST_STEPS = 65535
"""The greatest number of steps: depth is stored in 16 bits, 0 = none."""

NAMED_UNITS = {"mm": MILLIMETRE, "cm": 0.01}

LEAST_UNIT_M, MOST_UNIT_M = 0.0001, 1.0
"""Finer steps end at 6.5 m and less, coarser ones are no depth."""

_MOST_STEP_M = 0.1
"""A source of coarser steps has none of its own: their unit is a mistake."""

DepthUnit = float | Literal["auto"]


@dataclass(frozen=True)
class DepthNumbers:
    """Say what is known of a dataset's depth before a frame of it is decoded.

    Attributes
    ----------
    step_m : float, optional
        What one of its whole numbers counts, metres; None = they are no whole numbers, or no
        metres.
    exact : bool
        Whether every depth is a multiple of that: as the numbers are, and not along rays, warped
        from another camera, or moved by a part of a step.
    most_m : float, optional
        The farthest depth that counts, where somebody says so, metres.
    certain : bool
        Whether the unit is beyond doubt, as where the reader measures depth itself.
    """

    step_m: float | None = None
    exact: bool = False
    most_m: float | None = None
    certain: bool = False


@dataclass(frozen=True)
class ChosenUnit:
    """Say in which unit depth is stored.

    Attributes
    ----------
    unit_m : float
    rounded : bool
        Whether the unit is coarser than a millimetre and than what the source says, so that what
        is derived is made of depth before it is rounded.
    """

    unit_m: float = MILLIMETRE
    rounded: bool = False


UNKNOWN_NUMBERS = DepthNumbers()

MILLIMETRES = ChosenUnit()


def steps_per_metre(unit_m: float) -> float:
    """Return how many units a metre has, a whole number where it is one."""
    steps = round(1 / unit_m)
    return steps if steps > 0 and abs(1 / unit_m - steps) < 1e-6 * steps else 1 / unit_m


def neat_unit(unit_m: float) -> float:
    """Return a unit as the part of a metre that it is meant to be: 1/3 for 0.33333333."""
    steps = steps_per_metre(unit_m)
    return 1 / steps if isinstance(steps, int) else unit_m


def depth_unit_from(said: object) -> DepthUnit:
    """Return a depth unit as metres, or "auto", from "auto", "mm", "cm", "1/256" or a number.

    Raises
    ------
    ArrayError
        It is none of these, or no unit of depth.
    """
    if said == "auto":
        return "auto"
    unit_m = _metres(said)
    if unit_m is None or not math.isfinite(unit_m):
        raise ArrayError(
            "depth_unit: expected auto, mm, cm or metres as a number or a fraction (0.005, 1/256), "
            f"found {said!r}; give one of these"
        )
    if not LEAST_UNIT_M <= unit_m <= MOST_UNIT_M:
        # As programs have it that count units per metre.
        inverse = 1 / unit_m if unit_m else 0
        step = f"; give metres per unit: {inverse:g}, not {unit_m:g}" if unit_m > 1 else ""
        raise ArrayError(
            f"depth_unit: expected {LEAST_UNIT_M:g} to {MOST_UNIT_M:g} m, found {said}{step}"
        )
    return neat_unit(unit_m)


def _metres(said: object) -> float | None:
    if isinstance(said, str):
        if said in NAMED_UNITS:
            return NAMED_UNITS[said]
        above, slash, below = said.partition("/")
        try:
            return float(above) / float(below) if slash else float(said)
        except (ValueError, ZeroDivisionError):
            return None
    return float(said) if isinstance(said, Real) and not isinstance(said, bool) else None


def unit_words(unit_m: float) -> str:
    """Return a unit as people say it: 1 mm, 5 mm, 1 cm, 1/256 m."""
    for scale, name in ((0.001, "mm"), (0.01, "cm"), (1.0, "m")):
        number = unit_m / scale
        if number < 100 and abs(number - round(number, 1)) < 1e-9 * number and number < 10:
            return f"{round(number, 1):g} {name}"
    steps = steps_per_metre(unit_m)
    return f"1/{steps} m" if isinstance(steps, int) else f"{unit_m:.6g} m"


def unit_for(most_m: float) -> float:
    """Return the finest of 1, 2 and 5 mm, 1, 2 and 5 cm, and so on that reaches so far."""
    for exponent in range(4):
        for first in (1, 2, 5):
            unit_m = first * int(10**exponent) / 1000
            if unit_m <= MOST_UNIT_M and most_m <= unit_m * MOST_STEPS:
                return unit_m
    return MOST_UNIT_M


def chosen_unit(asked: DepthUnit, source: DepthNumbers) -> ChosenUnit:
    """Return the unit in which a dataset's depth is stored.

    ``"auto"`` is a millimetre, unless the source's own step is coarser, which then is the unit; or,
    where it has no such step, depth is said to count beyond what 16 bits of a millimetre hold:
    then it is the finest of `unit_for`. None of it depends on what a frame holds.
    """
    step_m = source.step_m
    if asked != "auto":
        unit_m = asked
    elif step_m is not None and MILLIMETRE < step_m <= _MOST_STEP_M:
        unit_m = neat_unit(step_m)
    else:
        unit_m = unit_for(source.most_m or 0)
    return ChosenUnit(unit_m, unit_m > MILLIMETRE and not counts_in(source, unit_m))


def counts_in(source: DepthNumbers, unit_m: float) -> bool:
    """Tell whether each of a dataset's depths is a multiple of a unit."""
    if not source.exact or source.step_m is None:
        return False
    times = source.step_m / unit_m
    return round(times) > 0 and abs(times - round(times)) < 1e-6 * times
