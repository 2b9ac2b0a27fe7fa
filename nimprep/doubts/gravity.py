"""Signs in the directions of gravity that frames were given: they turn, or point up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nimprep.doubts.judge import Doubt

GRAVITY_KINDS = frozenset({"gravity-turns", "gravity-up"})

TURNS_DEG = 10.0
"""A vehicle on a road hardly leans so far; a camera in the hand does."""

UPWARDS = 0.5
"""Of a unit vector: what points less than 30 degrees above the horizon may be of a camera that
looks straight down or lies on its side."""


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
    return [*_turning(ids, groups, gravity, given), *_pointing_up(ids, gravity, given)]


def _pointing_up(
    ids: Sequence[str], gravity: npt.NDArray[np.float64], given: npt.NDArray[np.bool_]
) -> list[Doubt]:
    up = np.flatnonzero(given & (gravity[:, 1] < -UPWARDS))
    # Of a camera in the hand some may be so; of a wrong sign all are.
    if 2 * up.size <= np.count_nonzero(given):
        return []
    text = (
        "the gravity given points to the images' upper edge, as of a camera that hangs upside "
        "down; if it does not, the sign is wrong: gravity points down, and what an accelerometer "
        'measures at rest points up ("values": "acceleration")'
    )
    return [Doubt.of("gravity-up", text, [ids[number] for number in up.tolist()])]


def _turning(
    ids: Sequence[str],
    groups: Sequence[str],
    gravity: npt.NDArray[np.float64],
    given: npt.NDArray[np.bool_],
) -> list[Doubt]:
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
