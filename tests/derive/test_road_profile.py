"""The disparity transformation: exact on planes, robust to what stands on them, and back."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep import (
    RoadProfile,
    disparity_from_depth,
    estimate_road_profile,
    restore_disparity,
    transform_disparity,
)
from nimprep.derive.road import Road, RoadPoints, _refined, find_road
from nimprep.errors import ArrayError
from nimprep.kernels.road_fit import best_plane
from nimprep.synthetic import render_frame
from tests.derive.roads import CAMERA, ROADS, plane_of, rays, road_depth, with_boards
from tests.naive import road as naive

BASELINE_M = 0.12


def disparity_of(depth):
    return disparity_from_depth(depth.astype(np.float32), CAMERA, BASELINE_M)


def road_disparity(plane):
    """Return the disparity the road's plane has, below its horizon, and 0 above."""
    inverse = -(rays(CAMERA) @ plane[:3]) / plane[3]
    return np.maximum(CAMERA.fx * BASELINE_M * inverse, 0)


def pixel_roll_deg(plane):
    """Return the roll as the image shows it, whose pixels may be oblong."""
    return math.degrees(math.atan2(plane[0] / CAMERA.fx, plane[1] / CAMERA.fy)) % 360 - 180


@pytest.mark.parametrize("road", ROADS)
@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_a_plane_becomes_0_however_the_camera_looks_at_it(road, hidden):
    plane = plane_of(*ROADS[road])
    depth = road_depth(plane)
    scene, covered = with_boards(depth, hidden)
    transformed, profile = transform_disparity(disparity_of(scene))
    bare = (depth > 0) & ~covered
    assert covered[depth > 0].mean() >= hidden
    assert np.abs(transformed[bare]).max() < 1e-4
    assert profile.roll_deg == pytest.approx(pixel_roll_deg(plane), abs=1e-3)
    np.testing.assert_allclose(
        profile.road_disparity(*CAMERA.shape), road_disparity(plane), atol=2e-4
    )


@settings(max_examples=25)
@given(
    st.floats(-25, 25), st.floats(-4, 30), st.floats(0.4, 2.0), st.integers(0, 9), st.floats(0, 0.3)
)
def test_noise_and_boards_move_the_road_by_little(roll, pitch, height, seed, sigma):
    plane = plane_of(roll, pitch, height)
    depth = road_depth(plane)
    scene, _ = with_boards(depth, 0.4, seed)
    disparity = disparity_of(scene)
    noise = np.random.default_rng(seed).normal(0, sigma, disparity.shape)
    noisy = np.where(disparity > 0, np.maximum(disparity + noise, 0.01), 0).astype(np.float32)
    found = estimate_road_profile(noisy).road_disparity(*CAMERA.shape)
    assert np.abs(found - road_disparity(plane))[depth > 0].max() < 1e-3 + 2.5 * sigma


def test_what_stands_on_the_road_is_positive_and_a_pothole_negative():
    plane = plane_of(*ROADS["rolled"])
    depth = road_depth(plane)
    scene, covered = with_boards(depth, 0.2)
    sunk = depth.copy()
    sunk[150:160, 100:130] *= 1.05
    transformed, _ = transform_disparity(disparity_of(np.where(covered, scene, sunk)))
    assert (transformed[covered] > -1e-4).all()
    assert np.mean(transformed[covered] > 0.01) > 0.9
    hole = np.zeros_like(covered)
    hole[150:160, 100:130] = True
    hole &= ~covered
    # Five percent farther is as much less disparity.
    np.testing.assert_allclose(
        transformed[hole], -(0.05 / 1.05) * road_disparity(plane)[hole], rtol=1e-3
    )


def test_a_height_over_a_plane_is_that_share_of_the_cameras():
    plane = plane_of(*ROADS["flat"])
    depth = road_depth(plane)
    scene, covered = with_boards(depth, 0.3)
    disparity = disparity_of(scene)
    transformed, _ = transform_disparity(disparity)
    points = rays(CAMERA) * scene[..., None]
    height = points @ plane[:3] + plane[3]
    below = covered & (depth > 0)
    expected = disparity * height / plane[3]
    np.testing.assert_allclose(transformed[below], expected[below], atol=2e-4)


def test_a_road_that_bends_is_flat_too():
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    s = v * math.cos(0.1) + u * math.sin(0.1)
    disparity = np.where(s > 70, 0.5 + 0.06 * (s - 70) + 0.0004 * (s - 70) ** 2, 0)
    disparity[100:150, 60:90] += 4
    transformed, profile = transform_disparity(disparity.astype(np.float32))
    road = disparity > 0
    road[100:150, 60:90] = False
    assert np.abs(transformed[road]).max() < 1e-4
    assert profile.roll_deg == pytest.approx(math.degrees(0.1), abs=1e-3)
    assert profile.coefficients[2] == pytest.approx(0.0004, rel=1e-3)


@pytest.mark.parametrize("road", ["flat", "rolled far"])
def test_disparity_comes_back(road):
    plane = plane_of(*ROADS[road])
    scene, _ = with_boards(road_depth(plane), 0.4)
    disparity = disparity_of(scene)
    transformed, profile = transform_disparity(disparity)
    assert np.array_equal(np.isnan(transformed), disparity == 0)
    np.testing.assert_allclose(restore_disparity(transformed, profile), disparity, atol=4e-6)


def test_the_kernels_do_what_the_formula_says_beyond_the_span_too():
    profile = RoadProfile(-7.0, (-4.0, 0.05, 0.0006), (60.0, 110.0))
    rng = np.random.default_rng(0)
    disparity = rng.uniform(0, 20, (40, 50)).astype(np.float32) * (rng.random((40, 50)) < 0.8)
    expected = naive.transformed(disparity, profile)
    found, same = transform_disparity(disparity, profile)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert same is profile
    # At these rows the parabola, both tangents and the horizon are all in use.
    wide = profile.road_disparity(200, 50)
    levels = [naive.road_level(v * math.cos(math.radians(7)), profile) for v in range(200)]
    np.testing.assert_allclose(wide[:, 0], levels, atol=2e-5)
    assert wide.min() == 0
    assert (np.diff(wide[:, 0]) >= 0).all()


def test_the_vote_is_the_naive_one():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-1.5, 1.5, 300), rng.uniform(-1, 1, 300)
    w = np.abs(
        5 + 1.0 * x + 6 * y + rng.choice([0, 0, 0, 3.0, -3.0], 300) + rng.normal(0, 0.05, 300)
    )
    triples = rng.integers(0, 300, (60, 3))
    triples[0] = 5
    found, score = best_plane(x, y, w, triples, 2, 0.99, 0.5)
    expected, best = naive.best_plane(x, y, w, triples, 2, 0.99, 0.5)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert score == pytest.approx(best, rel=1e-9)


def test_the_same_image_gives_the_same_road_on_any_number_of_threads():
    plane = plane_of(*ROADS["rolled"])
    disparity = disparity_of(with_boards(road_depth(plane), 0.4)[0])
    tall = np.tile(disparity, (1, 6))
    one, first = transform_disparity(tall, num_threads=1)
    two, second = transform_disparity(tall, num_threads=3)
    assert first == second
    assert np.array_equal(one, two, equal_nan=True)


@pytest.mark.parametrize("index", range(4))
def test_a_synthetic_streets_road_is_flat_within_the_sensors_noise(index):
    camera = CAMERA
    frame = render_frame(5, index, camera)
    disparity = disparity_from_depth(frame.depth_m, camera, BASELINE_M)
    transformed, _ = transform_disparity(disparity)
    road = (frame.label == 1) & (frame.depth_m > 0)
    sensor = 0.2 * (camera.width / 1280) * (BASELINE_M / 0.055)
    assert abs(np.median(transformed[road])) < sensor
    assert np.median(np.abs(transformed[road])) < 2 * sensor


@pytest.mark.parametrize(
    "disparity",
    [
        np.zeros((40, 60), np.float32),
        np.full((40, 60), 7.0, np.float32),
        np.random.default_rng(0).normal(7, 0.05, (40, 60)).astype(np.float32),
        np.random.default_rng(0).uniform(1, 9, (40, 60)).astype(np.float32),
        np.linspace(1, 9, 60, dtype=np.float32) * np.ones((40, 1), np.float32),
        np.linspace(9, 1, 40, dtype=np.float32)[:, None] * np.ones((1, 60), np.float32),
        np.ones((1, 1), np.float32),
    ],
    ids=["none", "facing wall", "noisy wall", "noise", "side wall", "ceiling", "one pixel"],
)
def test_an_image_without_a_road_is_refused(disparity):
    with pytest.raises(ArrayError, match="disparity: expected a road in it, found none"):
        estimate_road_profile(disparity)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: transform_disparity(np.ones((2, 2), int)), "floating-point pixels, found int64"),
        (lambda: transform_disparity(-np.ones((2, 2))), "found -1 at pixel"),
        (lambda: restore_disparity(np.ones(3), RoadProfile(0, (0, 0, 0), (0, 0))), "transformed: "),
        (lambda: transform_disparity(np.ones((2, 2)), num_threads=0), "num_threads|road"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ArrayError, match=message):
        call()


def test_pixels_on_one_line_are_no_road():
    # All in the image's middle column: nothing tells its tilt.
    y = np.linspace(-1, 1, 100)
    points = RoadPoints(np.zeros(100), y, 3 + y, (0.0, 0.0), 1.0)
    start = Road(0.0, np.array([3.0, 1.0, 0.0]), (0.0, 0.0))
    assert _refined(points, start, 1.0, curved=False) is None
    assert find_road(points, curved=True) is None
