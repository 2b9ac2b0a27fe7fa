"""What counts as depth: the check that every function of depth makes."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.depth import checked_depth, checked_plane
from nimprep.errors import ArrayError

BELOW = float(np.nextafter(np.float32(LEAST_DEPTH_M), np.float32(0)))
NONE = [0.0, -0.0, np.nan, -np.nan, np.inf, -np.inf, 1e-45, 1e-38, 1e-20, 1e-12, 9.9e-5]
SOME = [LEAST_DEPTH_M, 1e-3, 1.5, 65.535, 1e10, 1e30, 3.4028235e38]


@pytest.mark.parametrize("value", NONE)
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", "f2", "g"])
def test_what_is_no_depth_becomes_0(value, dtype):
    with np.errstate(all="ignore"):
        depth = np.array([[2.5, value, 1.25]], np.float64).astype(dtype)
    assert checked_depth(depth).tolist() == [[2.5, 0, 1.25]]


@pytest.mark.parametrize("value", SOME)
def test_what_is_depth_stays_as_it_is(value):
    depth = np.array([[0, value], [1, np.inf]], np.float32)
    expected = np.array([[0, value], [1, 0]], np.float32)
    assert np.array_equal(checked_depth(depth), expected)
    assert np.array_equal(checked_depth(depth.astype(np.float64)), expected)


def test_an_image_of_depth_and_0_alone_is_not_copied_and_never_written_to():
    depth = np.array([[0, 1], [LEAST_DEPTH_M, 3e38]], np.float32)
    assert checked_depth(depth) is depth
    depth = np.array([[0, np.nan], [-np.inf, 1e-20]], np.float32)
    depth.flags.writeable = False
    assert not checked_depth(depth).any()
    assert depth.tobytes() == np.array([[0, np.nan], [-np.inf, 1e-20]], np.float32).tobytes()


def test_the_least_depth_is_a_tenth_of_a_millimetre_to_the_bit():
    depth = np.array([[BELOW, LEAST_DEPTH_M]], np.float32)
    assert checked_depth(depth).tolist() == [[0, np.float32(LEAST_DEPTH_M)]]


def test_numbers_beyond_float32_are_infinite_and_so_none():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert checked_depth(np.array([[1e300, 1e-300, 1.0]])).tolist() == [[0, 0, 1]]


@pytest.mark.parametrize("value", [-1e-45, -1e-12, -2.5, -3e38])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_negative_number_is_an_error_that_names_its_pixel(value, dtype):
    depth = np.ones((4, 5), dtype)
    depth[0, 0], depth[2, 3], depth[3, 1] = -np.inf, value, value
    with pytest.raises(
        ArrayError, match=r"^depth_m: .*found -\S+ at pixel \(u, v\) = \(3, 2\), .* 2"
    ):
        checked_depth(depth)


@pytest.mark.parametrize("value", [-1e300, -1e-300])
def test_a_negative_number_is_one_beyond_float32_too(value):
    with pytest.raises(ArrayError, match=r"found -1e.*\(u, v\) = \(1, 0\)"):
        checked_depth(np.array([[1.0, value]]))


def test_masked_pixels_are_none_whatever_lies_beneath():
    depth = np.ma.array([[1.0, -5.0], [np.nan, 2.0]], mask=[[0, 1], [1, 0]])
    assert checked_depth(depth).tolist() == [[1, 0], [0, 2]]
    assert depth.data[0, 1] == -5


def test_a_disparity_has_no_least():
    disparity = np.array([[1e-45, 1e-12, np.inf, 3.0]], np.float32)
    assert np.array_equal(
        checked_plane(disparity, "disparity", "pixels"),
        np.array([[1e-45, 1e-12, 0, 3]], np.float32),
    )
