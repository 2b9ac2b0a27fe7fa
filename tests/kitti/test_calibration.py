"""Calibration files: the transforms that follow from them, and what is refused."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep.errors import DecodeError
from nimprep.kitti.bev import transform_to_bev
from nimprep.kitti.calibration import FRAME_SHAPES, frame_shape, read_calibration

from .scenes import (
    BASELINE_M,
    CAMERA_HEIGHT_M,
    FX,
    MATRICES,
    calibration,
    calibration_text,
    noise,
    rotation,
    write_calibration,
    write_png,
)


def test_the_baseline_is_the_distance_between_the_colour_cameras(tmp_path: Path) -> None:
    assert calibration(tmp_path).baseline_m == pytest.approx(BASELINE_M, abs=1e-12)


def test_a_point_below_the_camera_lies_on_the_road(tmp_path: Path) -> None:
    # image_2 sits 0.06 m left of cam0, so its x = 0 is the road's x = -0.06.
    point = calibration(tmp_path).cam_to_road @ [0, CAMERA_HEIGHT_M, 10, 1]
    np.testing.assert_allclose(point, [-0.06, 0, 10], atol=1e-12)


def test_cam_to_road_undoes_rectification_before_it_goes_to_the_road(tmp_path: Path) -> None:
    r0 = rotation("x", 2.0) @ rotation("z", -1.0)
    cal = calibration(tmp_path, R0_rect=r0)
    in_cam0 = np.array([0.5, 1.2, 9.0])
    in_cam = r0 @ in_cam0 + [0.06, 0, 0]
    found = cal.cam_to_road @ [*in_cam, 1]
    np.testing.assert_allclose(found, in_cam0 - [0, CAMERA_HEIGHT_M, 0], atol=1e-9)


def test_the_road_projects_to_where_the_camera_sees_it(tmp_path: Path) -> None:
    cal = calibration(tmp_path, R0_rect=rotation("y", 3.0))
    x, z = 2.0, 15.0
    u, v, w = cal.road_to_image @ [x, z, 1]
    cam_to_road = np.vstack([cal.cam_to_road, [0, 0, 0, 1]])
    seen = np.linalg.inv(cam_to_road) @ [x, 0, z, 1]
    expected = cal.intrinsics @ seen[:3]
    np.testing.assert_allclose([u / w, v / w], expected[:2] / expected[2], atol=1e-9)


def test_the_scanners_forward_is_the_cameras_z(tmp_path: Path) -> None:
    seen = calibration(tmp_path).velo_to_cam @ [10, 1, -1, 1]
    np.testing.assert_allclose(seen, [-1 + 0.06, 1 - 0.08, 10 - 0.27], atol=1e-12)


def test_both_spellings_of_the_scanners_transform_are_read(tmp_path: Path) -> None:
    path = tmp_path / "c.txt"
    text = calibration_text().replace("Tr_velo_to_cam", "Tr_velo_cam")
    path.write_text(text.replace("R0_rect", "R_rect"))
    cal = read_calibration(path)
    np.testing.assert_array_equal(cal.matrix("Tr_velo_to_cam"), MATRICES["Tr_velo_to_cam"])


def test_the_camera_has_p2s_focal_length_at_the_images_size(tmp_path: Path) -> None:
    camera = calibration(tmp_path).camera(60, 120)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX, FX, 59.5, 20.0)
    assert camera.shape == (60, 120)


@pytest.mark.parametrize("name", ["P2", "Tr_cam_to_road", "R0_rect"])
def test_a_missing_matrix_is_named_when_the_view_needs_it(tmp_path: Path, name: str) -> None:
    cal = calibration(tmp_path, **{name: None})
    with pytest.raises(DecodeError, match=rf"um_000000\.txt: expected the matrix {name}, found"):
        _ = cal.road_to_image


def test_a_matrix_nobody_asks_for_may_be_missing(tmp_path: Path) -> None:
    cal = calibration(tmp_path, P3=None, Tr_velo_to_cam=None)
    assert cal.cam_to_road.shape == (3, 4)


BAD_NUMBERS = {
    "NaN": ("1 2 3 nan 0 1 0 0 0 0 1 0", "finite"),
    "infinity": ("inf 0 3 4 0 1 0 0 0 0 1 0", "finite"),
    "too few": ("1 0 0 0 0 1 0 0 0 0 1", "12 numbers for P2, found 11"),
    "too many": ("1 0 0 0 0 1 0 0 0 0 1 0 0", "12 numbers for P2, found 13"),
    "none": ("", "12 numbers for P2, found 0"),
    "words": ("1 0 0 0 0 x 0 0 0 0 1 0", "12 numbers for P2"),
    "no camera": ("0 0 0 0 0 0 0 0 0 0 0 0", r"\[\[fx, 0, cx\]"),
}


@pytest.mark.parametrize(("numbers", "found"), BAD_NUMBERS.values(), ids=BAD_NUMBERS)
def test_bad_numbers_are_refused(tmp_path: Path, numbers: str, found: str) -> None:
    with pytest.raises(DecodeError, match=rf"um_000000\.txt: expected .*{found}"):
        calibration(tmp_path, P2=numbers)


def test_what_is_no_rotation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match="expected a rotation in R0_rect"):
        calibration(tmp_path, R0_rect=2 * np.eye(3))
    with pytest.raises(DecodeError, match="expected a rotation in Tr_cam_to_road"):
        calibration(tmp_path, Tr_cam_to_road=np.zeros((3, 4)))


@pytest.mark.parametrize("data", [b"\xff\xfe\x00P2", b"x" * 70000], ids=["binary", "huge"])
def test_a_file_that_is_no_text_of_numbers_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "c.txt"
    path.write_bytes(data)
    with pytest.raises(DecodeError, match=r"c\.txt: expected a calibration"):
        read_calibration(path)


def test_a_file_that_is_not_there_is_an_error_with_its_name(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match=r"none\.txt: expected a calibration file"):
        read_calibration(tmp_path / "none.txt")


@pytest.mark.parametrize(("fx", "shape"), FRAME_SHAPES.items())
def test_p2_tells_the_frames_size(tmp_path: Path, fx: float, shape: tuple[int, int]) -> None:
    p2 = np.array([[fx, 0, 600, 45], [0, fx, 180, 0.2], [0, 0, 1, 0.003]])
    assert frame_shape(calibration(tmp_path, P2=p2)) == shape


def test_the_image_beside_the_calibration_tells_its_size_before_p2(tmp_path: Path) -> None:
    p2 = np.array([[721.5377, 0, 600, 45], [0, 721.5377, 180, 0.2], [0, 0, 1, 0.003]])
    write_png(tmp_path / "image_2" / "um_000000.png", noise(0, 30, 40, 3))
    assert frame_shape(calibration(tmp_path, P2=p2)) == (30, 40)


def test_an_unknown_focal_length_tells_no_size(tmp_path: Path) -> None:
    assert frame_shape(calibration(tmp_path)) is None


TOKENS = (
    "0",
    "-1",
    "1e308",
    "1e-320",
    "721.5",
    "nan",
    "-inf",
    "x",
    "",
    "1_0",
    "١",
    "\0",
    ":",
    "P2:",
)


@given(st.data())
@settings(max_examples=60)
def test_any_text_gives_transforms_or_an_error_that_names_it(data: st.DataObject) -> None:
    words = re.split(r"([ \n])", calibration_text())
    for _ in range(data.draw(st.integers(0, 4))):
        words[data.draw(st.integers(0, len(words) - 1))] = data.draw(st.sampled_from(TOKENS))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "um_000000.txt"
        path.write_text("".join(words), encoding="utf-8")
        message = f"{path}: expected "
        try:
            cal = read_calibration(path)
            matrices = (cal.cam_to_road, cal.road_to_image, cal.velo_to_cam, cal.baseline_m)
            transform_to_bev(noise(0, 6, 9), cal)
        except DecodeError as error:
            message, matrices = str(error), ()
        assert message.startswith(f"{path}: expected ")
        assert "\n" not in message
        assert all(np.isfinite(matrix).all() for matrix in matrices)


def test_real_calibrations_put_the_camera_above_the_road(reference_data: Path) -> None:
    for name in ("um", "umm", "uu"):
        path = reference_data / "kitti_road" / "training" / "calib" / f"{name}_000000.txt"
        cal = read_calibration(path)
        height_m = -cal.cam_to_road[1, 3]
        assert 1.5 < height_m < 1.8
        assert cal.baseline_m == pytest.approx(0.5327, abs=1e-4)
        assert frame_shape(cal) == (375, 1242)


def test_the_object_benchmarks_calibration_is_read_too(
    reference_data: Path, tmp_path: Path
) -> None:
    cal = read_calibration(reference_data / "kitti_lidar" / "calib" / "000000.txt")
    # The scanner stands 0.27 m behind and 0.08 m above the camera.
    np.testing.assert_allclose(cal.velo_to_cam[:, 3], [0.03, -0.06, -0.33], atol=0.02)
    with pytest.raises(DecodeError, match="Tr_cam_to_road"):
        _ = cal.cam_to_road
    assert write_calibration(tmp_path / "x.txt").is_file()
