import json
from pathlib import Path

import numpy as np
import pytest

from nimprep import Camera
from nimprep.errors import CameraError
from nimprep.readers.cameras import camera_from_file

CAMERA = Camera(fx=500, fy=510, cx=310, cy=245, width=640, height=480)


def project(camera: Camera, point: tuple[float, float, float]) -> np.ndarray:
    x, y, z = camera.matrix @ point
    return np.array([x / z, y / z])


def test_a_crop_moves_every_projected_point_by_the_window() -> None:
    cropped = CAMERA.crop(top=20, left=30, height=100, width=200)
    point = (0.3, -0.2, 2.0)
    assert np.allclose(project(cropped, point), project(CAMERA, point) - (30, 20))
    assert cropped.shape == (100, 200)


def test_a_flip_mirrors_every_projected_point_about_the_image() -> None:
    u, v = project(CAMERA, (0.3, -0.2, 2.0))
    assert np.allclose(project(CAMERA.flip(), (-0.3, -0.2, 2.0)), (639 - u, v))


def test_a_resize_keeps_the_images_outer_edges_where_they_are() -> None:
    half = CAMERA.resize(240, 320)
    # The left edge of the image is half a pixel left of pixel 0, before and after.
    left = (-0.5 - CAMERA.cx) / CAMERA.fx
    assert np.isclose((-0.5 - half.cx) / half.fx, left)
    assert np.isclose((319.5 - half.cx) / half.fx, (639.5 - CAMERA.cx) / CAMERA.fx)
    assert np.isclose((239.5 - half.cy) / half.fy, (479.5 - CAMERA.cy) / CAMERA.fy)


def test_the_nominal_camera_sees_its_field_of_view() -> None:
    camera = Camera.from_fov(69.4, 1280, 720)
    edges = np.array([-0.5 - camera.cx, 1279.5 - camera.cx]) / camera.fx
    assert np.isclose(np.degrees(np.diff(np.arctan(edges))[0]), 69.4)
    assert camera.fx == camera.fy


def test_a_matrix_goes_round() -> None:
    assert Camera.from_matrix(CAMERA.matrix, 640, 480) == CAMERA


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"fx": 0}, "positive number for fx"),
        ({"cy": float("nan")}, "finite number for cy"),
        ({"width": 0}, "positive integer for width"),
        ({"height": 2.5}, "positive integer for height"),
    ],
)
def test_numbers_that_make_no_camera_are_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(CameraError, match=words):
        Camera(**{**CAMERA.to_dict(), **change})


def test_a_crop_outside_the_image_is_refused() -> None:
    with pytest.raises(CameraError, match="inside 640x480"):
        CAMERA.crop(top=0, left=600, height=10, width=41)


def test_a_matrix_with_skew_is_refused() -> None:
    matrix = CAMERA.matrix
    matrix[0, 1] = 0.5
    with pytest.raises(CameraError, match="found"):
        Camera.from_matrix(matrix, 640, 480)


def test_a_camera_file_counted_from_one_is_converted(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"fx": 5, "fy": 6, "cx": 3, "cy": 2, "pixel_origin": 1}))
    camera = camera_from_file(path).camera(4, 5, "a")
    assert (camera.cx, camera.cy) == (2, 1)


def test_a_camera_file_of_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(json.dumps(CAMERA.to_dict()))
    with pytest.raises(CameraError, match="640x480"):
        camera_from_file(path).camera(100, 100, "a")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"fx": -1, "fy": 1, "cx": 0, "cy": 0}', "{"])
def test_a_file_that_is_no_camera_is_refused_by_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(CameraError, match=r"camera\.json"):
        camera_from_file(path)
