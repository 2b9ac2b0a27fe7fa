"""What the stereo camera's model makes of exact depth: errors, holes, steps."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep import Camera
from nimprep.synthetic import render_frame
from nimprep.synthetic.sensor import (
    DISPARITY_SIGMA_PX,
    DISPARITY_STEP_PX,
    RANGE_M,
    focal_baseline,
    measured_depth,
)

SMALL = Camera.from_fov(69.4, 64, 48)


def wall_errors(depth_m: float) -> np.ndarray:
    """What the sensor adds to a wall at this depth, where it sees it."""
    camera = Camera.from_fov(69.4, 640, 480)
    exact = np.full(camera.shape, depth_m)
    measured = [measured_depth(exact, camera, np.random.default_rng(s)) for s in range(3)]
    return np.concatenate([m[m > 0].astype(np.float64) - depth_m for m in measured])


def test_the_error_of_depth_grows_with_its_square():
    reach = focal_baseline(Camera.from_fov(69.4, 640, 480))
    sigma_px = np.hypot(DISPARITY_SIGMA_PX, DISPARITY_STEP_PX / np.sqrt(12))
    for depth_m in (1.0, 2.0, 4.0, 8.0):
        errors = wall_errors(depth_m)
        # Millimetres add their own rounding; at 8 m, 1/Z is no longer straight over one sigma.
        expected = np.hypot(depth_m**2 / reach * sigma_px, 0.001 / np.sqrt(12))
        assert errors.std() == pytest.approx(expected, rel=0.05)
        assert abs(errors.mean()) < 0.15 * expected


def test_measured_depth_is_whole_millimetres_within_reach():
    depth_m = np.tile(np.linspace(0.1, 30, 64), (48, 1))
    measured = measured_depth(depth_m, SMALL, np.random.default_rng(0))
    assert measured.dtype == np.float32
    raw = np.rint(measured * 1000).astype(np.uint16)
    np.testing.assert_array_equal(raw / np.float32(1000), measured)
    assert (measured[(depth_m < RANGE_M[0]) | (depth_m > RANGE_M[1])] == 0).all()
    assert (measured > 0).mean() > 0.4


def test_what_the_right_camera_cannot_see_has_no_depth():
    camera = Camera.from_fov(69.4, 640, 480)
    exact = np.full(camera.shape, 6.0)
    exact[100:380, 300:400] = 2.0
    rng = np.random.default_rng(0)
    seen = np.mean([measured_depth(exact, camera, rng)[200:300] > 0 for _ in range(8)], axis=(0, 1))
    # The strip left of the thing is as wide as the two disparities differ, in image pixels.
    width = camera.fx * 0.055 * (1 / 2 - 1 / 6)
    hidden = np.flatnonzero(seen[200:300] == 0)
    assert hidden.max() == 99
    assert hidden.size == pytest.approx(width, abs=1)
    assert (seen[400:500] > 0.5).all()


def test_columns_at_the_left_never_have_depth_and_the_others_do():
    camera = Camera.from_fov(69.4, 160, 120)
    seen = np.any([render_frame(0, i, camera).depth_m > 0 for i in range(10)], axis=(0, 1))
    first = int(np.argmax(seen))
    assert 1 <= first <= 8
    assert seen[first:].all()


def test_far_walls_have_more_holes_than_near_ones():
    camera = Camera.from_fov(69.4, 320, 240)
    holes = []
    for depth_m in (1.0, 6.0, 15.0):
        exact = np.full(camera.shape, depth_m)
        measured = [measured_depth(exact, camera, np.random.default_rng(s)) for s in range(4)]
        holes.append(np.mean([m[:, 40:] == 0 for m in measured]))
    assert 0 < holes[0] < 0.03
    assert holes[0] < 0.7 * holes[1] < 0.5 * holes[2]
    assert holes[2] < 0.4
