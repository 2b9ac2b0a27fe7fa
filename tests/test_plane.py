"""Planes that a dataset describes: their records, and numbers as integers and back."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from nimprep.errors import ArrayError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES
from nimprep.plane import (
    DTYPES,
    TAKEN,
    by_name,
    definition_of,
    from_plane,
    plane_from,
    to_plane,
)
from nimprep.store.spec import image_spec
from nimprep.store.table_specs import table_specs
from nimprep.torch.views import VIEWS
from tests.thermal import CONFIDENCE, PLANES, THERMAL, degrees, raw_thermal


def test_no_plane_may_have_a_name_that_a_store_a_frame_or_a_sample_has() -> None:
    specs = [*table_specs().values(), *(image_spec(m, ()) for m in MODALITIES.values())]
    taken = {*table_specs(), *(dim for spec in specs for dim in spec.dims)}
    taken |= {f.name for f in fields(Frame)} | {m.attribute for m in MODALITIES.values()}
    taken |= {name for name in VIEWS if name.isidentifier()}
    assert taken - {""} <= TAKEN | MODALITIES.keys()
    for name in ("split", "rgb", "x", "mask", "depth_m", "Thermal", "a-b", "", "9a", "a" * 33):
        with pytest.raises(ArrayError, match=r"expected a name of .*; choose another"):
            plane_from(name, CONFIDENCE)


def test_what_a_store_says_of_a_plane_makes_the_same_plane() -> None:
    assert definition_of(PLANES[0]) == THERMAL
    for name, given in (("thermal", THERMAL), ("confidence", CONFIDENCE)):
        plane = plane_from(name, given)
        assert plane_from(name, definition_of(plane)) == plane
    assert [*by_name(PLANES)] == ["confidence", "thermal"]
    with pytest.raises(ArrayError, match="expected it once, found it twice"):
        by_name((PLANES[0], PLANES[0]))


@pytest.mark.parametrize("dtype", DTYPES)
def test_every_integer_comes_back_from_its_number(dtype: str) -> None:
    limits = np.iinfo(dtype)
    every = np.arange(limits.min, limits.max + 1).astype(dtype).reshape(2, -1)
    for scale, offset, fill in ((0.01, -273.15, 0), (3.7, 1e3, None), (1, 0, limits.max)):
        plane = plane_from("a", {"dtype": dtype, "scale": scale, "offset": offset, "fill": fill})
        numbers = from_plane(plane, every)
        expected = (every.astype(np.float64) * scale + offset).astype(np.float32)
        none = np.zeros_like(every, bool) if fill is None else every == fill
        assert np.array_equal(numbers, np.where(none, np.nan, expected), equal_nan=True)
        assert np.array_equal(to_plane(plane, numbers), every)


def test_plain_bytes_stay_what_they_are() -> None:
    plane, image = plane_from("a", CONFIDENCE), np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert plane.is_plain
    assert plane.blank((2, 3)).dtype == np.uint8
    assert np.array_equal(from_plane(plane, to_plane(plane, image)), image)
    assert to_plane(plane, image.astype(np.float32)).dtype == np.uint8


def test_a_number_that_rounds_to_what_means_none_stays_a_number() -> None:
    plane = plane_from("a", {"dtype": "uint8", "scale": 0.5, "fill": 0})
    image = np.array([[0.1, np.nan, 0.5]], np.float32)
    assert to_plane(plane, image).tolist() == [[1, 0, 1]]
    last = plane_from("a", {"dtype": "uint8", "fill": 255})
    assert to_plane(last, np.array([[255, np.nan]])).tolist() == [[254, 255]]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"dtype": "uint32"}, "expected a dtype of uint8"),
        ({}, "expected a dtype of uint8"),
        ({"dtype": "uint8", "fill": 256}, "expected a fill from 0 to 255"),
        ({"dtype": "uint8", "fill": True}, "expected a fill"),
        ({"dtype": "uint8", "scale": 0}, "expected a scale from"),
        ({"dtype": "uint8", "scale": float("nan")}, "expected a scale from"),
        ({"dtype": "uint8", "offset": 10**400}, "expected a scale from"),
        ({"dtype": "uint8", "offset": "1"}, "expected a scale from"),
        ({"dtype": "uint16", "scale": 1e-4, "offset": 1e4}, "steps that float32 can tell apart"),
        ({"dtype": "uint8", "resize": "cubic"}, "expected resize"),
        ({"dtype": "uint8", "units": "m" * 33}, "expected units of at most 32"),
    ],
)
def test_a_definition_that_describes_no_plane_is_refused(given: Any, words: str) -> None:
    with pytest.raises(ArrayError, match=words):
        plane_from("thermal", given)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (np.full((2, 3), 400.0), "expected -273.15 to 382.2, which uint16 holds"),
        (np.full((2, 3), np.inf), "found inf"),
        (np.zeros((2, 3, 1)), "expected numbers"),
        (np.zeros((2, 3), bool), "expected numbers"),
    ],
)
def test_an_image_that_the_integers_cannot_say_is_refused(image: Any, words: str) -> None:
    with pytest.raises(ArrayError, match=words):
        to_plane(PLANES[0], image)


def test_where_no_integer_means_none_there_must_be_a_number() -> None:
    with pytest.raises(ArrayError, match="expected a number in every pixel, found 1 of NaN"):
        to_plane(PLANES[1], np.array([[1.0, np.nan]]))


def test_a_frame_gives_a_plane_by_its_name_and_a_mask_as_none() -> None:
    from nimprep.camera import Camera

    values = degrees(raw_thermal(0, (2, 5)))
    masked = np.ma.masked_invalid(values)
    frame = Frame("a", Camera(9, 9, 1, 1, 5, 2), others={"thermal": masked})
    found = frame.image("thermal")
    assert not isinstance(found, np.ma.MaskedArray)
    assert np.array_equal(found, values, equal_nan=True)
