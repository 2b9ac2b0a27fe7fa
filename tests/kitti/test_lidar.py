"""Laser scans: where a return falls, which one wins, and files that are no scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import ArrayError, DecodeError
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.lidar import project_lidar, read_velodyne
from tests.naive.kitti_lidar import sparse_depth

from .scenes import FX, HEIGHT, WIDTH, calibration, rotation


def _scan(*points: tuple[float, float, float]) -> np.ndarray:
    return np.array([[*p, 0.5] for p in points], np.float32)


def test_a_return_ahead_falls_where_the_camera_looks(tmp_path: Path) -> None:
    # 10 m ahead, 1 m to the left, 0.5 m down of the scanner.
    depth = project_lidar(_scan((10, 1, -0.5)), calibration(tmp_path), HEIGHT, WIDTH)
    z = 10 - 0.27
    u, v = round(59.5 + FX * (-1 + 0.06) / z), round(20 + FX * (0.5 - 0.08) / z)
    assert np.flatnonzero(depth).tolist() == [v * WIDTH + u]
    assert depth[v, u] == pytest.approx(z)


def test_the_nearest_return_of_a_pixel_wins(tmp_path: Path) -> None:
    cal = calibration(tmp_path)
    for order in ((10, 10.1, 9.9), (9.9, 10, 10.1), (10.1, 10, 9.9)):
        scan = _scan(*((x, 0.0, -0.08) for x in order))
        depth = project_lidar(scan, cal, HEIGHT, WIDTH)
        assert depth[depth > 0].tolist() == pytest.approx([9.9 - 0.27])


def test_returns_behind_the_camera_and_outside_the_image_are_left_out(tmp_path: Path) -> None:
    scan = _scan((-10, 0, 0), (0.27, 0, 0), (10, 30, 0), (10, -30, 0), (10, 0, 30))
    assert not project_lidar(scan, calibration(tmp_path), HEIGHT, WIDTH).any()


def test_it_equals_its_plain_twin(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scan = rng.uniform((-20, -20, -2, 0), (40, 20, 2, 1), (3000, 4)).astype(np.float32)
    cal = calibration(tmp_path, R0_rect=rotation("x", 1.0))
    found = project_lidar(scan, cal, HEIGHT, WIDTH)
    expected = sparse_depth(scan, cal.velo_to_cam, cal.intrinsics, HEIGHT, WIDTH)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_scan_reads_back(tmp_path: Path) -> None:
    scan = np.arange(12, dtype="<f4").reshape(3, 4)
    (tmp_path / "a.bin").write_bytes(scan.tobytes())
    np.testing.assert_array_equal(read_velodyne(tmp_path / "a.bin"), scan)


NO_RETURNS = [(np.nan,) * 3, (np.inf, 0, 0), (20, -np.inf, 0), (20, 0, np.nan), (3e38, 0, 0)]


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
def test_a_point_that_is_not_finite_is_no_return(tmp_path: Path, dtype: str) -> None:
    scan, cal = _scan((10, 1, -0.5), (12, 0, -0.5)), calibration(tmp_path)
    expected = project_lidar(scan, cal, HEIGHT, WIDTH)
    both = np.concatenate([_scan(*NO_RETURNS[:-1]), scan]).astype(dtype)
    assert np.array_equal(project_lidar(both, cal, HEIGHT, WIDTH), expected)
    masked = np.ma.array(_scan((5, 0, 0), (10, 1, -0.5), (12, 0, -0.5)), mask=False)
    masked[0, 2] = np.ma.masked
    assert np.array_equal(project_lidar(masked, cal, HEIGHT, WIDTH), expected)
    (tmp_path / "a.bin").write_bytes(both.astype("<f4").tobytes())
    assert np.array_equal(read_velodyne(tmp_path / "a.bin"), scan)


def test_points_at_any_distance_give_depth_or_none(tmp_path: Path) -> None:
    cal = calibration(tmp_path, R0_rect=rotation("x", 1.0))
    distances = [0.27 + 1e-5, 0.27 + 2e-4, 1e10, 1e30, 3e38, 1e300]
    for x in distances:
        depth = project_lidar(np.array([[x, 0.0, -0.08 - 0.02 * x]]), cal, HEIGHT, WIDTH)
        assert np.isfinite(depth).all()
        assert not ((depth > 0) & (depth < 1e-4)).any()


BAD_FILES = {
    "truncated": (b"\0" * 30, "16 bytes, found 30 bytes"),
    "empty": (b"", "found 0 bytes"),
    "nothing but NaN": (np.array([1, np.nan, 0, 0], "<f4").tobytes(), "finite"),
}


@pytest.mark.parametrize(("data", "found"), BAD_FILES.values(), ids=BAD_FILES)
def test_what_is_no_scan_is_refused(tmp_path: Path, data: bytes, found: str) -> None:
    (tmp_path / "a.bin").write_bytes(data)
    with pytest.raises(DecodeError, match=rf"a\.bin: expected .*{found}"):
        read_velodyne(tmp_path / "a.bin")


def test_a_scan_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match=r"a\.bin: expected a Velodyne scan"):
        read_velodyne(tmp_path / "a.bin")


def test_points_need_three_coordinates(tmp_path: Path) -> None:
    with pytest.raises(ArrayError, match="points"):
        project_lidar(np.zeros((5, 2)), calibration(tmp_path), HEIGHT, WIDTH)


def test_a_real_scan_covers_the_ground_ahead(reference_data: Path) -> None:
    folder = reference_data / "kitti_lidar"
    cal = read_calibration(folder / "calib" / "000000.txt")
    depth = project_lidar(read_velodyne(folder / "velodyne" / "000000.bin"), cal, 370, 1224)
    rows, columns = np.nonzero(depth)
    assert 15000 < rows.size < 25000
    # The scanner looks at most 2 degrees up: nothing in the image's upper part.
    assert rows.min() > 110
    # The camera stands about 1.65 m above the ground, and the pavement a kerb above the road.
    near = (rows > 330) & (abs(columns - 500) < 200)
    k = cal.intrinsics
    y = (rows[near] - k[1, 2]) * depth[rows[near], columns[near]] / k[1, 1]
    assert np.median(y) == pytest.approx(1.55, abs=0.1)
