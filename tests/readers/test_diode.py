"""DIODE: floats in NumPy files with a mask, rooms and streets."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.recognition import recognised
from tests.fakes import write_png
from tests.scenes import scene

FRAMES = (
    ("train", "indoors", "scene_00000", "scan_00000"),
    ("train", "outdoor", "scene_00001", "scan_00003"),
    ("train", "outdoor", "scene_00001", "scan_00004"),
    ("val", "indoors", "scene_00019", "scan_00183"),
)


def depth(seed: int) -> np.ndarray:
    """Return depth with values where the mask has none, and far ones outdoors."""
    made = scene(seed).depth_m.copy()
    made[:3] = 1.25
    if FRAMES[seed][1] == "outdoor":
        made[made == 25] = 271.5
    return made


def mask(seed: int) -> np.ndarray:
    made = np.ones_like(scene(seed).depth_m)
    made[:3], made[12:14, 5:9] = 0, 0
    return made


def write_diode(root: Path, places: tuple[str, ...] = ("indoors", "outdoor")) -> list[str]:
    """Write a frame per scan; return their ids."""
    ids = []
    for seed, (split, place, inner, scan) in enumerate(FRAMES):
        if place not in places:
            continue
        name = f"{inner[-5:]}_{scan[-5:]}_{place}_000_0{seed}0"
        folder = root / split / place / inner / scan
        write_png(folder / f"{name}.png", scene(seed).rgb)
        np.save(folder / f"{name}_depth.npy", depth(seed)[..., None])
        np.save(folder / f"{name}_depth_mask.npy", mask(seed))
        np.save(folder / f"{name}_normal.npy", np.zeros((24, 36, 3), np.float32))
        ids.append(f"{split}/{place}/{inner}/{scan}/{name}")
    return ids


def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path) -> None:
    ids = write_diode(tmp_path / "diode")
    reader = open_reader(tmp_path / "diode")
    assert reader.info.name == "diode"
    assert reader.ids == tuple(sorted(ids))
    assert reader.info.classes == ()
    for seed, frame_id in enumerate(ids):
        frame = reader.read(frame_id)
        assert reader.fixed_split(frame_id) == FRAMES[seed][0]
        assert reader.group(frame_id) == FRAMES[seed][2]
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (886.81, 927.06, 512, 384)
        np.testing.assert_array_equal(frame.rgb, scene(seed).rgb)
        np.testing.assert_array_equal(frame.depth_m, np.where(mask(seed) > 0, depth(seed), 0))


def test_convert_needs_no_option_and_keeps_what_is_far(tmp_path: Path) -> None:
    ids = write_diode(tmp_path / "diode")
    store = nimprep.convert(tmp_path / "diode", tmp_path / "o.zarr")
    assert store.about.dataset == "diode"
    assert store.about.references[0]["licence"] == "MIT"
    assert store.modality("depth").step == pytest.approx(0.01)
    far = store[list(store.ids).index(ids[1])].depth_m
    assert far is not None
    np.testing.assert_allclose(far[5, 0], 271.5)
    assert open_reader(tmp_path / "diode").info.hha_ground is None


def test_rooms_alone_are_kept_to_the_millimetre(tmp_path: Path) -> None:
    write_diode(tmp_path / "diode", ("indoors",))
    assert open_reader(tmp_path / "diode").info.hha_ground == "lowest"
    store = nimprep.convert(tmp_path / "diode", tmp_path / "o.zarr")
    assert store.modality("depth").step == pytest.approx(0.001)


def test_a_wrong_folder_is_answered_with_the_right_one(tmp_path: Path) -> None:
    root = tmp_path / "a" / "diode"
    write_diode(root)
    for folder in (root.parent, root / "train", root / "val" / "indoors"):
        with pytest.raises(LayoutError, match=f"did you mean {root}\\?"):
            open_reader(folder)


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("*_depth.npy", "expected depth files .*unpack train.tar.gz and val.tar.gz there"),
        (
            "*_depth_mask.npy",
            "expected depth confidence files .*unpack train.tar.gz and val",
        ),
        ("*.png", r"for diode it lacks .*\.png'; unpack train.tar.gz and val.tar.gz there"),
    ],
)
def test_a_part_that_is_not_there_is_named(tmp_path: Path, pattern: str, said: str) -> None:
    write_diode(tmp_path / "diode")
    for path in sorted((tmp_path / "diode").rglob(pattern)):
        path.unlink()
    with pytest.raises(LayoutError, match=said):
        open_reader(tmp_path / "diode")


def test_a_frame_that_lacks_its_mask_is_a_bad_frame(tmp_path: Path) -> None:
    ids = write_diode(tmp_path / "diode")
    next((tmp_path / "diode" / "val").rglob("*_mask.npy")).unlink()
    reader = open_reader(tmp_path / "diode")
    with pytest.raises(DecodeError, match="depth_mask"):
        reader.read(ids[3])
    assert reader.read(ids[0]).depth_m is not None


def test_one_archive_alone_is_read(tmp_path: Path) -> None:
    ids = write_diode(tmp_path / "diode")
    shutil.rmtree(tmp_path / "diode" / "train")
    assert open_reader(tmp_path / "diode").ids == (ids[3],)


def test_inspect_names_it_and_its_description_reads_the_same(tmp_path: Path) -> None:
    root = tmp_path / "diode"
    write_diode(root)
    found = inspect_source(root)
    assert found.reader == recognised(root).reader == "diode"
    assert found.description is not None
    assert found.description["name"] == "diode"
    assert open_reader(root, ReaderOptions(reader="diode")).ids == open_reader(root).ids
