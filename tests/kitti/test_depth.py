"""Dense depth of road folders: sources, units, records, and what is refused."""

from __future__ import annotations

import json
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, DepthLossWarning, LayoutError
from nimprep.kitti.depth import (
    choose_origin,
    frame_depth,
    metres_from_millimetres,
    millimetres_from_metres,
    write_depth,
)
from nimprep.kitti.layout import RoadFiles, list_road_files
from nimprep.schema import schema_problems

from .scenes import (
    CAMERA_HEIGHT_M,
    HEIGHT,
    WIDTH,
    noise,
    read_png,
    road_folder,
    write_calibration,
    write_png,
)


def _scan(path: Path) -> None:
    """The ground as a scanner 1.73 m above it sees it."""
    x, y = np.meshgrid(np.geomspace(2, 60, 400), np.linspace(-30, 30, 400))
    height = np.full(x.size, -(CAMERA_HEIGHT_M + 0.08))
    points = np.stack([x.ravel(), y.ravel(), height, np.zeros(x.size)], axis=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(points.astype("<f4").tobytes())


@pytest.fixture
def files(tmp_path: Path) -> RoadFiles:
    frame = list_road_files(road_folder(tmp_path / "road"))[0]
    _scan(frame.scan)
    write_png(frame.right_image, noise(0, HEIGHT, WIDTH, 3))
    return frame


def test_millimetres_and_metres_are_each_others_inverse() -> None:
    millimetres = np.arange(65536, dtype=np.uint16)
    metres = metres_from_millimetres(millimetres)
    assert metres[1500] == np.float32(1.5)
    assert metres[0] == metres[65535] == 0
    np.testing.assert_array_equal(millimetres_from_metres(metres)[:-1], millimetres[:-1])


def test_depth_too_large_for_16_bits_saturates_and_reads_as_none() -> None:
    far = millimetres_from_metres(np.array([65.534, 65.535, 65.6, 131.1, 1e9], np.float32))
    assert far.tolist() == [65534, 65535, 65535, 65535, 65535]
    assert metres_from_millimetres(far)[1:].tolist() == [0, 0, 0, 0]


def test_sources_are_taken_in_order(files: RoadFiles) -> None:
    assert choose_origin(files) == "depth_u16"
    assert choose_origin(files, sparse=True) == "lidar"
    assert choose_origin(files, "stereo") == "stereo"
    files.depth.unlink()
    assert choose_origin(files) == "lidar"
    files.scan.unlink()
    assert choose_origin(files) == "stereo"
    files.right_image.unlink()
    with pytest.raises(
        LayoutError, match=r"depth_u16/um_000000\.png or velodyne/um_000000\.bin or"
    ):
        choose_origin(files)
    with pytest.raises(LayoutError, match=r"expected velodyne/um_000000\.bin to make depth"):
        choose_origin(files, "lidar")


def test_a_scan_of_flat_ground_becomes_flat_ground(files: RoadFiles) -> None:
    depth_m = frame_depth(files, "lidar")
    rows = np.arange(30, HEIGHT)
    expected = 60.0 * CAMERA_HEIGHT_M / (rows - 20.0)
    # A return falls up to half a row off the pixel's centre.
    off = np.abs(depth_m[30:, 40:80] / expected[:, None] - 1)
    assert (depth_m[30:, 40:80] > 0).all()
    assert off.max() < 0.06
    assert not depth_m[:20].any()


def test_sparse_depth_is_what_was_measured(files: RoadFiles) -> None:
    sparse, dense = frame_depth(files, "lidar", sparse=True), frame_depth(files, "lidar")
    assert 0 < np.count_nonzero(sparse) < np.count_nonzero(dense)
    np.testing.assert_array_equal(dense[sparse > 0], sparse[sparse > 0])


def test_a_folder_of_depth_has_the_benchmarks_layout(files: RoadFiles, tmp_path: Path) -> None:
    road_folder(tmp_path / "road", ("uu_000001",), "testing")
    files.depth.unlink()
    chosen = write_depth(tmp_path / "road", tmp_path / "out")
    assert chosen == {"testing/uu_000001": "depth_u16", "training/um_000000": "lidar"}
    record = json.loads((tmp_path / "out" / "depth.json").read_text())
    assert record["frames"] == chosen
    assert schema_problems(record, "kitti-depth") == []
    written = read_png(tmp_path / "out" / "training" / "depth_u16" / "um_000000.png")
    assert written.dtype == np.uint16
    np.testing.assert_array_equal(metres_from_millimetres(written), frame_depth(files, "lidar"))
    stored = read_png(tmp_path / "out" / "testing" / "depth_u16" / "uu_000001.png")
    assert (stored == 8000).all()


def test_depth_too_far_for_the_images_is_said(tmp_path: Path) -> None:
    frame = list_road_files(road_folder(tmp_path / "road"))[0]
    frame.depth.unlink()
    frame.scan.parent.mkdir(parents=True, exist_ok=True)
    # Straight ahead, the scanner being 0.27 m before the camera: 65.534 and 65.535 m, and 90.
    ahead = np.array([65.264, 65.265, 89.73])
    across = ahead * [-0.1, 0.1, 0.3]
    points = np.stack([ahead + 0.54, across, np.full(3, -0.08), np.zeros(3)], axis=1)
    frame.scan.write_bytes(points.astype("<f4").tobytes())
    with pytest.warns(
        DepthLossWarning, match=r"road: 67 % of the depth, in 1 frame, is 65535"
    ) as w:
        write_depth(tmp_path / "road", tmp_path / "out", sparse=True)
    assert "the farthest at 90 m" in str(w[0].message)
    assert "--depth-unit cm" in str(w[0].message)


def test_saturated_images_that_were_there_are_copied_without_a_word(files: RoadFiles) -> None:
    depth = np.full((HEIGHT, WIDTH), 8000, np.uint16)
    depth[:9] = 65535
    write_png(files.depth, depth)
    root = files.folder.parent
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_depth(root, root.parent / "out")
    written = read_png(root.parent / "out" / "training" / "depth_u16" / "um_000000.png")
    np.testing.assert_array_equal(written, depth)


def test_depth_of_real_stereo_that_is_too_far_is_said(reference_data: Path, tmp_path: Path) -> None:
    with pytest.warns(DepthLossWarning, match=r"7\.5 % of the depth, in 2 frames, .* 683\.328 m"):
        write_depth(reference_data / "kitti_road", tmp_path / "out")


def test_the_written_depth_reads_as_if_it_had_been_there(files: RoadFiles, tmp_path: Path) -> None:
    files.depth.unlink()
    expected = frame_depth(files, "lidar")
    write_depth(tmp_path / "road", tmp_path / "out")
    shutil.copytree(
        tmp_path / "out" / "training" / "depth_u16", files.depth.parent, dirs_exist_ok=True
    )
    assert choose_origin(files) == "depth_u16"
    np.testing.assert_array_equal(frame_depth(files, "depth_u16"), expected)


def test_the_source_is_never_written_to(files: RoadFiles, tmp_path: Path) -> None:
    for out in (tmp_path / "road", tmp_path / "road" / "out"):
        with pytest.raises(LayoutError, match="sources are never written to"):
            write_depth(tmp_path / "road", out)


def test_depth_needs_no_road_calibration(files: RoadFiles) -> None:
    write_calibration(files.calibration, Tr_cam_to_road=None, P3=None)
    assert frame_depth(files, "lidar").any()


BAD_SOURCES = {
    "truncated scan": ("lidar", lambda f: f.scan.write_bytes(b"\0" * 17), "truncated"),
    "a scan that sees nothing": (
        "lidar",
        lambda f: f.scan.write_bytes(np.array([-9, 0, 0, 0], "<f4").tobytes()),
        "expected depth somewhere",
    ),
    "depth of 8 bits": ("depth_u16", lambda f: write_png(f.depth, noise(0, 60, 120)), "8-bit"),
    "depth of another size": (
        "depth_u16",
        lambda f: write_png(f.depth, np.full((60, 119), 9, np.uint16)),
        "expected 120x60 pixels .*found 119x60",
    ),
    "depth of nothing": (
        "depth_u16",
        lambda f: write_png(f.depth, np.full((60, 120), 65535, np.uint16)),
        "no pixel that has any",
    ),
    "a right image of another size": (
        "stereo",
        lambda f: write_png(f.right_image, noise(0, 60, 119, 3)),
        "image_3.*expected 120x60 pixels .*found 119x60",
    ),
    "a calibration without P2": (
        "lidar",
        lambda f: write_calibration(f.calibration, P2=None),
        "expected the matrix P2",
    ),
    "an image of another size than P2's": (
        "lidar",
        lambda f: write_calibration(
            f.calibration, P2=np.array([[721.5377, 0, 600, 0], [0, 721.5377, 170, 0], [0, 0, 1, 0]])
        ),
        "expected 1242x375 pixels for P2 .*found 120x60",
    ),
}


@pytest.mark.parametrize(("source", "damage", "found"), BAD_SOURCES.values(), ids=BAD_SOURCES)
def test_bad_sources_are_named(files: RoadFiles, source, damage, found: str) -> None:
    damage(files)
    with pytest.raises(DecodeError, match=found):
        frame_depth(files, source)


def test_folders_without_frames_or_calibrations_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="expected training/image_2 or testing/image_2"):
        list_road_files(tmp_path)
    write_png(tmp_path / "testing" / "image_2" / "um_000000.png", noise(0, 3, 4, 3))
    with pytest.raises(LayoutError, match=r"um_000000\.txt: expected the calibration of"):
        list_road_files(tmp_path)


def test_a_real_scan_fills_the_lower_image(reference_data: Path) -> None:
    (files,) = list_road_files(reference_data / "kitti_lidar")
    assert files.id == "000000"
    sparse, dense = frame_depth(files, "lidar", sparse=True), frame_depth(files, "lidar")
    assert np.mean(dense[200:] > 0) > 0.99
    np.testing.assert_array_equal(dense[sparse > 0], sparse[sparse > 0])
    assert dense[dense > 0].min() >= sparse[sparse > 0].min()
