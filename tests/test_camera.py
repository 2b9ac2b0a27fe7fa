import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep import Camera
from nimprep.camera import MAX_BASELINE_M, RANGES, unit_gravity
from nimprep.errors import ArrayError, CameraError
from nimprep.readers.cameras import camera_from_file
from nimprep.schema import load_schema, schema_problems

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
        ({"fx": 0}, r"0\.001 to 1e\+06 pixels for fx, found 0"),
        ({"cy": float("nan")}, "number of .* pixels for cy, found nan"),
        ({"width": 0}, "whole number of 1 .* pixels for width, found 0"),
        ({"height": 2.5}, "whole number of .* pixels for height, found 2.5"),
    ],
)
def test_numbers_that_make_no_camera_are_refused(change: dict[str, float], words: str) -> None:
    with pytest.raises(CameraError, match=words):
        Camera(**{**CAMERA.to_dict(), **change})


NUMBERS = (math.nan, math.inf, -math.inf, -1.0, 0.0, 1e300, -1e300, 5e-324, 1e9, -1e9, 10**400)
NO_NUMBERS = (None, "5", b"5", True, 1j, [5.0], np.array([5.0]), np.ma.masked)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((n, v) for n, (least, most) in RANGES.items() for v in NUMBERS if not least <= v <= most),
        *((n, v) for n in RANGES for v in NO_NUMBERS),
    ],
    ids=lambda v: f"{v!s:.20}",
)
def test_no_number_out_of_its_range_makes_a_camera(name: str, value: Any) -> None:
    with pytest.raises(CameraError, match=f"pixels for {name}, found "):
        Camera(**{**CAMERA.to_dict(), name: value})


def test_a_cameras_ranges_are_those_of_the_schema() -> None:
    schema = load_schema("camera")["properties"]
    assert {name: (schema[name]["minimum"], schema[name]["maximum"]) for name in RANGES} == RANGES
    assert schema["baseline_m"]["maximum"] == MAX_BASELINE_M
    least, most = ({name: ends[k] for name, ends in RANGES.items()} for k in (0, 1))
    for numbers in (least, most):
        assert not schema_problems(numbers, "camera")
        assert Camera(**numbers).to_dict() == numbers


@pytest.mark.parametrize("name", list(RANGES))
def test_one_step_beyond_the_range_both_the_schema_and_the_camera_refuse(name: str) -> None:
    for end, beyond in zip(RANGES[name], (-math.inf, math.inf), strict=True):
        step = math.copysign(1, beyond) if name in ("width", "height") else 0
        document = CAMERA.to_dict() | {name: end + step if step else math.nextafter(end, beyond)}
        assert schema_problems(document, "camera")
        with pytest.raises(CameraError, match=f"for {name}, found"):
            Camera(**document)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.resize(1, 1),
        lambda c: c.resize(0, 5),
        lambda c: c.resize(5, math.nan),
        lambda c: c.crop(0, 900_000, 10, 10),
        lambda c: c.crop(0, math.nan, 10, 10),
        lambda c: c.crop(0, 0, 10, 1.5),
        lambda c: c.resize(1 << 26, 1 << 26),
        lambda c: c.flip(),
        lambda c: Camera.from_matrix(c.matrix * math.inf, 5, 5),
        lambda c: Camera.from_matrix(np.diag([1e300, 1, 1]), 5, 5),
        lambda c: Camera.from_matrix(np.ma.masked_equal(c.matrix, c.fx), 5, 5),
        lambda c: Camera.from_matrix(np.ma.masked_equal(c.matrix, 0), 5, 5),
        lambda c: Camera.from_matrix([[1, 0], [0, "x"]], 5, 5),
        lambda c: Camera.from_matrix([["a"]], 5, 5),
        lambda c: Camera.from_fov(math.nan, 5, 5),
        lambda c: Camera.from_fov(179.9999999999, 5, 5),
    ],
)
def test_what_is_made_of_a_camera_keeps_to_the_ranges(change: Any) -> None:
    camera = Camera(fx=0.01, fy=0.01, cx=-200_000, cy=0, width=1_000_000, height=1_000_000)
    with np.errstate(all="ignore"), pytest.raises(CameraError, match=r"^camera: expected "):
        change(camera)


def test_a_crop_outside_the_image_is_refused() -> None:
    with pytest.raises(CameraError, match="inside 640x480"):
        CAMERA.crop(top=0, left=600, height=10, width=41)


def test_a_matrix_with_skew_is_refused() -> None:
    matrix = CAMERA.matrix
    matrix[0, 1] = 0.5
    with pytest.raises(CameraError, match="found"):
        Camera.from_matrix(matrix, 640, 480)


@pytest.mark.parametrize("given", ["abc", ["x", 1, 2], [[1], [2, 3], 4], {"x": 1}])
def test_a_gravity_that_is_no_numbers_is_refused_as_all_arrays_are(given: object) -> None:
    with pytest.raises(ArrayError, match=r"^gravity: expected numbers, found"):
        unit_gravity(given)


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
