"""The bird's-eye view: known roads, a plain twin, and the official images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.kitti.bev import BEV_SHAPE, bring_to_bev, transform_to_bev
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.transform import transform_folder
from tests.naive.kitti_bev import bev as naive_bev

from .scenes import (
    CAMERA_HEIGHT_M,
    FX,
    HEIGHT,
    WIDTH,
    calibration,
    ground_truth,
    noise,
    read_png,
    rotation,
    write_calibration,
    write_png,
)

GOLDEN = ("um_road_000000", "umm_road_000000", "uu_road_000000")


def test_rows_of_the_image_are_distances_on_the_road(tmp_path: Path) -> None:
    rows = np.repeat(np.arange(HEIGHT, dtype=np.uint8)[:, None], WIDTH, axis=1)
    view = transform_to_bev(rows, calibration(tmp_path))
    for row in (0, 400, 700):
        z_m = 46 - 0.05 * (row + 0.5)
        v = 20.0 + FX * CAMERA_HEIGHT_M / z_m
        # Straight ahead; the official transform counts pixels from 1 and cuts the fraction.
        assert view[row, 200] == int(v) - 1


def test_a_lane_along_the_road_stands_upright(tmp_path: Path) -> None:
    cal = calibration(tmp_path)
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    inverse = np.linalg.inv(cal.road_to_image)
    for v in range(HEIGHT):
        for u in range(WIDTH):
            x, z, w = inverse @ [u + 1.5, v + 1.5, 1]
            image[v, u] = 255 * (w > 0 and 1.0 < x / w < 4.0 and z / w < 60)
    view = transform_to_bev(image, cal)
    columns = np.flatnonzero(view[700])
    left_m, right_m = -10 + 0.05 * columns[0], -10 + 0.05 * (columns[-1] + 1)
    # At z = 11 m a pixel of this camera is 0.18 m wide and 1.2 m long.
    assert abs(left_m - 1.0) < 0.3
    assert abs(right_m - 4.0) < 0.3


def test_what_the_camera_does_not_see_is_zero(tmp_path: Path) -> None:
    view = transform_to_bev(np.full((HEIGHT, WIDTH), 9, np.uint8), calibration(tmp_path))
    assert view[-1, 0] == 0
    assert view[0, 200] == 9


def test_a_camera_that_looks_back_does_not_see_the_road_ahead(tmp_path: Path) -> None:
    back = np.hstack([rotation("y", 180), [[0], [-CAMERA_HEIGHT_M], [0]]])
    cal = calibration(tmp_path, Tr_cam_to_road=back)
    assert not transform_to_bev(np.full((HEIGHT, WIDTH), 9, np.uint8), cal).any()


@pytest.mark.parametrize("channels", [(), (3,)], ids=["grey", "colour"])
def test_it_equals_its_plain_twin(tmp_path: Path, channels: tuple[int, ...]) -> None:
    tilt = rotation("x", 0.7) @ rotation("z", -1.3) @ rotation("y", 2.0)
    cal = calibration(
        tmp_path, Tr_cam_to_road=np.hstack([tilt, [[0.02], [-CAMERA_HEIGHT_M], [0.3]]])
    )
    image = noise(1, HEIGHT, WIDTH, *channels)
    np.testing.assert_array_equal(transform_to_bev(image, cal), naive_bev(image, cal.road_to_image))


def test_a_view_that_is_there_already_is_left_as_it_is(tmp_path: Path) -> None:
    view = noise(2, *BEV_SHAPE)
    assert bring_to_bev(view, tmp_path / "um_road_000000.png", None, "um_000000") is view


def test_an_image_in_perspective_needs_its_calibration(tmp_path: Path) -> None:
    image, path = noise(2, HEIGHT, WIDTH), tmp_path / "um_road_000000.png"
    with pytest.raises(LayoutError, match="give --calib"):
        bring_to_bev(image, path, None, "um_000000")
    with pytest.raises(LayoutError, match=r"um_000000\.txt: expected the calibration of um_road"):
        bring_to_bev(image, path, tmp_path, "um_000000")


def test_an_image_of_another_size_than_its_frame_is_refused(tmp_path: Path) -> None:
    p2 = np.array([[707.0493, 0, 600, 45], [0, 707.0493, 180, 0.2], [0, 0, 1, 0.003]])
    write_calibration(tmp_path / "um_000000.txt", P2=p2)
    with pytest.raises(DecodeError, match=r"expected 1224x370 pixels.*found 1242x375"):
        bring_to_bev(noise(0, 375, 1242), tmp_path / "um_road_000000.png", tmp_path, "um_000000")


def test_an_image_with_no_rows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArrayError, match="image"):
        transform_to_bev(np.zeros((0, 5), np.uint8), calibration(tmp_path))


def _road(reference_data: Path) -> Path:
    return reference_data / "kitti_road" / "training"


@pytest.mark.parametrize("name", GOLDEN)
def test_predictions_become_the_official_images(reference_data: Path, name: str) -> None:
    golden = reference_data / "kitti_road_golden"
    frame = name.replace("_road", "")
    cal = read_calibration(_road(reference_data) / "calib" / f"{frame}.txt")
    found = transform_to_bev(read_png(golden / "perspective" / f"{name}.png"), cal)
    np.testing.assert_array_equal(found, read_png(golden / "bev" / f"{name}.png"))


def test_folders_of_predictions_and_truths_become_the_official_images(
    reference_data: Path, tmp_path: Path
) -> None:
    golden, calib = reference_data / "kitti_road_golden", _road(reference_data) / "calib"
    transform_folder(golden / "perspective", tmp_path / "bev", calib)
    written = transform_folder(_road(reference_data) / "gt_image_2", tmp_path / "gt", calib)
    assert [path.stem for path in written] == ["um_lane_000000", *GOLDEN]
    for name in GOLDEN:
        for ours, theirs in (("bev", "bev"), ("gt", "gt_bev")):
            found = read_png(tmp_path / ours / f"{name}.png")
            np.testing.assert_array_equal(found, read_png(golden / theirs / f"{name}.png"))


def test_a_photograph_is_no_prediction(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calib" / "um_000000.txt")
    write_png(tmp_path / "in" / "um_road_000000.png", noise(0, HEIGHT, WIDTH, 3))
    expected = "expected a confidence map, 8-bit or 16-bit grey, found 8-bit RGB"
    with pytest.raises(DecodeError, match=expected):
        transform_folder(tmp_path / "in", tmp_path / "out", tmp_path / "calib")


def test_a_ground_truth_is_transformed_in_colour(tmp_path: Path) -> None:
    write_calibration(tmp_path / "calib" / "um_000000.txt")
    truth = ground_truth(noise(0, HEIGHT, WIDTH) > 128)
    write_png(tmp_path / "in" / "um_road_000000.png", truth)
    transform_folder(tmp_path / "in", tmp_path / "out", tmp_path / "calib")
    assert read_png(tmp_path / "out" / "um_road_000000.png").shape == (800, 400, 3)


def test_the_source_folder_is_never_written_to(tmp_path: Path) -> None:
    write_png(tmp_path / "in" / "um_road_000000.png", noise(0, *BEV_SHAPE))
    for out in (tmp_path / "in", tmp_path / "in" / "bev"):
        with pytest.raises(LayoutError, match="sources are never written to"):
            transform_folder(tmp_path / "in", out, None)
