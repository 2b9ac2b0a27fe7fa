"""Calibration text and laser scans: anything at all in place of KITTI's files."""

from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from nimprep.errors import DecodeError
from nimprep.kitti.bev import transform_to_bev
from nimprep.kitti.calibration import frame_shape, read_calibration
from nimprep.kitti.lidar import project_lidar, read_velodyne
from nimprep.kitti.stereo import stereo_depth
from tests.hostile.damage import damaged
from tests.hostile.fuzzing import fuzz, limited_time, survives
from tests.kitti.scenes import calibration, calibration_text, noise

LINES = st.lists(
    st.one_of(
        st.sampled_from(["P2: ", "P3:", "R0_rect: ", "Tr_cam_to_road: ", "Tr_velo_to_cam: ", ":"]),
        st.sampled_from(
            ["1e9 ", "nan ", "-inf ", "1e-320 ", "0 ", "-1 ", "1_0 ", "٣ ", "\n", "\r"]
        ),
        st.text(max_size=20),
    ),
    max_size=60,
).map(lambda parts: "".join(parts).encode("utf-8", "surrogatepass"))

SCAN = np.random.default_rng(0).uniform(-20, 40, (200, 4)).astype("<f4").tobytes()


def use(path: Path) -> None:
    """Ask a calibration for all that follows from it."""
    cal = read_calibration(path)
    found = []
    for name in ("cam_to_road", "road_to_image", "velo_to_cam", "baseline_m", "intrinsics"):
        try:
            found.append(np.asarray(getattr(cal, name)))
        except DecodeError as error:
            assert str(path) in str(error)  # noqa: PT017 - a matrix may be missing
    assert all(np.isfinite(matrix).all() for matrix in found)
    frame_shape(cal)
    cal.camera(30, 40)
    project_lidar(np.frombuffer(SCAN, "<f4").reshape(-1, 4), cal, 30, 40)
    stereo_depth(noise(0, 20, 30, 3), noise(1, 20, 30, 3), cal)
    transform_to_bev(noise(0, 6, 9), cal)


@fuzz(150, data=st.one_of(damaged(calibration_text().encode()), LINES))
def test_any_calibration_is_read_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "um_000000.txt"
    path.write_bytes(data)
    survives("calibration text", lambda: use(path))


SPECIAL = np.array([np.nan, np.inf, -np.inf, 3.4e38, -3.4e38, 1e-45, 0.0], "<f4")


@st.composite
def scans(draw: st.DrawFn) -> bytes:
    points = np.frombuffer(SCAN, "<f4").copy()
    for place in draw(st.lists(st.integers(0, points.size - 1), max_size=6)):
        points[place] = SPECIAL[draw(st.integers(0, len(SPECIAL) - 1))]
    return draw(st.one_of(st.just(points.tobytes()), damaged(points.tobytes())))


@fuzz(150, data=scans())
def test_any_scan_is_read_or_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(data)
    cal = calibration(tmp_path)

    def read() -> None:
        depth_m = project_lidar(read_velodyne(path), cal, 60, 120)
        assert np.isfinite(depth_m).all()
        assert (depth_m >= 0).all()

    survives("LiDAR scan", read)


READERS = {"calibration": read_calibration, "scan": read_velodyne}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "zeros without end"])
def test_what_is_no_file_does_not_keep_a_reader_waiting(
    tmp_path: Path, reader: str, kind: str
) -> None:
    path = tmp_path / "um_000000.txt"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero" if kind == "zeros without end" else "/dev/tty")
    with limited_time(), pytest.raises(DecodeError, match=r"um_000000\.txt: expected"):
        READERS[reader](path)


@pytest.mark.parametrize("reader", READERS)
def test_a_file_of_a_terabyte_is_refused_unread(tmp_path: Path, reader: str) -> None:
    path = tmp_path / "huge"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    tracemalloc.start()
    with limited_time(), pytest.raises(DecodeError, match="of at most"):
        READERS[reader](path)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
