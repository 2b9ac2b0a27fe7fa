"""Outcomes are told apart by everyone: in grey, by a dichromat, on the tint's own colour."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest

from nimprep.evaluation.outcomes import (
    MADE_UP,
    MISSED,
    NEITHER,
    RIGHT,
    STYLES,
    draw_outcomes,
    find_outcomes,
    fit_outcomes,
)

SIZE = 96

GROUNDS = {
    "black": (0, 0, 0),
    "dark": (60, 60, 60),
    "road": (128, 128, 128),
    "bright": (210, 210, 210),
    "white": (255, 255, 255),
    "a red anomaly": (190, 30, 30),
    "pure red": (255, 0, 0),
    "grass": (40, 140, 30),
    "a blue car": (30, 40, 200),
}

# Linear sRGB as who lacks the cones sees it (Machado, Oliveira and Fernandes 2009, severity 1).
DICHROMATS = {
    "protanope": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranope": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanope": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def _seen(image: npt.NDArray[np.uint8], eyes: str) -> npt.NDArray[np.float64]:
    """Return an image as luma, 0 to 255, or as a dichromat sees it."""
    if eyes == "grey":
        return image @ np.array([0.299, 0.587, 0.114])
    value = image / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    mixed = np.clip(linear @ np.array(DICHROMATS[eyes]).T, 0, 1)
    coded = np.where(mixed <= 0.0031308, 12.92 * mixed, 1.055 * mixed ** (1 / 2.4) - 0.055)
    return 255 * coded


def _drawn(outcome: int, ground: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """Return the inside of a region of one outcome."""
    image = np.full((SIZE, SIZE, 3), ground, np.uint8)
    return draw_outcomes(image, np.full((SIZE, SIZE), outcome, np.uint8))


@pytest.mark.parametrize("eyes", ["grey", *DICHROMATS])
@pytest.mark.parametrize("ground", GROUNDS)
def test_outcomes_differ_on_every_ground_to_all_eyes(eyes: str, ground: str) -> None:
    seen = {
        outcome: _seen(_drawn(outcome, GROUNDS[ground]), eyes)
        for outcome in (NEITHER, RIGHT, MISSED, MADE_UP)
    }
    for one, other in combinations(seen, 2):
        if NEITHER in (one, other) and RIGHT in (one, other):
            continue  # Plain inside: its outline tells, below.
        difference = np.abs(seen[one] - seen[other])
        # Without stripes and dots: 16 and less between red and blue in grey.
        assert difference.mean() > 20, (one, other)
        assert np.percentile(difference, 95) > 60, (one, other)


@pytest.mark.parametrize("eyes", ["grey", *DICHROMATS])
@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("outcome", STYLES)
def test_every_region_has_an_outline_that_shows(eyes: str, ground: str, outcome: int) -> None:
    outcomes = np.zeros((SIZE, SIZE), np.uint8)
    outcomes[20:60, 30:70] = outcome
    image = np.full((SIZE, SIZE, 3), GROUNDS[ground], np.uint8)
    seen = _seen(draw_outcomes(image, outcomes), eyes)
    ring = seen[20:22, 34:66]
    # Dark beside light: one of the two differs from any ground, and they from each other.
    assert np.abs(ring[0] - ring[1]).max(axis=-1).min() > 100
    np.testing.assert_array_equal(draw_outcomes(image, outcomes)[:20], image[:20])


def test_hatches_are_stripes_and_dots_and_right_is_plain() -> None:
    grey = {o: _seen(_drawn(o, (128, 128, 128)), "grey") for o in STYLES}
    assert np.ptp(grey[RIGHT]) == 0
    # Along its diagonal a stripe does not change, a row of dots does.
    assert np.abs(grey[MISSED][1:, :-1] - grey[MISSED][:-1, 1:]).max() == 0
    assert np.abs(grey[MADE_UP][1:, :-1] - grey[MADE_UP][:-1, 1:]).max() > 60


def test_outcomes_are_found_where_pixels_count() -> None:
    predicted = np.array([[True, False, True, False, True, False]])
    actual = np.array([[True, True, False, False, True, True]])
    counted = np.array([[True, True, True, True, False, False]])
    found = find_outcomes(predicted, actual, counted)
    assert found.tolist() == [[RIGHT, MISSED, MADE_UP, NEITHER, NEITHER, NEITHER]]
    image = np.full((1, 6, 3), 100, np.uint8)
    np.testing.assert_array_equal(draw_outcomes(image, found)[0, 3:], image[0, 3:])


def test_a_smaller_picture_keeps_what_most_of_a_pixel_is_and_errors_first() -> None:
    outcomes = np.array(
        [[RIGHT, RIGHT, NEITHER, MISSED], [RIGHT, MISSED, NEITHER, MISSED]], np.uint8
    )
    assert fit_outcomes(outcomes, 1, 2).tolist() == [[RIGHT, MISSED]]
    grown = fit_outcomes(outcomes, 4, 8)
    np.testing.assert_array_equal(grown, outcomes.repeat(2, axis=0).repeat(2, axis=1))
