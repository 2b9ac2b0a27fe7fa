"""Signs in the directions of gravity that frames were given: they turn within a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nimprep.doubts.judge import Doubt

GRAVITY_KINDS = frozenset({"gravity-turns"})

TURNS_DEG = 10.0
"""A vehicle on a road hardly leans so far; a camera in the hand does."""


def gravity_doubts(
    ids: Sequence[str],
    groups: Sequence[str],
    gravity: npt.NDArray[np.float64],
    given: npt.NDArray[np.bool_],
) -> list[Doubt]:
    """Return what is doubted of given directions of gravity.

    Parameters
    ----------
    ids, groups : sequence of str
        The frames, and the recording that each belongs to; those of "" count as one.
    gravity : (N, 3) float64
        Unit vectors.
    given : (N,) bool
        Whether a frame's was given; others are not asked.
    """
    of_group: dict[str, list[int]] = {}
    for number in np.flatnonzero(given).tolist():
        of_group.setdefault(groups[number], []).append(number)
    turns = {group: _turn_deg(gravity[numbers]) for group, numbers in of_group.items()}
    turning = [group for group, degrees in turns.items() if degrees > TURNS_DEG]
    if not turning:
        return []
    most = max(turning, key=lambda group: turns[group])
    where = f"the recording {most!r}" if most else "the recording"
    text = (
        f"the gravity given turns by {turns[most]:.0f} degrees within {where}; if the camera does "
        "not, check the axes and the sign of its list (an accelerometer points up at rest, and "
        "wherever it is pushed), and its times"
    )
    return [Doubt.of("gravity-turns", text, [ids[n] for group in turning for n in of_group[group]])]


def _turn_deg(gravity: npt.NDArray[np.float64]) -> float:
    """Return the angle between the two that are farthest apart, nearly: from one to the other."""
    start = gravity[0]
    for _ in range(3):
        cosines = gravity @ start
        start = gravity[int(cosines.argmin())]
    return float(np.degrees(np.arccos(np.clip(cosines.min(), -1, 1))))
