"""Which unit a store's depth is in: how it is said, and which one a dataset needs."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep.depth_unit import (
    ChosenUnit,
    DepthNumbers,
    chosen_unit,
    counts_in,
    depth_unit_from,
    unit_for,
    unit_words,
)
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.store.frames import depth_to_integers, from_integers, to_integers

UNITS = [0.0001, 0.0002, 0.001, 0.002, 1 / 256, 0.005, 0.01, 1000 / 65535, 0.1, 1.0]


@pytest.mark.parametrize(
    ("said", "unit_m"),
    [
        ("auto", "auto"),
        ("mm", 0.001),
        ("cm", 0.01),
        ("1/256", 1 / 256),
        ("0.00390625", 1 / 256),
        (0.00390625, 1 / 256),
        ("0.005", 0.005),
        (np.float64(0.01), 0.01),
        (1, 1.0),
        (0.3333333, 1 / 3),
    ],
)
def test_a_unit_is_said_by_name_number_or_fraction(said: object, unit_m: object) -> None:
    assert depth_unit_from(said) == unit_m


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ("m", "expected auto, mm, cm or metres .* found 'm'"),
        ("1/0", "found '1/0'"),
        ("1/2/3", "found '1/2/3'"),
        ("nan", "found 'nan'"),
        ("inf", "found 'inf'"),
        (True, "found True"),
        (None, "found None"),
        (256, "expected 0.0001 to 1 m, found 256; give metres per unit: 0.00390625, not 256"),
        ("1000", "give metres per unit: 0.001, not 1000"),
        (0, "expected 0.0001 to 1 m, found 0"),
        (-0.001, "expected 0.0001 to 1 m, found -0.001"),
        ("1e-5", "expected 0.0001 to 1 m, found 1e-5"),
    ],
)
def test_what_is_no_unit_is_refused(said: object, words: str) -> None:
    with pytest.raises(ArrayError, match=f"^depth_unit: .*{words}"):
        depth_unit_from(said)


@pytest.mark.parametrize(
    ("most_m", "unit_m"),
    [
        (0, 0.001),
        (65.535, 0.001),
        (65.6, 0.002),
        (131.07, 0.002),
        (200, 0.005),
        (655.35, 0.01),
        (656, 0.02),
        (60000, 1.0),
        (1e9, 1.0),
    ],
)
def test_the_unit_for_a_range_is_the_finest_that_reaches(most_m: float, unit_m: float) -> None:
    assert unit_for(most_m) == unit_m


MM = ChosenUnit(0.001, False)


@pytest.mark.parametrize(
    ("source", "chosen"),
    [
        # GMRP, KITTI road, floats and disparity of which nobody says how far they go.
        (DepthNumbers(), MM),
        # TUM's finer steps.
        (DepthNumbers(step_m=0.0002, exact=True), MM),
        (DepthNumbers(step_m=0.001, exact=True, most_m=65.535), MM),
        # ORFD's and Virtual KITTI's: exact, whatever of it is bounded.
        (DepthNumbers(step_m=1 / 256, exact=True), ChosenUnit(1 / 256, False)),
        (DepthNumbers(step_m=0.01, exact=True), ChosenUnit(0.01, False)),
        (DepthNumbers(step_m=0.01, exact=True, most_m=80), ChosenUnit(0.01, False)),
        # CARLA's far plane in 16 bits.
        (DepthNumbers(step_m=1000 / 65535, exact=True), ChosenUnit(1000 / 65535, False)),
        # Along rays, or from another camera.
        (DepthNumbers(step_m=0.01), ChosenUnit(0.01, True)),
        # Fine numbers that are said to go far.
        (DepthNumbers(most_m=80), ChosenUnit(0.002, True)),
        (DepthNumbers(most_m=655), ChosenUnit(0.01, True)),
        # No unit, but a mistake.
        (DepthNumbers(step_m=9.0, exact=True), MM),
    ],
)
def test_auto_is_a_millimetre_unless_the_source_says_otherwise(
    source: DepthNumbers, chosen: ChosenUnit
) -> None:
    assert chosen_unit("auto", source) == chosen
    assert chosen_unit(0.001, source) == MM


def test_a_unit_that_is_given_is_taken_and_told_whether_it_rounds() -> None:
    orfd = DepthNumbers(step_m=1 / 256, exact=True)
    assert chosen_unit(0.01, orfd) == ChosenUnit(0.01, True)
    assert chosen_unit(1 / 256, orfd) == ChosenUnit(1 / 256, False)
    # Finer than a millimetre: rounded less than ever, and made again of what is stored.
    assert chosen_unit(0.0002, DepthNumbers()) == ChosenUnit(0.0002, False)
    assert counts_in(DepthNumbers(step_m=0.02, exact=True), 0.01)
    assert not counts_in(DepthNumbers(step_m=0.01, exact=True), 0.02)


@pytest.mark.parametrize(
    ("unit_m", "words"),
    [
        (0.001, "1 mm"),
        (0.0002, "0.2 mm"),
        (0.005, "5 mm"),
        (0.01, "1 cm"),
        (0.05, "5 cm"),
        (1 / 256, "1/256 m"),
        (1.0, "1 m"),
        (1000 / 65535, "0.015259 m"),
    ],
)
def test_units_are_said_as_people_do(unit_m: float, words: str) -> None:
    assert unit_words(unit_m) == words


@pytest.mark.parametrize("unit_m", UNITS)
def test_depth_is_stored_to_half_a_unit_and_read_as_the_multiple_nearest_to_it(
    unit_m: float,
) -> None:
    held = MODALITIES["depth"].as_unit(unit_m)
    assert held.step == pytest.approx(unit_m, rel=1e-15)
    assert held.most == pytest.approx(65535 * unit_m, rel=1e-12)
    rng = np.random.default_rng(0)
    depth_m = (rng.uniform(1, 65535, (40, 50)) * unit_m).astype(np.float32)
    stored, lost = depth_to_integers(held, depth_m)
    assert lost == 0
    # float32 itself is 4e-8 of a depth off.
    assert np.abs(stored * unit_m - depth_m.astype(np.float64)).max() <= unit_m * 0.5 * 1.02
    again = from_integers(held, stored)
    np.testing.assert_allclose(again, stored * unit_m, rtol=1.2e-7, atol=0)
    assert np.array_equal(to_integers(held, again), stored)


@pytest.mark.parametrize("unit_m", UNITS)
def test_every_integer_survives_being_read_and_written(unit_m: float) -> None:
    held = MODALITIES["depth"].as_unit(unit_m)
    every = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    again, lost = depth_to_integers(held, from_integers(held, every))
    assert lost == 0
    assert np.array_equal(again, every)


def test_what_is_too_far_or_too_near_is_none_and_counted() -> None:
    held = MODALITIES["depth"].as_unit(0.01)
    # The ends are 655.35 m and half a centimetre.
    depth_m = np.array([[0, 0.004, 0.0051, 655.35, 655.354, 655.36, 1e30]], np.float32)
    stored, lost = depth_to_integers(held, depth_m)
    assert stored.tolist() == [[0, 0, 1, 65535, 65535, 0, 0]]
    assert lost == 3


def test_other_modalities_have_no_unit_of_their_own() -> None:
    for modality in MODALITIES.values():
        if not modality.own_unit:
            assert modality.as_unit(0.01) is modality
            assert not modality.has_other_unit
    depth = MODALITIES["depth"]
    assert depth.as_unit(None) is depth
    assert depth.as_unit(0.001) == depth
    assert depth.as_unit(0.01).has_other_unit
