"""What became of a class's pixels, drawn so that no colour is needed to tell: hatch and outline.

Right is green and plain, missed red and striped, made up blue and dotted. Stripes, dots and
outlines are dark beside light, so that they show on any ground: in grey, to who is colour-blind,
and on an object that has the tint's own colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.report.pictures import Picture

Outcomes = npt.NDArray[np.uint8]
"""(H, W), what became of each pixel: `NEITHER`, `RIGHT`, `MISSED` or `MADE_UP`."""

NEITHER, RIGHT, MISSED, MADE_UP = range(4)

_LIGHT = 255
_TINT = 0.45
"""Of the colour; the rest is the photograph's."""

_PERIOD = 12
"""Pixels from stripe to stripe, and from dot to dot in a row."""


@dataclass(frozen=True)
class Style:
    """Say how an outcome is drawn, and what the legend calls it.

    Attributes
    ----------
    name : str
    tint, dark : (R, G, B)
        Of the region, and of the dark half of its stripes, dots and outline.
    """

    name: str
    tint: tuple[int, int, int]
    dark: tuple[int, int, int]


STYLES = {
    RIGHT: Style("right: green, plain (true positive)", (0, 255, 0), (0, 70, 0)),
    MISSED: Style("missed: red, striped (false negative)", (255, 0, 0), (110, 0, 0)),
    MADE_UP: Style("made up: blue, dotted (false positive)", (0, 0, 255), (0, 0, 140)),
}


def find_outcomes(
    predicted: npt.NDArray[np.bool_],
    actual: npt.NDArray[np.bool_],
    counted: npt.NDArray[np.bool_],
) -> Outcomes:
    """Return what became of each pixel.

    Parameters
    ----------
    predicted, actual, counted : (H, W) bool
        Pixels called this class, pixels that are, and pixels that take part (not ignored).
    """
    found = np.zeros(actual.shape, np.uint8)
    found[predicted & actual & counted] = RIGHT
    found[~predicted & actual & counted] = MISSED
    found[predicted & ~actual & counted] = MADE_UP
    return found


def fit_outcomes(outcomes: Outcomes, height: int, width: int) -> Outcomes:
    """Return outcomes in another size, each pixel the one that most of what it covers has.

    Where several have as much of it, errors come before what is right.
    """
    import cv2

    if outcomes.shape == (height, width):
        return outcomes
    order = (MISSED, MADE_UP, RIGHT, NEITHER)
    smaller = width < outcomes.shape[1]
    how = cv2.INTER_AREA if smaller else cv2.INTER_NEAREST
    shares = [
        cv2.resize((outcomes == one).astype(np.float32), (width, height), interpolation=how)
        for one in order
    ]
    found: Outcomes = np.array(order, np.uint8)[np.argmax(np.stack(shares), axis=0)]
    return found


def draw_outcomes(image: Picture, outcomes: Outcomes) -> Picture:
    """Draw what became of a class's pixels over a photograph.

    Parameters
    ----------
    image : (H, W, 3) uint8, R, G, B
        As large as it is looked at: stripes and outlines have a width in its pixels.
    outcomes : (H, W) uint8
    """
    drawn = image.astype(np.float32)
    v, u = np.indices(outcomes.shape)
    stripe = (u + v) % _PERIOD
    row = v // (_PERIOD // 2)
    # Every other row of dots is shifted by half a period.
    across = (u + (row % 2) * (_PERIOD // 2)) % _PERIOD
    down = v % (_PERIOD // 2)
    marks = {
        MISSED: (stripe < 2, (stripe >= 2) & (stripe < 4)),
        MADE_UP: (
            (across < 5) & (down < 5),
            (across >= 1) & (across < 4) & (down >= 1) & (down < 4),
        ),
    }
    for outcome, style in STYLES.items():
        region = outcomes == outcome
        drawn[region] = (1 - _TINT) * drawn[region] + _TINT * np.array(style.tint, np.float32)
        if outcome in marks:
            dark, light = marks[outcome]
            drawn[region & dark] = style.dark
            drawn[region & light] = _LIGHT
    for outcome, style in STYLES.items():
        outer, inner = _outlines(outcomes == outcome)
        drawn[inner] = _LIGHT
        drawn[outer] = style.dark
    return np.asarray(np.rint(drawn), dtype=np.uint8)


def _outlines(region: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], ...]:
    """Return a region's outermost pixels and those just inside; the image's edge is none."""
    import cv2

    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    # Beyond the image counts as region, so that it has no outline there.
    once, twice = (
        np.asarray(cv2.erode(region.astype(np.uint8), cross, iterations=n, borderValue=1)) > 0
        for n in (1, 2)
    )
    return region & ~once, once & ~twice


def outcome_sample(outcome: int, size: tuple[int, int] = (36, 60)) -> Picture:
    """Return a patch of an outcome on grey, as the legend shows it."""
    outcomes = np.zeros((size[0] + 6, size[1] + 6), np.uint8)
    outcomes[3:-3, 3:-3] = outcome
    grey = np.full((*outcomes.shape, 3), 150, np.uint8)
    return draw_outcomes(grey, outcomes)[3:-3, 3:-3]
