"""Disparity: against a projection into a second camera, and back."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep import Camera, depth_from_disparity, disparity_from_depth
from nimprep.errors import ArrayError
from nimprep.frame import PLANES, VIRTUAL_BASELINE_M
from nimprep.kernels.planes import positives_to_integers, signed_to_integers
from tests.derive.roads import CAMERA, ROADS, plane_of, rays, road_depth

DEPTH = road_depth(plane_of(*ROADS["rolled"])).astype(np.float32)


def test_disparity_is_how_much_farther_left_a_camera_at_the_right_sees_a_point():
    points = rays(CAMERA) * DEPTH[..., None].astype(np.float64)
    some = DEPTH > 0
    at_right = points[some] - (0.3, 0, 0)
    shift = (points[some][:, 0] - at_right[:, 0]) / at_right[:, 2] * CAMERA.fx
    found = disparity_from_depth(DEPTH, CAMERA, 0.3)
    np.testing.assert_allclose(found[some], shift, rtol=1e-6)
    assert found.dtype == np.float32
    assert not found[~some].any()


def test_depth_comes_back_from_disparity():
    found = depth_from_disparity(disparity_from_depth(DEPTH, CAMERA, 0.2), CAMERA, 0.2)
    np.testing.assert_allclose(found, DEPTH, rtol=3e-7)


def test_the_virtual_baseline_is_the_d415s():
    one = Camera(fx=100, fy=90, cx=0, cy=0, width=1, height=1)
    found = disparity_from_depth(np.full((1, 1), 2.0), one)
    np.testing.assert_allclose(found, 100 * 0.055 / 2, rtol=1e-6)
    assert VIRTUAL_BASELINE_M == 0.055


def test_threads_change_no_bit():
    depth = np.tile(DEPTH, (4, 4))
    camera = Camera(fx=180, fy=170, cx=3, cy=4, width=960, height=720)
    alone = disparity_from_depth(depth, camera, num_threads=1)
    assert np.array_equal(alone, disparity_from_depth(depth, camera, num_threads=3))


def test_the_farthest_depth_has_a_disparity_with_the_smallest_camera_and_baseline():
    camera = Camera(fx=1e-3, fy=1, cx=0, cy=0, width=3, height=1)
    depth = np.array([[3.4e38, 0, 1e-4]], np.float32)
    for baseline_m in (5e-324, 1e-6, 1e-3, 1000):
        found = disparity_from_depth(depth, camera, baseline_m)
        assert np.isfinite(found).all()
        assert np.array_equal(found > 0, depth > 0)


def test_depth_too_near_or_too_far_for_its_disparity_is_none():
    camera = Camera(fx=100, fy=1, cx=0, cy=0, width=4, height=1)
    disparity = np.array([[1e-38, 1e-45, 1e6, 2e7]], np.float32)
    found = depth_from_disparity(disparity, camera, 10)
    np.testing.assert_allclose(found, [[0, 0, 1e-3, 0]], rtol=1e-6)


def test_nan_is_read_as_none():
    depth = DEPTH.copy()
    depth[100:110] = np.nan
    assert not disparity_from_depth(depth, CAMERA)[100:110].any()
    assert not depth_from_disparity(depth, CAMERA)[100:110].any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: disparity_from_depth(DEPTH, CAMERA, 0), "baseline_m: expected a positive number"),
        (lambda: disparity_from_depth(DEPTH, CAMERA, np.nan), "found nan"),
        (lambda: disparity_from_depth(DEPTH, CAMERA, 1e300), "at most 1000 metres, found 1e"),
        (lambda: disparity_from_depth(-DEPTH, CAMERA), r"depth_m: .*found -\d.* at pixel \(u, v\)"),
        (lambda: disparity_from_depth(DEPTH[1:], CAMERA), "depth_m: expected the camera's size"),
        (lambda: depth_from_disparity(DEPTH[1:], CAMERA), "disparity: expected the camera's size"),
        (lambda: depth_from_disparity(DEPTH.astype(int), CAMERA), "floating-point pixels"),
        (lambda: depth_from_disparity(-DEPTH, CAMERA), "disparity: expected pixels >= 0, found -"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with np.errstate(invalid="ignore"), pytest.raises(ArrayError, match=message):
        call()


def test_numbers_become_the_nearest_integers_within_range():
    numbers = np.array([[0, 1e-6, 1 / 256, 0.0058, 12.34, 255.996, 256, 1e6]], np.float32)
    stored = np.empty(numbers.shape, np.uint16)
    positives_to_integers(numbers, PLANES["disparity"].steps, stored)
    assert stored.tolist() == [[0, 1, 1, 1, 3159, 65535, 65535, 65535]]
    numbers = np.array([[np.nan, 0, -0.0006, 0.0004, -2.5, 32.767, 40, -40]], np.float32)
    stored = np.empty(numbers.shape, np.int16)
    signed_to_integers(numbers, PLANES["elevation"].steps, stored)
    assert stored.tolist() == [[-32768, 0, -1, 0, -2500, 32767, 32767, -32767]]
