"""ORFD, and ORAD-3D, whose layout is the same."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError, OptionError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, scene

SEQUENCES = {
    "training": ["c2021_0228_1819", "y0613_1242"],
    "validation": ["x0613_1627"],
    "testing": ["y2021_0228_1807"],
}
SPLITS = {"training": "train", "validation": "val", "testing": "test"}


def write_orfd(root: Path) -> dict[str, int]:
    """Write two frames per sequence; return each frame's seed by its id."""
    seeds: dict[str, int] = {}
    for split, sequences in SEQUENCES.items():
        for sequence in sequences:
            for _ in range(2):
                seed = len(seeds)
                time, folder = str(1623721491895 + 97 * seed), root / split / sequence
                seeds[f"{split}/{sequence}/{time}"] = seed
                write_frame(folder, time, seed)
    return seeds


def write_frame(folder: Path, time: str, seed: int) -> None:
    made = scene(seed)
    raw = np.round(made.depth_m * 256).astype(np.uint16)
    write_png(folder / "image_data" / f"{time}.png", made.rgb)
    write_png(folder / "dense_depth" / f"{time}.png", raw)
    write_png(folder / "sparse_depth" / f"{time}.png", raw // 3)
    # 255 traversable, 0 not, 128 out of reach.
    label = np.where(made.label == 7, 255, np.where(made.label == 23, 128, 0)).astype(np.uint8)
    write_png(folder / "gt_image" / f"{time}_fillcolor.png", label)
    calib = folder / "calib" / f"{time}.txt"
    calib.parent.mkdir(parents=True, exist_ok=True)
    # Each frame its own, as the recordings' days have.
    calib.write_text(
        f"cam_K: {FX + seed} 0.0 {CX} 0.0 {FY} {CY} 0.0 0.0 1.0 \n"
        "cam_RT: 1 0 0 0 0 0 -1 0.14 0 1 0 0.08 0 0 0 1 \n"
        "lidar_R: -1 0 0 0 -1 0 0 0 1 \nlidar_T: 0 0 0 "
    )
    (folder / "lidar_data").mkdir(exist_ok=True)
    (folder / "lidar_data" / f"{time}.bin").write_bytes(bytes(20))


@pytest.fixture
def orfd(tmp_path: Path) -> Path:
    write_orfd(tmp_path / "ORFD")
    return tmp_path / "ORFD"


def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path) -> None:
    seeds = write_orfd(tmp_path / "ORFD")
    reader = open_reader(tmp_path / "ORFD")
    assert reader.info.name == "orfd"
    assert reader.ids == tuple(sorted(seeds))
    assert [c.name for c in reader.info.classes] == ["not traversable", "traversable"]
    for frame_id, seed in seeds.items():
        split, sequence, _ = frame_id.split("/")
        frame, made = reader.read(frame_id), scene(seed)
        assert reader.group(frame_id) == sequence
        assert reader.fixed_split(frame_id) == SPLITS[split]
        camera = frame.camera
        # Its own calibration; cy is not moved, as the authors' loader does while it resizes.
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX + seed, FY, CX, CY)
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        np.testing.assert_array_equal(frame.label, made.label == 7)
        np.testing.assert_allclose(frame.depth_m, made.depth_m, atol=0.5 / 256)


def test_convert_needs_no_option_and_says_whose_it_is(orfd: Path, tmp_path: Path) -> None:
    store = nimprep.convert(orfd, tmp_path / "o.zarr")
    assert store.about.dataset == "orfd"
    (reference,) = store.about.references
    assert "ICRA 2022" in reference["citation"]
    assert set(reference) == {"title", "licence", "citation", "paper", "url"}
    counts = {name: list(store.splits.values()).count(name) for name in ("train", "val", "test")}
    assert counts == {"train": 4, "val": 2, "test": 2}


def test_the_folder_of_the_archive_is_taken_and_one_too_deep_is_named(
    orfd: Path, tmp_path: Path
) -> None:
    outer = tmp_path / "download"
    shutil.copytree(orfd, outer / "Final_Dataset")
    assert open_reader(outer).ids == open_reader(orfd).ids
    assert open_reader(outer, ReaderOptions(reader="orfd")).ids == open_reader(orfd).ids
    for inner in ("training", "training/y0613_1242", "training/y0613_1242/image_data"):
        with pytest.raises(LayoutError, match=f"did you mean {orfd}\\?"):
            open_reader(orfd / inner)


def test_images_of_any_ending_are_taken(orfd: Path) -> None:
    for path in sorted(orfd.rglob("image_data/*.png")):
        image = cv2.imread(str(path))
        path.unlink()
        cv2.imwrite(str(path.with_suffix(".jpg")), image, [cv2.IMWRITE_JPEG_QUALITY, 100])
    assert len(open_reader(orfd).ids) == 8


@pytest.mark.parametrize(
    ("folder", "said"),
    [
        ("dense_depth", "expected depth files .*dense_depth.*unpack the folders dense_depth"),
        ("gt_image", "expected label files .*gt_image.*unpack the folders gt_image.*--no-labels"),
        ("calib", "expected camera files .*calib.*unpack the folders calib.*give --camera"),
        ("image_data", r"for orfd it lacks '.*image_data.*unpack the folders image_data there"),
    ],
)
def test_a_part_that_is_not_there_is_named(orfd: Path, folder: str, said: str) -> None:
    for path in sorted(orfd.glob(f"*/*/{folder}")):
        shutil.rmtree(path)
    with pytest.raises(LayoutError, match=said):
        open_reader(orfd)


def test_what_is_not_wanted_need_not_be_there(orfd: Path) -> None:
    for folder in ("dense_depth", "gt_image", "calib"):
        for path in sorted(orfd.glob(f"*/*/{folder}")):
            shutil.rmtree(path)
    options = ReaderOptions(reader="orfd", camera=(30, 30, 17, 11))
    assert len(open_reader(orfd, options, labels=False, depth=False).ids) == 8


def test_a_frame_that_lacks_a_file_is_listed(orfd: Path, tmp_path: Path) -> None:
    lost = sorted(orfd.rglob("dense_depth/*.png"))[0]
    lost.unlink()
    with pytest.raises(DecodeError, match="expected depth of frame"):
        nimprep.convert(orfd, tmp_path / "o.zarr")
    store = nimprep.convert(orfd, tmp_path / "o.zarr", on_error="skip")
    assert [frame["id"].rpartition("/")[2] for frame in store.about.skipped] == [lost.stem]


def test_a_split_without_labels_is_to_be_ignored(orfd: Path) -> None:
    shutil.rmtree(orfd / "testing" / "y2021_0228_1807" / "gt_image")
    reader = open_reader(orfd)
    for frame_id in reader.ids:
        label = reader.read(frame_id).label
        assert label is not None
        assert (label == 255).all() == frame_id.startswith("testing/")


def test_options_that_it_has_not_are_refused(orfd: Path) -> None:
    for options in (
        ReaderOptions(label_set="road"),
        ReaderOptions(variations="clone"),
        ReaderOptions(camera_index=1),
        ReaderOptions(lists=orfd),
        ReaderOptions(target="lane"),
    ):
        with pytest.raises(OptionError, match="expected options of the reader orfd"):
            open_reader(orfd, options)


def test_inspect_names_it_and_its_description_reads_the_same(orfd: Path, tmp_path: Path) -> None:
    found = inspect_source(orfd)
    assert (found.kind, found.reader) == ("reader", "orfd")
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(orfd, ReaderOptions(description=tmp_path / "d.json"))
    named = open_reader(orfd)
    assert described.ids == named.ids
    assert described.info == named.info


def test_a_description_that_is_written_is_of_the_folder_that_was_looked_at(
    orfd: Path, tmp_path: Path
) -> None:
    outer = tmp_path / "download"
    shutil.move(orfd, outer / "Final_Dataset")
    found = inspect_source(outer)
    assert found.description is not None
    assert found.description["rgb"].startswith("Final_Dataset/{split}/")
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(outer, ReaderOptions(description=tmp_path / "d.json"))
    assert described.ids == open_reader(outer).ids
    assert (
        described.read(described.ids[0]).camera == open_reader(outer).read(described.ids[0]).camera
    )


def test_inspect_says_what_keeps_it_from_being_read(orfd: Path) -> None:
    for path in sorted(orfd.glob("*/*/dense_depth")):
        shutil.rmtree(path)
    notes = inspect_source(orfd).notes
    assert any("files of orfd, but " in n and "unpack the folders dense_depth" in n for n in notes)


def test_the_real_frame_reads(reference_data: Path) -> None:
    root = reference_data / "orfd"
    reader = open_reader(root)
    (frame_id,) = reader.ids
    assert reader.fixed_split(frame_id) == "test"
    assert any("no labels" in note for note in reader.info.notes)
    frame = reader.read(frame_id)
    path = next(root.rglob("dense_depth/*.png"))
    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert frame.depth_m is not None
    np.testing.assert_array_equal(frame.depth_m, raw / np.float32(256))
    # Above, where the LiDAR does not reach, there is none; below the empty rows hardly a gap.
    assert (frame.depth_m[:104] == 0).all()
