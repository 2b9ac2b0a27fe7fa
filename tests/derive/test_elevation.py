"""Elevation: against points and planes, by fit and by calibration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep import Camera, estimate_elevation, estimate_road_plane, road_plane
from nimprep.derive.modalities import Recipe, derive, recipe_from
from nimprep.errors import ArrayError
from nimprep.frame import Frame
from nimprep.readers import open_reader
from nimprep.synthetic import render_frame
from tests.derive.roads import CAMERA, ROADS, plane_of, rays, road_depth, with_boards


def scene_of(road, hidden=0.4):
    plane = plane_of(*ROADS[road])
    scene, covered = with_boards(road_depth(plane), hidden)
    return plane, scene.astype(np.float32), covered


def heights(depth, plane, camera=CAMERA):
    """Return the heights of a depth image's points over a plane, NaN where there is none."""
    points = rays(camera) * depth[..., None].astype(np.float64)
    return np.where(depth > 0, points @ plane[:3] + plane[3], np.nan)


@pytest.mark.parametrize("road", ROADS)
@pytest.mark.parametrize("hidden", [0.0, 0.4])
def test_the_plane_of_an_exact_road_is_found_whatever_stands_on_it(road, hidden):
    plane, depth, covered = scene_of(road, hidden)
    found = estimate_road_plane(depth, CAMERA)
    np.testing.assert_allclose(found, plane, atol=2e-5)
    elevation = estimate_elevation(depth, CAMERA)
    bare = (depth > 0) & (depth < 20) & ~covered & (heights(depth, plane) < 1e-3)
    assert np.abs(elevation[bare]).max() < 1e-4
    assert elevation.dtype == np.float32


@pytest.mark.parametrize("road", ROADS)
def test_elevation_is_the_height_of_each_point_over_a_given_plane(road):
    plane, depth, _ = scene_of(road)
    found = estimate_elevation(depth, CAMERA, plane)
    expected = heights(depth, plane)
    assert np.array_equal(np.isnan(found), depth == 0)
    np.testing.assert_allclose(found, expected, atol=2e-5)


@settings(max_examples=25)
@given(st.floats(-25, 25), st.floats(-4, 30), st.floats(0.4, 2.0), st.integers(0, 9))
def test_noise_and_boards_move_the_plane_by_little(roll, pitch, height, seed):
    plane = plane_of(roll, pitch, height)
    scene, _ = with_boards(road_depth(plane), 0.4, seed)
    noise = np.random.default_rng(seed).normal(0, 0.01, scene.shape)
    found = estimate_road_plane((scene * (1 + noise)).astype(np.float32), CAMERA)
    angle = np.degrees(np.arccos(min(found[:3] @ plane[:3], 1)))
    assert angle < 0.25
    assert found[3] == pytest.approx(height, rel=0.01)


def test_depth_comes_back_from_elevation():
    plane, depth, _ = scene_of("rolled")
    elevation = estimate_elevation(depth, CAMERA, plane).astype(np.float64)
    towards = rays(CAMERA) @ plane[:3]
    steep = (depth > 0) & (np.abs(towards) > 0.02)
    back = (elevation[steep] - plane[3]) / towards[steep]
    np.testing.assert_allclose(back, depth[steep], rtol=1e-4)


def test_a_calibrations_road_frame_gives_the_plane_where_its_y_is_0():
    plane = plane_of(5.0, 7.0, 1.65)
    down = -plane[:3]
    right = np.cross(down, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, down, np.cross(right, down)])
    transform = np.column_stack([rotation, [0.3, -1.65, 2.0]])
    np.testing.assert_allclose(road_plane(transform), plane, atol=1e-12)
    point = np.array([1.0, 0.4, 9.0])
    assert -(transform @ [*point, 1])[1] == pytest.approx(point @ plane[:3] + plane[3])


def test_threads_change_no_bit():
    plane = plane_of(*ROADS["flat"])
    camera = Camera(fx=500, fy=510, cx=400.5, cy=250.25, width=800, height=600)
    depth = road_depth(plane, camera).astype(np.float32)
    one, three = (estimate_elevation(depth, camera, plane, num_threads=n) for n in (1, 3))
    assert np.array_equal(one, three, equal_nan=True)


@pytest.mark.parametrize("index", range(4))
def test_a_synthetic_streets_road_is_near_0(index):
    frame = render_frame(5, index, CAMERA)
    elevation = estimate_elevation(frame.depth_m, CAMERA)
    road = (frame.label == 1) & (frame.depth_m > 0) & (frame.depth_m < 10)
    assert abs(np.median(elevation[road])) < 0.01
    assert np.percentile(np.abs(elevation[road]), 90) < 0.12


def test_the_roads_of_real_frames_are_near_0(reference_data):
    for folder, limit in (("gmrp", 0.05), ("kitti_road", 0.12)):
        reader = open_reader(reference_data / folder)
        for name in reader.ids:
            frame = reader.read(name, ("depth", "label"))
            road = (frame.label == 1) & (frame.depth_m > 0) & (frame.depth_m < 20)
            if not road.any():
                continue
            fitted = estimate_elevation(frame.depth_m, frame.camera)
            assert abs(np.median(fitted[road])) < limit / 3, name
            assert np.percentile(np.abs(fitted[road]), 90) < limit, name
            if frame.cam_to_road is not None:
                given = road_plane(frame.cam_to_road)
                found = estimate_road_plane(frame.depth_m, frame.camera)
                assert np.degrees(np.arccos(found[:3] @ given[:3])) < 2.5, name
                assert found[3] == pytest.approx(given[3], abs=0.12), name


def test_a_recipe_says_which_road_where_a_frame_has_two():
    plane = plane_of(*ROADS["flat"])
    depth = road_depth(plane).astype(np.float32)
    # The calibration's road lies half a metre lower than what the depth shows.
    to_road = np.array([[1, 0, 0, 0], [*-plane[:3], -plane[3] - 0.5], [0, 0, 1, 0]])
    frame = Frame("a", CAMERA, depth_m=depth, cam_to_road=to_road)
    for road, height in (("calibrated", 0.5), ("fitted", 0.0)):
        recipe = Recipe(elevation_road=road)
        image = derive(frame, None, ("elevation",), recipe).images["elevation"]
        assert np.nanmedian(image) == pytest.approx(height, abs=1e-3)
        described = recipe.describe("elevation")
        assert ("road" in described["parameters"]) == (road == "fitted")
        assert recipe_from({"elevation": described}).elevation_road == road


ONES = np.ones((180, 240))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: estimate_elevation(ONES, CAMERA), "expected a road in it, found none; give its"),
        (lambda: estimate_road_plane(0 * ONES, CAMERA), "expected a road in it"),
        (lambda: estimate_elevation(ONES[1:], CAMERA), "expected the camera's size"),
        (lambda: estimate_elevation(ONES, CAMERA, (0, -1, 0)), r"plane: expected 4.*\(3,\)"),
        (lambda: estimate_elevation(ONES, CAMERA, (0, -2, 0, 1)), "unit normal, found .* length 2"),
        (lambda: estimate_elevation(ONES, CAMERA, (0, np.nan, 0, 1)), "4 finite numbers"),
        (lambda: estimate_elevation(ONES, CAMERA, (0, -1, 0, 1e300)), "within 1e.09 m, found 1e"),
        (lambda: road_plane(np.eye(3)), r"cam_to_road: expected \(3, 4\) finite"),
        (lambda: road_plane(np.zeros((3, 4))), "cam_to_road: expected a unit normal"),
    ],
)
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises(ArrayError, match=message):
        call()
