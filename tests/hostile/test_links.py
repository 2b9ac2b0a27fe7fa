"""Links and names in a dataset's folder: read through, never round in circles, never written to."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.kitti.archive import ZipWhole
from nimprep.kitti.depth import write_depth
from nimprep.kitti.submission import pack_submission
from nimprep.readers import open_reader
from tests.fakes import write_gmrp, write_png
from tests.hostile.conftest import CAMERA
from tests.hostile.fuzzing import limited_time, survives
from tests.kitti.scenes import road_folder


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp", frames=3)


def test_a_link_to_a_file_elsewhere_is_read(gmrp: Path, tmp_path: Path) -> None:
    path = gmrp / "rgb" / "000001.png"
    path.rename(tmp_path / "on_another_disk.png")
    path.symlink_to(tmp_path / "on_another_disk.png")
    assert open_reader(gmrp).read("000001").rgb is not None


@pytest.mark.parametrize("target", ["/", "..", "../..", "."])
def test_a_link_to_what_holds_the_dataset_is_refused(gmrp: Path, target: str) -> None:
    (gmrp / "rgb" / "more").symlink_to(gmrp / target if target == "." else target)
    with limited_time(), pytest.raises(LayoutError, match="which holds the dataset"):
        open_reader(gmrp)


def test_links_in_circles_end(gmrp: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for name in "abc":
        (elsewhere / name).symlink_to(elsewhere)
        (gmrp / "rgb" / name).symlink_to(elsewhere)
    (gmrp / "rgb" / "d").symlink_to("d")
    with limited_time():
        assert len(open_reader(gmrp).ids) == 3


@pytest.mark.parametrize("target", ["/dev/zero", "/dev/tty", "000001.png", "nowhere", "pipe"])
@pytest.mark.parametrize("layout", ["gmrp", "kitti"])
def test_a_link_to_no_image_is_refused(tmp_path: Path, layout: str, target: str) -> None:
    if layout == "gmrp":
        root = write_gmrp(tmp_path / "raw", frames=3)
        path = root / "rgb" / "000001.png"
    else:
        root = road_folder(tmp_path / "raw")
        path = root / "training" / "image_2" / "um_000000.png"
    path.unlink()
    if target == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(target)

    def read() -> None:
        reader = open_reader(root)
        for frame_id in reader.ids:
            reader.read(frame_id)

    with limited_time(), pytest.raises(NimprepError, match="expected"):
        read()


@pytest.mark.parametrize(
    "where", ["training/calib/um_000000.txt", "training/depth_u16/um_000000.png"]
)
def test_a_link_without_end_beside_a_kitti_frame_is_refused(tmp_path: Path, where: str) -> None:
    root = road_folder(tmp_path / "raw")
    (root / where).unlink()
    (root / where).symlink_to("/dev/zero")
    with limited_time(), pytest.raises(NimprepError, match="expected"):
        open_reader(root).read("training/um_000000")


def snapshot(folder: Path) -> dict[str, bytes | None]:
    paths = sorted(folder.rglob("*"))
    return {str(p): p.read_bytes() if p.is_file() else None for p in paths}


def test_converting_writes_through_no_link_in_the_source(gmrp: Path, tmp_path: Path) -> None:
    (gmrp / "camera.json").write_text(CAMERA)
    outside = tmp_path / "outside"
    write_gmrp(outside, frames=3)
    for folder in ("rgb", "depth_u16", "label"):
        (gmrp / folder / "more").symlink_to(outside / folder)
    before = snapshot(outside), snapshot(gmrp)
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", modalities=("rgb", "depth"))
    assert store.ids == (*(f"{n:06d}" for n in range(3)), *(f"more/{n:06d}" for n in range(3)))
    assert (snapshot(outside), snapshot(gmrp)) == before


def test_depth_goes_to_the_folder_that_was_asked_for(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "raw")
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"mine")
    place = tmp_path / "out" / "training" / "depth_u16"
    place.mkdir(parents=True)
    (place / "um_000000.png").symlink_to(outside)
    write_depth(root, tmp_path / "out", overwrite=True)
    assert outside.read_bytes() == b"mine"
    assert not (place / "um_000000.png").is_symlink()


NAMES = [
    "um_road_000000.png\n.png",
    "a\\..\\um_road_000001.png",
    "um_road_000001.png;.png",
    "C:um_road_000002.png",
    "um_road_000003.png.png",
    "um_road_٠٠٠٠٠٤.png",
    "UM_ROAD_000005.PNG",
    "um_road_00000\u200b6.png",
    "\udcff.png",
]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_is_not_the_benchmarks_never_gets_into_the_zip(
    tmp_path: Path, name: str
) -> None:
    folder = tmp_path / "predictions"
    view = np.random.default_rng(0).integers(0, 255, (800, 400), dtype=np.uint8)
    write_png(folder / "um_road_000000.png", view)
    (folder / "um_road_000000.png").rename(folder / name)
    write_png(folder / "um_road_000001.png", view)
    packed = survives(
        "names for the zip", lambda: pack_submission(folder, tmp_path / "out.zip", partial=True)
    )
    assert packed is None
    assert not (tmp_path / "out.zip").exists()


def test_a_zip_holds_the_official_names_alone_and_replaces_a_link(tmp_path: Path) -> None:
    folder, outside = tmp_path / "predictions", tmp_path / "mine.txt"
    view = np.random.default_rng(0).integers(0, 255, (800, 400), dtype=np.uint8)
    write_png(tmp_path / "elsewhere.png", view)
    folder.mkdir()
    (folder / "um_road_000000.png").symlink_to(tmp_path / "elsewhere.png")
    outside.write_text("mine")
    (tmp_path / "out.zip").symlink_to(outside)
    pack_submission(folder, tmp_path / "out.zip", partial=True, overwrite=True)
    assert outside.read_text() == "mine"
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        assert archive.namelist() == ["um_road_000000.png"]


@pytest.mark.parametrize(
    "name", ["../x.png", "/x.png", "a/../../x.png", "a\\..\\x.png", "", "a\0b"]
)
def test_no_entry_of_a_zip_can_lead_out_of_where_it_is_unpacked(tmp_path: Path, name: str) -> None:
    with pytest.raises(LayoutError, match="expected"), ZipWhole(tmp_path / "a.zip") as archive:
        archive.add(name, b"")
    assert not (tmp_path / "a.zip").exists()


def test_a_pipe_among_predictions_is_refused(tmp_path: Path) -> None:
    (tmp_path / "predictions").mkdir()
    os.mkfifo(tmp_path / "predictions" / "um_road_000000.png")
    with limited_time(), pytest.raises((LayoutError, DecodeError), match="expected"):
        pack_submission(tmp_path / "predictions", tmp_path / "out.zip", partial=True)
