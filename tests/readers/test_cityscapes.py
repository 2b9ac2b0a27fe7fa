"""Cityscapes, and Lost and Found, whose layout is the same and whose labels are not."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError, OptionError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, disparity_of, scene

CITIES = {"train": ["aachen", "bochum"], "val": ["frankfurt"], "test": ["berlin"]}
SCENES = {"train": ["01_Hanns_Klemm_Str_45", "13_Elly_Beinhorn_Str"], "test": ["04_Maurener_Weg_8"]}
BASELINE_M = 0.2093
# A step of disparity where it is least, at 25 m.
DEPTH = {"rtol": 25 * 0.5 / 256 / (FX * BASELINE_M)}


def write_cityscapes(
    root: Path, cities: Mapping[str, Sequence[str]] = CITIES, labels: str = "gtFine"
) -> dict[str, int]:
    """Write two frames per city; return each frame's seed by its id."""
    seeds: dict[str, int] = {}
    for split, city in ((s, c) for s, names in cities.items() for c in names):
        for k in range(2):
            seed, base = len(seeds), f"{split}/{city}/{city}_{k:06d}_{19 + k:06d}"
            seeds[base] = seed
            made = scene(seed)
            disparity = disparity_of(made.depth_m, (FX + seed) * BASELINE_M)
            raw = np.where(disparity > 0, np.round(disparity * 256 + 1), 0).astype(np.uint16)
            label = made.label
            if labels == "gtCoarse":
                # 0 not labelled, 1 free, 2 and more obstacles.
                label = np.select([label == 7, label == 26], [1, 2 + 17 * seed % 40], 0)
            elif split == "test":
                label = np.zeros_like(label)
            write_png(root / "leftImg8bit" / f"{base}_leftImg8bit.png", made.rgb)
            write_png(root / "rightImg8bit" / f"{base}_rightImg8bit.png", made.rgb)
            write_png(root / "disparity" / f"{base}_disparity.png", raw)
            write_png(root / labels / f"{base}_{labels}_labelIds.png", label.astype(np.uint8))
            write_png(root / labels / f"{base}_{labels}_color.png", made.rgb)
            camera = root / "camera" / f"{base}_camera.json"
            camera.parent.mkdir(parents=True, exist_ok=True)
            intrinsic = {"fx": FX + seed, "fy": FY, "u0": CX, "v0": CY}
            extrinsic = {"baseline": BASELINE_M, "pitch": 0.03, "x": 1.7, "y": 0.1, "z": 1.2}
            camera.write_text(json.dumps({"extrinsic": extrinsic, "intrinsic": intrinsic}))
    return seeds


@pytest.mark.parametrize(
    "place", ["{0}", "{0}_trainvaltest/{0}", "{0}_trainvaltest", "{0}/{0}"], ids=str
)
def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path, place: str) -> None:
    seeds = write_cityscapes(tmp_path / "made")
    for folder in sorted((tmp_path / "made").iterdir()):
        target = tmp_path / "cs" / place.format(folder.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(folder, target)
    reader = open_reader(tmp_path / "cs")
    assert reader.info.name == "cityscapes"
    assert [(c.id, c.name) for c in reader.info.classes] == [(0, "other"), (1, "road")]
    assert reader.ids == tuple(sorted(seeds))
    for frame_id, seed in seeds.items():
        split, city, _ = frame_id.split("/")
        frame, made = reader.read(frame_id), scene(seed)
        assert (reader.group(frame_id), reader.fixed_split(frame_id)) == (city, split)
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX + seed, FY, CX, CY)
        assert frame.baseline_m == BASELINE_M
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        assert frame.depth_m is not None
        np.testing.assert_array_equal(frame.depth_m > 0, made.depth_m > 0)
        np.testing.assert_allclose(frame.depth_m, made.depth_m, **DEPTH)
        expected = (made.label == 7).astype(np.uint8)
        np.testing.assert_array_equal(frame.label, 255 if split == "test" else expected)


def test_label_ids_become_what_was_asked_for(tmp_path: Path) -> None:
    write_cityscapes(tmp_path)
    # Every id there is, in a row of one image.
    path = tmp_path / "gtFine/train/aachen/aachen_000000_000019_gtFine_labelIds.png"
    ids = np.zeros((24, 36), np.uint8)
    ids[:, :34] = np.arange(34)
    write_png(path, ids)
    of_train = [7, 8, 11, 12, 13, 17, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 31, 32, 33]
    expected = {
        "road": [255] * 7 + [1] + [0] * 26,
        "train-ids": [of_train.index(i) if i in of_train else 255 for i in range(34)],
        "ids": list(range(34)),
    }
    for label_set, values in expected.items():
        reader = open_reader(tmp_path, ReaderOptions(label_set=label_set))
        label = reader.read("train/aachen/aachen_000000_000019").label
        assert label is not None
        assert label[0, :34].tolist() == values
        assert {*values} - {255} == {c.id for c in reader.info.classes}
    names = [
        c.name for c in open_reader(tmp_path, ReaderOptions(label_set="train-ids")).info.classes
    ]
    assert names[:3] == ["road", "sidewalk", "building"]
    assert names[-1] == "bicycle"
    write_png(path, np.full((24, 36), 77, np.uint8))
    with pytest.raises(DecodeError, match="found 77"):
        open_reader(tmp_path).read("train/aachen/aachen_000000_000019")


def test_coarse_labels_are_taken_without_fine_ones(tmp_path: Path) -> None:
    write_cityscapes(tmp_path)
    for path in sorted((tmp_path / "gtFine").rglob("*_labelIds.png")):
        if "/test/" not in path.as_posix():
            moved = Path(path.as_posix().replace("gtFine", "gtCoarse"))
            moved.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, moved)
    reader = open_reader(tmp_path)
    assert reader.info.name == "cityscapes"
    fine = {i: reader.read(i).label for i in reader.ids}
    shutil.rmtree(tmp_path / "gtFine")
    coarse = open_reader(tmp_path)
    assert coarse.info.name == "cityscapes"
    assert coarse.ids == reader.ids
    for frame_id in coarse.ids:
        np.testing.assert_array_equal(coarse.read(frame_id).label, fine[frame_id])


def test_further_splits_are_left_out_and_said(tmp_path: Path) -> None:
    seeds = write_cityscapes(tmp_path)
    write_cityscapes(tmp_path / "more", {"train_extra": ["erlangen"], "demoVideo": ["stuttgart"]})
    for folder in ("leftImg8bit", "disparity", "camera"):
        for split in ("train_extra", "demoVideo"):
            shutil.move(tmp_path / "more" / folder / split, tmp_path / folder / split)
    reader = open_reader(tmp_path)
    assert reader.ids == tuple(sorted(seeds))
    assert any("4 of 12 frames are left out" in note for note in reader.info.notes)


def test_lost_and_found_has_labels_of_its_own(tmp_path: Path) -> None:
    seeds = write_cityscapes(tmp_path, SCENES, "gtCoarse")
    reader = open_reader(tmp_path)
    assert reader.info.name == "lost-and-found"
    assert reader.info.reference is not None
    assert "IROS 2016" in reader.info.reference.citation
    assert [(c.id, c.name) for c in reader.info.classes] == [(1, "free"), (2, "obstacle")]
    assert reader.ids == tuple(sorted(seeds))
    for frame_id, seed in seeds.items():
        split, place, _ = frame_id.split("/")
        assert (reader.group(frame_id), reader.fixed_split(frame_id)) == (place, split)
        frame, made = reader.read(frame_id), scene(seed)
        expected = np.select([made.label == 7, made.label == 26], [1, 2], 255)
        np.testing.assert_array_equal(frame.label, expected)
        np.testing.assert_allclose(frame.depth_m, made.depth_m, **DEPTH)
    with pytest.raises(OptionError, match=r"--labels: expected none with .*lost-and-found"):
        open_reader(tmp_path, ReaderOptions(label_set="road"))


@pytest.mark.parametrize(
    ("folder", "archive"),
    [
        ("disparity", "disparity_trainvaltest.zip"),
        ("gtFine", "gtFine_trainvaltest.zip"),
        ("camera", "camera_trainvaltest.zip"),
        ("leftImg8bit", "leftImg8bit_trainvaltest.zip"),
    ],
)
def test_an_archive_that_was_not_unpacked_is_named(
    tmp_path: Path, folder: str, archive: str
) -> None:
    write_cityscapes(tmp_path)
    shutil.rmtree(tmp_path / folder)
    with pytest.raises(LayoutError, match=rf"{folder}.*unpack {archive} there"):
        open_reader(tmp_path)


def test_a_folder_too_deep_or_too_high_is_answered_with_the_right_one(tmp_path: Path) -> None:
    root = tmp_path / "data" / "cs"
    write_cityscapes(root)
    for wrong in (root / "leftImg8bit", root / "gtFine" / "train", tmp_path, tmp_path / "data"):
        with pytest.raises(LayoutError, match=rf"did you mean {root}\?"):
            open_reader(wrong)
    archive = root / "leftImg8bit_trainvaltest"
    archive.mkdir()
    shutil.move(root / "leftImg8bit", archive / "leftImg8bit")
    with pytest.raises(LayoutError, match=rf"did you mean {root}\?"):
        open_reader(archive)


def test_inspect_writes_the_description_that_it_is_read_by(tmp_path: Path) -> None:
    root = tmp_path / "cs"
    write_cityscapes(root)
    shutil.move(root / "disparity", root / "d")
    (root / "disparity_trainvaltest").mkdir()
    shutil.move(root / "d", root / "disparity_trainvaltest" / "disparity")
    found = inspect_source(root)
    assert found.reader == "cityscapes"
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(root, ReaderOptions(description=tmp_path / "d.json"))
    assert described.info == open_reader(root).info
    assert described.ids == open_reader(root).ids
