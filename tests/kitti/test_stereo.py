"""Stereo: known disparities, what only one camera sees, and real roads."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from nimprep.errors import ArrayError, DecodeError
from nimprep.images import read_rgb
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.images import read_ground_truth
from nimprep.kitti.layout import RoadFiles
from nimprep.kitti.stereo import match_stereo, stereo_depth

from .scenes import BASELINE_M, FX, MATRICES, calibration, noise


def _texture(height: int, width: int) -> np.ndarray:
    return cv2.GaussianBlur(noise(5, height, width, 3), (0, 0), 1.2)


def _pair(disparity: int, height: int = 80, width: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """A wall facing the cameras: the right image sees each point `disparity` further left."""
    wide = _texture(height, width + disparity)
    return wide[:, :width].copy(), wide[:, disparity:].copy()


@pytest.mark.parametrize("disparity", [5, 40, 100])
def test_a_wall_has_one_disparity(disparity: int) -> None:
    left, right = _pair(disparity)
    found = match_stereo(left, right)
    # Points of the left image's first columns lie outside the right one.
    inside = found[10:-10, disparity + 10 : -10]
    assert np.mean(np.abs(inside - disparity) <= 0.25) > 0.97


def test_a_slanted_wall_has_its_own_disparity_at_each_column() -> None:
    u = np.arange(300)
    disparity = 20 + 0.15 * u
    right = _texture(80, 400)
    # The right image begins at column 100 of the texture: the left one samples beyond its edge too.
    columns = np.tile((u - disparity + 100).astype(np.float32), (80, 1))
    rows = np.tile(np.arange(80, dtype=np.float32)[:, None], (1, 300))
    left = cv2.remap(right, columns, rows, cv2.INTER_CUBIC)
    found = match_stereo(left, np.ascontiguousarray(right[:, 100:]))
    off = (found - disparity)[found > 0]
    assert found[:, 100:].all(axis=0).mean() > 0.5
    # A result one column aside would be off by 0.15.
    assert abs(np.median(off)) < 0.07


def test_cameras_the_wrong_way_round_are_refused(tmp_path: Path) -> None:
    left, right = _pair(20)
    swapped = calibration(tmp_path, P2=MATRICES["P3"], P3=MATRICES["P2"])
    with pytest.raises(DecodeError, match=r"000000\.txt: .*found a baseline of -0\.54 m"):
        stereo_depth(left, right, swapped)


@pytest.mark.parametrize("change", ["grey", "float", "masked", "empty"])
def test_what_is_no_colour_image_is_refused(change: str) -> None:
    left, right = _pair(20)
    wrong = {
        "grey": left[..., 0],
        "float": left / 255,
        "masked": np.ma.masked_equal(left, left[0, 0, 0]),
        "empty": left[:0],
    }[change]
    with pytest.raises(ArrayError, match=r"^left: expected "):
        match_stereo(wrong, right)
    with pytest.raises(ArrayError, match=r"^right: expected "):
        match_stereo(left, wrong)


def test_depth_is_focal_length_times_baseline_over_disparity(tmp_path: Path) -> None:
    left, right = _pair(20)
    depth = stereo_depth(left, right, calibration(tmp_path))
    assert np.median(depth[depth > 0]) == pytest.approx(FX * BASELINE_M / 20, rel=0.01)


def test_what_the_right_camera_does_not_see_has_no_depth() -> None:
    left, right = _pair(10)
    near = noise(6, 80, 60, 3)
    left[:, 120:180], right[:, 80:140] = near, near
    found = match_stereo(left, right)
    # Beside the near board, 30 columns of the wall are hidden from the right camera.
    assert np.mean(found[10:-10, 95:115] > 0) < 0.1
    board = found[10:-10, 130:170]
    assert np.median(board) == pytest.approx(40, abs=0.25)


def test_images_of_different_sizes_are_refused() -> None:
    with pytest.raises(ArrayError, match="right: expected an image like the left one"):
        match_stereo(noise(0, 20, 30, 3), noise(0, 20, 31, 3))


def test_without_the_right_cameras_matrix_there_is_no_depth(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match="expected the matrix P3"):
        stereo_depth(*_pair(5), calibration(tmp_path, P3=None))


def _road_heights(files: RoadFiles, depth_m: np.ndarray) -> np.ndarray:
    """Heights above the road's plane of the road's pixels that have depth, metres."""
    cal = read_calibration(files.calibration)
    truth = read_ground_truth(files.ground_truth("road"))
    v, u = np.nonzero(truth.positive & truth.evaluated & (depth_m > 0))
    rays = np.linalg.inv(cal.intrinsics) @ [u, v, np.ones_like(u)]
    points = rays * depth_m[v, u]
    return -(cal.cam_to_road @ np.vstack([points, np.ones_like(u)]))[1]


@pytest.mark.parametrize("name", ["um_000000", "umm_000000", "uu_000000"])
def test_real_roads_lie_on_the_roads_plane(reference_data: Path, name: str) -> None:
    files = RoadFiles(reference_data / "kitti_road" / "training", "training", name)
    cal = read_calibration(files.calibration)
    matched = stereo_depth(read_rgb(files.image), read_rgb(files.right_image), cal)
    for depth_m in (matched, frame_depth(files, "stereo")):
        heights = _road_heights(files, depth_m)
        assert np.median(np.abs(heights)) < 0.10
        assert heights.size > 0.9 * np.count_nonzero(
            read_ground_truth(files.ground_truth("road")).positive
        )


def test_stereo_agrees_with_the_paper_authors_depth(reference_data: Path) -> None:
    files = RoadFiles(reference_data / "kitti_road" / "training", "training", "uu_000000")
    ours, theirs = frame_depth(files, "stereo"), frame_depth(files, "depth_u16")
    both = (ours > 0) & (theirs > 0)
    assert both.sum() > 0.9 * (theirs > 0).sum()
    off = np.abs(ours[both] / theirs[both] - 1)
    assert np.median(off) < 0.03


def test_the_check_from_both_sides_takes_outliers_out(reference_data: Path) -> None:
    files = RoadFiles(reference_data / "kitti_road" / "training", "training", "uu_000000")
    cal = read_calibration(files.calibration)
    found = match_stereo(read_rgb(files.image), read_rgb(files.right_image))
    theirs = frame_depth(files, "depth_u16")
    both = (found > 0) & (theirs > 0)
    expected = cal.intrinsics[0, 0] * cal.baseline_m / theirs[both]
    # Without the check, 5.1 % are off by more than 3 pixels.
    assert np.mean(np.abs(found[both] - expected) > 3) < 0.045
    assert both.sum() > 0.8 * (theirs > 0).sum()
