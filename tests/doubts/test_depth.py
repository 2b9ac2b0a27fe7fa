"""Signs in metres and cameras, against scenes that are known exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nimprep.camera import Camera
from nimprep.doubts.depth import camera_signs, depth_signs
from tests.doubts.streets import CAMERA, street

LARGE = Camera(700.0, 700.0, 600.0, 190.0, 1242, 375)


@pytest.mark.parametrize("camera", [CAMERA, LARGE])
@pytest.mark.parametrize("height_m", [0.5, 1.65, 8.0])
def test_the_camera_is_found_as_high_as_it_is(camera: Camera, height_m: float) -> None:
    depth = street(camera, height_m=height_m, wall_m=60)
    assert depth_signs(depth, camera, 65.535)["camera_height_m"] == pytest.approx(
        height_m, rel=0.01
    )


def test_a_wall_is_no_road_to_stand_above() -> None:
    depth = street(height_m=10, pitch_deg=70, wall_m=100)
    assert "camera_height_m" not in depth_signs(depth, CAMERA, 65.535)


def test_depth_of_a_road_falls_and_its_disparity_grows_towards_the_bottom() -> None:
    depth = street()
    assert depth_signs(depth, CAMERA, 65.535)["row_correlation"] < -0.8
    disparity = (110 * 0.54 / depth).astype(np.float32)
    assert depth_signs(disparity, CAMERA, 65.535)["row_correlation"] > 0.99


def test_every_pixel_of_a_dense_image_has_neighbours_and_none_of_a_scan() -> None:
    depth = street()
    assert depth_signs(depth, CAMERA, 65.535)["with_neighbours"] == 1
    scan = np.zeros_like(depth)
    scan[40::3, ::4] = depth[40::3, ::4]
    assert depth_signs(scan, CAMERA, 65.535)["with_neighbours"] == 0


@pytest.mark.parametrize("lines", [np.s_[:, ::3], np.s_[::3]])
def test_a_neighbour_is_needed_on_both_axes(lines: tuple[slice, ...]) -> None:
    depth = np.zeros_like(street())
    depth[lines] = 5
    assert depth_signs(depth, CAMERA, 65.535)["with_neighbours"] == 0


def test_the_share_beyond_the_range_is_of_the_pixels_with_depth() -> None:
    depth = np.full((96, 128), 10, np.float32)
    depth[:48] = 0
    depth[48:60] = 65.536
    depth[60:] = np.float32(65.535)
    assert depth_signs(depth, CAMERA, 65.535)["beyond_range"] == pytest.approx(0.25, abs=0.01)


def test_nothing_is_measured_of_a_few_pixels() -> None:
    depth = np.zeros((96, 128), np.float32)
    depth[50, :20] = 3
    assert depth_signs(depth, CAMERA, 65.535) == {}
    for height, width in ((1, 1), (24, 32), (1, 4096), (4096, 1)):
        camera = Camera(30, 30, width / 2, height / 2, width, height)
        signs = depth_signs(np.full((height, width), 3, np.float32), camera, 65.535)
        assert signs.keys() <= {"beyond_range"}


def test_a_camera_that_is_no_camera_breaks_nothing() -> None:
    depth = np.ones((375, 1242), np.float32)
    depth_signs(depth, replace(LARGE, fx=0.001, fy=0.001), 65.535)


def test_the_signs_of_a_camera_are_its_view_and_where_it_points() -> None:
    signs = camera_signs(Camera.from_fov(69.4, 1280, 720))
    assert signs["view_deg"] == pytest.approx(69.4)
    assert (signs["cx_share"], signs["cy_share"]) == (0.5, 0.5)
    upright = camera_signs(Camera(500.0, 400.0, 100, 700, 480, 640))
    assert upright["view_deg"] == pytest.approx(2 * np.degrees(np.arctan(320 / 400)))
    assert upright["cy_share"] > 1
    assert upright["focal_px"] == 400
