"""Real and made datasets through `convert`: no doubt where they are read rightly, one where not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import DecodeError
from nimprep.images import read_depth
from nimprep.store.validate import validate_store
from nimprep.synthetic import write_synthetic
from tests.fakes import write_png

MODALITIES = ("rgb", "depth", "label")


def kinds(source: Path, target: Path, **options: object) -> list[str]:
    store = nimprep.convert(source, target, **options)
    return [doubt["kind"] for doubt in store.about.doubts]


@pytest.mark.parametrize("name", ["gmrp", "kitti_road"])
@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_real_datasets_are_converted_without_a_doubt(
    reference_data: Path, tmp_path: Path, name: str
) -> None:
    assert kinds(reference_data / name, tmp_path / "s.zarr", modalities=MODALITIES) == []


def doubts(source: Path, target: Path, **options: object) -> dict[str, str]:
    store = nimprep.convert(source, target, **options)
    return {doubt["kind"]: doubt["text"] for doubt in store.about.doubts}


@pytest.fixture
def scan(reference_data: Path, tmp_path: Path) -> Path:
    """Return a KITTI road of one frame that has a LiDAR scan."""
    frame = reference_data / "kitti_lidar"
    other = reference_data / "kitti_road/training/calib/um_000000.txt"
    folder = tmp_path / "road/training"
    for name in ("image_2", "velodyne", "calib"):
        (folder / name).mkdir(parents=True)
    shutil.copy(frame / "image_2/000000.png", folder / "image_2/um_000000.png")
    shutil.copy(frame / "velodyne/000000.bin", folder / "velodyne/um_000000.bin")
    # The object benchmark does not say where the road is.
    (road,) = (s for s in other.read_text().splitlines() if s.startswith("Tr_cam_to_road"))
    numbers = (frame / "calib/000000.txt").read_text().rstrip()
    (folder / "calib/um_000000.txt").write_text(f"{numbers}\n{road}\n")
    return tmp_path / "road"


@pytest.mark.parametrize(("sparse", "expected"), [(True, ["sparse"]), (False, [])])
def test_kitti_s_scans_are_doubted_as_measured_and_not_as_filled(
    scan: Path, tmp_path: Path, sparse: bool, expected: list[str]
) -> None:
    options = {"labels": False, "sparse": sparse, "modalities": MODALITIES[:2]}
    assert kinds(scan, tmp_path / "s.zarr", **options) == expected


@pytest.mark.parametrize("normals", ["nim", "nim-edge"])
def test_of_a_scan_as_measured_it_is_said_how_much_has_no_normal(
    scan: Path, tmp_path: Path, normals: str
) -> None:
    options = {"labels": False, "sparse": True, "modalities": ("rgb", "depth", "normal")}
    found = doubts(scan, tmp_path / "s.zarr", normals=normals, **options)
    # Of the rows that are looked at; of all 83.3 %.
    assert found.keys() == {"sparse"}
    assert " 82.5% have no normal, none being beside them; " in found["sparse"]
    assert found["sparse"].endswith("convert with --fill linear")
    report = validate_store(tmp_path / "s.zarr", deep=True)
    assert (report.problems, report.checks["frames recomputed"]) == ([], 1)
    frame = nimprep.open_store(tmp_path / "s.zarr")[0]
    assert 0.16 < frame.normal.any(axis=-1)[frame.depth_m > 0].mean() < 0.17


@pytest.mark.parametrize(
    ("fill", "expected"), [("nearest", {"staircase"}), ("linear", set()), ("colorization", set())]
)
def test_of_a_scan_that_is_filled_it_is_said_where_steps_remain(
    scan: Path, tmp_path: Path, fill: str, expected: set[str]
) -> None:
    options = {"labels": False, "sparse": True, "modalities": ("rgb", "depth", "normal")}
    found = doubts(scan, tmp_path / "s.zarr", fill=fill, **options)
    assert found.keys() == expected
    assert all("30.1% of the pixels with depth were filled in" in text for text in found.values())
    assert all(text.endswith("convert with --fill linear") for text in found.values())
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []


def test_kitti_s_dense_depth_is_refused_with_its_bytes_swapped(
    reference_data: Path, tmp_path: Path
) -> None:
    shutil.copytree(reference_data / "kitti_road/testing", tmp_path / "road/testing")
    (path,) = (tmp_path / "road/testing/depth_u16").iterdir()
    write_png(path, read_depth(path).byteswap())
    with pytest.raises(DecodeError, match=r"depth_u16/um_000000\.png: .* bytes of its values"):
        nimprep.convert(tmp_path / "road", tmp_path / "s.zarr", modalities=MODALITIES)


def test_a_made_dataset_is_converted_without_a_doubt(tmp_path: Path) -> None:
    write_synthetic(tmp_path / "synth", frames=4)
    assert kinds(tmp_path / "synth", tmp_path / "s.zarr", modalities=MODALITIES) == []
