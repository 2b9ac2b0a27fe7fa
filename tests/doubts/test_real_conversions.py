"""Real and made datasets through `convert`: no doubt where they are read rightly, one where not."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import DecodeError
from nimprep.images import read_depth
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


@pytest.mark.parametrize(("sparse", "expected"), [(True, ["sparse"]), (False, [])])
def test_kitti_s_scans_are_doubted_as_measured_and_not_as_filled(
    reference_data: Path, tmp_path: Path, sparse: bool, expected: list[str]
) -> None:
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
    options = {"labels": False, "sparse": sparse, "modalities": MODALITIES[:2]}
    assert kinds(tmp_path / "road", tmp_path / "s.zarr", **options) == expected


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
