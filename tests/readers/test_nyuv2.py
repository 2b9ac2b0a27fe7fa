"""NYU Depth V2: one MATLAB file, folders of images, and DFormer's pictures of depth."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError, OptionError
from nimprep.export import export_frames
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.recognition import recognised
from tests.fakes import write_png
from tests.scenes import scene

MAT = "nyu_depth_v2_labeled.mat"
CAMERA = (518.857901, 519.469611, 324.582449, 252.736166)
SCENES = ["kitchen_0004", "kitchen_0004", "office_0001", "bathroom_0002a", "office_0001"]
TRAIN, TEST = [1, 2, 4], [3, 5]
"""Counted from 1, as MATLAB does."""


def raw_labels(seed: int) -> np.ndarray:
    """Return labels of 894 classes: 0, 11, 500 and 894 for sky, building, road and car."""
    of = {23: 0, 11: 11, 7: 500, 26: 894}
    return np.vectorize(of.get)(scene(seed).label).astype("u2")


def mapping() -> np.ndarray:
    """Return a map of 894 classes to 40 in which no two of those above have one."""
    mapped = np.arange(894) % 40 + 1
    mapped[[10, 499, 893]] = 2, 40, 17
    return mapped[None].astype("u1")


OF_40 = {23: 255, 11: 2, 7: 40, 26: 17}


def write_mat(root: Path, *, beside: bool = True) -> Path:
    root.mkdir(parents=True)
    made = [scene(seed) for seed in range(len(SCENES))]
    with h5py.File(root / MAT, "w") as file:
        file["images"] = np.stack([each.rgb.transpose(2, 1, 0) for each in made])
        file["depths"] = np.stack([each.depth_m.T for each in made])
        file["rawDepths"] = np.zeros_like(file["depths"][()])
        file["labels"] = np.stack([raw_labels(seed).T for seed in range(len(made))])
        references = np.empty((1, len(made)), h5py.ref_dtype)
        for i, name in enumerate(SCENES):
            text = np.array([[ord(letter)] for letter in name], "u2")
            references[0, i] = file.create_dataset(f"#refs#/{i}", data=text).ref
        file["scenes"] = references
    if beside:
        splits = {"trainNdxs": np.array(TRAIN, "u2")[:, None], "testNdxs": np.array(TEST)[:, None]}
        scipy.io.savemat(root / "splits.mat", splits)
        names = np.empty((1, 40), object)
        names[0, :] = [f"class {i}" for i in range(40)]
        classes = {"className": names, "mapClass": mapping()}
        scipy.io.savemat(root / "classMapping40.mat", classes, do_compression=True)
    return root


def write_folders(root: Path) -> Path:
    for split, seeds in (("train", (0, 1, 2)), ("test", (3,))):
        for seed in seeds:
            made, name = scene(seed), f"{seed:04d}.png"
            millimetres = np.round(made.depth_m * 1000).astype(np.uint16)
            write_png(root / split / "rgb" / name, made.rgb)
            write_png(root / split / "depth" / name, millimetres)
            write_png(root / split / "depth_raw" / name, np.zeros_like(millimetres))
            label = np.where(made.label == 7, 2, np.where(made.label == 11, 1, 0))
            write_png(root / split / "semantic_40" / name, label.astype(np.uint8))
            write_png(root / split / "semantic_13" / name, np.full_like(made.label, 13))
    return root


@pytest.mark.parametrize("given", ["folder", "file"])
def test_the_file_is_what_it_says_and_what_lies_beside_it(tmp_path: Path, given: str) -> None:
    root = write_mat(tmp_path / "nyu")
    reader = open_reader(root if given == "folder" else root / MAT)
    assert reader.info.name == "nyuv2"
    assert reader.ids == tuple(f"{n:06d}" for n in range(5))
    assert [(c.id, c.name) for c in reader.info.classes][:2] == [(1, "wall"), (2, "floor")]
    assert len(reader.info.classes) == 40
    for seed, frame_id in enumerate(reader.ids):
        frame, made = reader.read(frame_id), scene(seed)
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(CAMERA, abs=1e-9)
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        np.testing.assert_array_equal(frame.depth_m, made.depth_m)
        np.testing.assert_array_equal(frame.label, np.vectorize(OF_40.get)(made.label))
        assert reader.group(frame_id) == SCENES[seed]
        assert reader.fixed_split(frame_id) == ("train" if seed + 1 in TRAIN else "test")


def test_train_ids_are_the_classes_from_0(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu")
    for folder in (root, write_folders(tmp_path / "folders")):
        plain = open_reader(folder)
        counted = open_reader(folder, ReaderOptions(label_set="train-ids"))
        assert [c.id for c in counted.info.classes] == list(range(40))
        assert [c.name for c in counted.info.classes] == [c.name for c in plain.info.classes]
        for frame_id in plain.ids:
            one, other = plain.read(frame_id).label, counted.read(frame_id).label
            assert one is not None
            np.testing.assert_array_equal(other, np.where(one == 255, 255, one - 1))


def test_train_ids_are_exported_as_the_networks_have_the_classes(tmp_path: Path) -> None:
    root = write_folders(tmp_path / "nyu")
    store = nimprep.convert(root, tmp_path / "o.zarr", label_set="train-ids")
    with pytest.warns(UserWarning, match="8 bits"):
        export_frames(store, tmp_path / "out", "rgbx")
    for frame_id in store.ids:
        split, name = frame_id.split("/")
        raw = cv2.imread(str(root / split / "semantic_40" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        path = tmp_path / "out" / "Label" / f"{split}%2F{name}.png"
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), raw)
    names = (tmp_path / "out" / "classes.txt").read_text().split("\n")
    assert len([name for name in names if name]) == 40


def test_folders_are_read_with_depth_in_millimetres(tmp_path: Path) -> None:
    reader = open_reader(write_folders(tmp_path / "nyu"))
    assert reader.info.name == "nyuv2"
    assert reader.ids == ("test/0003", "train/0000", "train/0001", "train/0002")
    for frame_id in reader.ids:
        split, name = frame_id.split("/")
        frame, made = reader.read(frame_id), scene(int(name))
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(CAMERA, abs=1e-9)
        assert reader.fixed_split(frame_id) == split
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        np.testing.assert_allclose(frame.depth_m, made.depth_m, atol=0.5001e-3)
        of = {23: 255, 11: 1, 7: 2, 26: 255}
        np.testing.assert_array_equal(frame.label, np.vectorize(of.get)(made.label))


def test_convert_needs_no_option_and_counts_heights_from_the_lowest(tmp_path: Path) -> None:
    for root in (write_mat(tmp_path / "mat") / MAT, write_folders(tmp_path / "folders")):
        store = nimprep.convert(root, tmp_path / f"{root.stem}.zarr")
        assert store.about.dataset == "nyuv2"
        assert "ECCV 2012" in store.about.references[0]["citation"]
        assert open_reader(root).info.hha_ground == "lowest"
        assert {*store.splits.values()} == {"train", "test"}


def test_without_what_lies_beside_it_is_said_what_is_left_out(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu", beside=False)
    reader = open_reader(root)
    assert reader.info.classes == ()
    assert {reader.fixed_split(i) for i in reader.ids} == {None}
    assert any("no labels: the file has 894 classes" in note for note in reader.info.notes)
    assert any("splits.mat is not beside" in note for note in reader.info.notes)
    # A map of one's own needs none.
    with pytest.raises(LayoutError, match="label"):
        open_reader(root, ReaderOptions(label_map="0-893:41"))
    reader = open_reader(root, ReaderOptions(label_map="0-893:2,894:3"))
    assert {*np.unique(reader.read("000000").label)} == {2, 3}


def test_the_split_may_lie_elsewhere(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu")
    shutil.move(root / "splits.mat", tmp_path / "splits.mat")
    for lists in (tmp_path, tmp_path / "splits.mat"):
        reader = open_reader(root, ReaderOptions(lists=lists))
        assert reader.fixed_split("000002") == "test"
    with pytest.raises(LayoutError, match=r"expected the official split splits\.mat, found none"):
        open_reader(root, ReaderOptions(lists=root))
    with pytest.raises(OptionError, match="--lists: expected none with this form of nyuv2"):
        open_reader(write_folders(tmp_path / "folders"), ReaderOptions(reader="nyuv2", lists=root))


@pytest.mark.parametrize(
    ("train", "test", "said"),
    [
        ([0, 1], [2], r"numbers of frames from 1 to 5 as 'trainNdxs', found 0"),
        ([1, 2], [3, 6], r"numbers of frames from 1 to 5 as 'testNdxs', found 6"),
        ([1, 2], [2, 3], "expected each frame in one split, found 2 in both"),
    ],
)
def test_a_split_of_other_frames_is_refused(
    tmp_path: Path, train: list[int], test: list[int], said: str
) -> None:
    root = write_mat(tmp_path / "nyu")
    scipy.io.savemat(root / "splits.mat", {"trainNdxs": train, "testNdxs": test})
    with pytest.raises(LayoutError, match=said):
        open_reader(root)


def test_frames_in_no_split_are_said(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu")
    scipy.io.savemat(root / "splits.mat", {"trainNdxs": [1, 2], "testNdxs": [5]})
    reader = open_reader(root)
    assert [reader.fixed_split(i) for i in reader.ids] == ["train", "train", "none", "none", "test"]
    assert any("2 of 5 frames are in no official split" in note for note in reader.info.notes)


def test_files_beside_that_are_none_are_refused(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu")
    scipy.io.savemat(root / "classMapping40.mat", {"mapClass": np.full((1, 894), 41)})
    with pytest.raises(LayoutError, match=r"expected classes 1 to 40 as 'mapClass', found \[41\]"):
        open_reader(root)
    # Fewer than the file has: what is not mapped is named when it is met.
    scipy.io.savemat(root / "classMapping40.mat", {"mapClass": mapping()[:, :600]})
    with pytest.raises(DecodeError, match="expected labels of the description's map, found 894"):
        open_reader(root).read("000000")
    (root / "classMapping40.mat").write_bytes(b"<html>not found</html>" * 30)
    with pytest.raises(DecodeError, match=r"classMapping40.mat: expected a MATLAB file"):
        open_reader(root)
    assert len(open_reader(root, labels=False).ids) == 5


def write_dformer(root: Path, *, bits: int = 8) -> Path:
    for seed in range(3):
        made, name = scene(seed), f"{seed}.png"
        stretched = made.depth_m / made.depth_m.max() * (2**bits - 1)
        write_png(root / "RGB" / name, made.rgb)
        write_png(root / "Depth" / name, stretched.astype(f"u{bits // 8}"))
        write_png(root / "Label" / name, made.label)
    (root / "train.txt").write_text("RGB/0.png Label/0.png\n")
    (root / "test.txt").write_text("RGB/1.png Label/1.png\n")
    return root


def test_depth_of_dformer_is_refused_by_name(tmp_path: Path) -> None:
    root = write_dformer(tmp_path / "NYUDepthv2")
    said = "in which DFormer, CMX and Sigma have NYUv2.*8 bits, stretched per image"
    for reader in ("auto", "nyuv2"):
        with pytest.raises(LayoutError, match=said) as told:
            open_reader(root, ReaderOptions(reader=reader))
        assert "\n" not in str(told.value)
    assert any("DFormer" in note for note in inspect_source(root).notes)
    # With its lists or without.
    for path in sorted(root.glob("*.txt")):
        path.unlink()
    with pytest.raises(LayoutError, match=said):
        open_reader(root)
    # Of 16 bits it is somebody's own.
    with pytest.raises(LayoutError, match="expected a known layout") as told:
        open_reader(write_dformer(tmp_path / "own", bits=16))
    assert "DFormer" not in str(told.value)


def test_a_wrong_folder_is_answered_with_the_right_one(tmp_path: Path) -> None:
    folders = write_folders(tmp_path / "a" / "nyu")
    file = write_mat(tmp_path / "b" / "nyu")
    for inner, meant in ((folders / "train", folders), (folders / "train" / "rgb", folders)):
        with pytest.raises(LayoutError, match=f"did you mean {meant}\\?"):
            open_reader(inner)
    for outer, meant in ((tmp_path / "a", folders), (tmp_path / "b", file)):
        with pytest.raises(LayoutError, match=f"did you mean {meant}\\?"):
            open_reader(outer)


@pytest.mark.parametrize(
    ("folder", "said"),
    [
        ("rgb", r"for nyuv2 it lacks '{train,test}/rgb/\*.\*'; unpack .*the folders rgb there"),
        ("depth", "expected depth files .*unpack the folders depth there"),
        ("semantic_40", "expected label files .*unpack the folders semantic_40.*--no-labels"),
    ],
)
def test_a_folder_that_is_not_there_is_named(tmp_path: Path, folder: str, said: str) -> None:
    root = write_folders(tmp_path / "nyu")
    for path in sorted(root.glob(f"*/{folder}")):
        shutil.rmtree(path)
    with pytest.raises(LayoutError, match=said):
        open_reader(root)


def test_inspect_names_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = write_mat(tmp_path / "nyu")
    for source in (root, root / MAT):
        found = inspect_source(source)
        assert (found.kind, found.reader) == ("reader", "nyuv2")
        # What lies beside it no description says.
        assert found.description is None
    found = inspect_source(write_folders(tmp_path / "folders"))
    assert found.reader == "nyuv2"
    assert found.description is not None
    assert recognised(root / MAT).root == root
    assert main(["inspect", str(root / MAT)], standalone_mode=False) is None
    assert "5 frames in the layout nyuv2" in capsys.readouterr().out


def test_another_file_is_none(tmp_path: Path) -> None:
    root = write_mat(tmp_path / "nyu")
    with pytest.raises(LayoutError, match="expected a dataset's folder, found a file"):
        open_reader(root / "splits.mat")


def test_the_real_frame_reads_as_folders_have_it(reference_data: Path, tmp_path: Path) -> None:
    raw = cv2.imread(str(reference_data / "nyu_hha" / "depth_filled.png"), cv2.IMREAD_UNCHANGED)
    for kind, image in (
        ("rgb", np.zeros((*raw.shape, 3), np.uint8)),
        ("depth", (raw // 10).astype(np.uint16)),
        ("semantic_40", np.ones(raw.shape, np.uint8)),
    ):
        for split in ("train", "test"):
            write_png(tmp_path / split / kind / "0000.png", image)
    frame = open_reader(tmp_path).read("train/0000")
    assert frame.depth_m is not None
    np.testing.assert_array_equal(frame.depth_m, (raw // 10) / np.float32(1000))
    # Its camera is the one of the frame's own page, less the 1 that MATLAB counts from.
    assert (frame.camera.cx, frame.camera.cy) == pytest.approx((324.58245, 252.73617), abs=1e-5)
