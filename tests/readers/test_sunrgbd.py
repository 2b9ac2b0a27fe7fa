"""SUN RGB-D: folders of four sensors, with the labels and the split of its toolbox."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest
import scipy.io

import nimprep
from nimprep.errors import DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.recognition import recognised
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, scene

FRAMES = (
    "kv1/NYUdata/NYU0001",
    "kv2/kinect2data/000002_2014-05-26_14-23-37_260595134347_rgbf000103-resize",
    "realsense/lg/2014_10_21-18_16_30-1311000073",
    "xtion/sun3ddata/brown_bm_1/brown_bm_1",
)
TRAIN = (0, 2)
AUTHORS = "/n/fs/sun3d/data/SUNRGBD/"
RAW = {23: 0, 11: 1, 7: 2, 26: 37}


def size(seed: int) -> tuple[int, int]:
    """Return the size of a frame's images: each sensor has its own."""
    return (24 + 2 * seed, 36)


def write_sunrgbd(root: Path) -> Path:
    for seed, name in enumerate(FRAMES):
        made, folder = scene(seed, size(seed)), root / name
        millimetres = np.round(made.depth_m * 1000).astype(np.uint16)
        rotated = (millimetres << 3) | (millimetres >> 13)
        (folder / "image").mkdir(parents=True)
        path = folder / "image" / f"000010{seed}-000003408271.jpg"
        cv2.imwrite(str(path), made.rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])
        write_png(folder / "depth_bfx" / f"000010{seed}-000003411096.png", rotated)
        write_png(folder / "depth" / f"000010{seed}-000003411096.png", rotated // 2)
        (folder / "intrinsics.txt").write_text(f"{FX + seed} 0 {CX} 0 {FY} {CY} 0 0 1\n")
        (folder / "extrinsics").mkdir()
        (folder / "extrinsics" / "20150118235401.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n")
        (folder / "scene.txt").write_text("furniture_store")
    return root


def texts(*values: str) -> Any:
    made = np.empty((1, len(values)), object)
    made[0, :] = values
    return made


def write_toolbox(folder: Path, order: tuple[int, ...] = (3, 1, 0, 2)) -> Path:
    """Write labels by number in another order than folders have, and what says it."""
    metadata, lists = folder / "Metadata", folder / "traintestSUNRGBD"
    metadata.mkdir(parents=True)
    lists.mkdir()
    with h5py.File(metadata / "SUNRGBD2Dseg.mat", "w") as file:
        for key in ("seglabel", "seglabelall"):
            references = np.empty((len(order), 1), h5py.ref_dtype)
            for number, seed in enumerate(order):
                label = np.vectorize(RAW.get)(scene(seed, size(seed)).label).astype("u1")
                label = label if key == "seglabel" else label * 0
                references[number, 0] = file.create_dataset(
                    f"#refs#/{key}{number}", data=label.T
                ).ref
            file[f"SUNRGBD2Dseg/{key}"] = references
    frames = np.empty((1, len(order)), [(n, object) for n in ("sequenceName", "K", "rgbpath")])
    for number, seed in enumerate(order):
        image = f"{AUTHORS}{FRAMES[seed]}/image/1.jpg"
        frames[0, number] = (f"SUNRGBD/{FRAMES[seed]}", np.eye(3), image)
    scipy.io.savemat(metadata / "SUNRGBDMeta.mat", {"SUNRGBDMeta": frames}, do_compression=True)
    train = [AUTHORS + FRAMES[seed] for seed in TRAIN]
    test = [f"{AUTHORS}/{name}/" for i, name in enumerate(FRAMES) if i not in TRAIN]
    split = {"alltrain": texts(*train, f"{AUTHORS}kv1/b3dodata/img_0063"), "alltest": texts(*test)}
    scipy.io.savemat(lists / "allsplit.mat", split)
    return folder


@pytest.mark.parametrize("place", ["beside", "in", "archive"])
def test_frames_are_what_the_folders_and_the_toolbox_say(tmp_path: Path, place: str) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    write_toolbox((root if place == "in" else tmp_path) / "SUNRGBDtoolbox")
    reader = open_reader(tmp_path if place == "archive" else root)
    assert reader.info.name == "sunrgbd"
    assert reader.ids == FRAMES
    assert [c.id for c in reader.info.classes] == list(range(1, 38))
    for seed, frame_id in enumerate(FRAMES):
        frame, made = reader.read(frame_id), scene(seed, size(seed))
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (FX + seed, FY, CX, CY)
        assert camera.shape == size(seed)
        assert frame.rgb is not None
        assert np.abs(frame.rgb.astype(int) - made.rgb).mean() < 2
        # Nothing is farther than 8 m, as the authors' tools have it.
        expected = np.minimum(np.round(made.depth_m, 3), 8)
        np.testing.assert_allclose(frame.depth_m, expected, atol=0.5001e-3)
        of = {value: 255 if raw == 0 else raw for value, raw in RAW.items()}
        np.testing.assert_array_equal(frame.label, np.vectorize(of.get)(made.label))
        assert reader.fixed_split(frame_id) == ("train" if seed in TRAIN else "test")


def test_train_ids_are_the_classes_from_0(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    write_toolbox(root / "SUNRGBDtoolbox")
    reader = open_reader(root, ReaderOptions(label_set="train-ids"))
    label = reader.read(FRAMES[0]).label
    assert [c.id for c in reader.info.classes] == list(range(37))
    assert {*np.unique(label)} == {0, 1, 36, 255}
    mapped = open_reader(root, ReaderOptions(label_map="0:255,1-36:1,37:2"))
    assert {*np.unique(mapped.read(FRAMES[0]).label)} == {1, 2, 255}


def test_without_the_toolbox_there_are_no_labels_and_no_split(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "rooms")
    reader = open_reader(root)
    assert reader.ids == FRAMES
    assert reader.info.classes == ()
    assert {reader.fixed_split(i) for i in reader.ids} == {None}
    assert any("no labels: SUNRGBD2Dseg.mat" in note for note in reader.info.notes)
    assert any("allsplit.mat" in note and "--lists" in note for note in reader.info.notes)
    with pytest.warns(UserWarning, match="no labels|official split"):
        store = nimprep.convert(root, tmp_path / "o.zarr")
    assert store.about.dataset == "sunrgbd"
    assert "CVPR 2015" in store.about.references[0]["citation"]
    assert reader.info.hha_ground == "lowest"


def test_a_part_of_the_folders_has_its_part_of_the_toolbox(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    toolbox = write_toolbox(root / "SUNRGBDtoolbox")
    reader = open_reader(root / "xtion", ReaderOptions(lists=toolbox))
    assert reader.ids == ("sun3ddata/brown_bm_1/brown_bm_1",)
    assert reader.fixed_split(reader.ids[0]) == "test"
    label = reader.read(reader.ids[0]).label
    of = {value: 255 if raw == 0 else raw for value, raw in RAW.items()}
    np.testing.assert_array_equal(label, np.vectorize(of.get)(scene(3, size(3)).label))
    shutil.rmtree(root / "xtion")
    assert open_reader(root).ids == FRAMES[:3]


def test_labels_without_what_says_whose_they_are_are_refused(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    metadata = write_toolbox(root / "SUNRGBDtoolbox") / "Metadata"
    frames = metadata / "SUNRGBDMeta.mat"
    frames.rename(tmp_path / "kept.mat")
    with pytest.raises(LayoutError, match=r"expected SUNRGBDMeta\.mat beside .*--no-labels"):
        open_reader(root)
    assert len(open_reader(root, labels=False).ids) == 4
    few = np.empty((1, 2), [("sequenceName", object)])
    few[0, :] = [("SUNRGBD/" + FRAMES[0],), ("SUNRGBD/" + FRAMES[1],)]
    scipy.io.savemat(frames, {"SUNRGBDMeta": few})
    with pytest.raises(LayoutError, match=r"expected as many labels .* found 4 and 2"):
        open_reader(root)


def test_a_frame_that_the_toolbox_does_not_know_is_a_bad_frame(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    write_toolbox(root / "SUNRGBDtoolbox", order=(0, 1, 2))
    reader = open_reader(root)
    with pytest.raises(DecodeError, match=r"expected label of frame 'xtion.*', found none"):
        reader.read(FRAMES[3])
    assert reader.read(FRAMES[2]).label is not None


def test_a_label_of_another_size_is_refused(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    write_toolbox(root / "SUNRGBDtoolbox")
    (folder := root / FRAMES[1])
    shutil.rmtree(folder)
    shutil.copytree(root / FRAMES[0], folder)
    with pytest.raises(DecodeError, match=r"expected a label of 36x24 pixels .* found 36x26"):
        open_reader(root).read(FRAMES[1])


def test_the_split_may_be_given(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "a" / "SUNRGBD")
    lists = write_toolbox(tmp_path / "b") / "traintestSUNRGBD"
    for given in (lists, lists / "allsplit.mat", tmp_path / "b"):
        reader = open_reader(root, ReaderOptions(lists=given))
        assert reader.fixed_split(FRAMES[0]) == "train"
    with pytest.raises(LayoutError, match=r"expected the official split allsplit\.mat"):
        open_reader(root, ReaderOptions(lists=tmp_path))
    both = {"alltrain": texts(FRAMES[0]), "alltest": texts(FRAMES[0])}
    scipy.io.savemat(lists / "allsplit.mat", both)
    with pytest.raises(LayoutError, match="expected each frame in one split, found 'kv1"):
        open_reader(root, ReaderOptions(lists=lists))


def test_two_files_for_one_frame_are_refused(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    write_png(root / FRAMES[0] / "depth_bfx" / "other.png", np.ones((24, 36), np.uint16))
    with pytest.raises(LayoutError, match="expected one file per id 'kv1/NYUdata/NYU0001'"):
        open_reader(root)


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ("depth_bfx", "expected depth files .*unpack SUNRGBD.zip, the folders depth_bfx, there"),
        ("intrinsics.txt", "expected camera files .*unpack SUNRGBD.zip, the files intrinsics.txt"),
        ("image", "expected a known layout .*sunrgbd.* nimprep inspect .* says what it is"),
    ],
)
def test_a_part_that_is_not_there_is_named(tmp_path: Path, part: str, said: str) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    for path in sorted(root.rglob(part)):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(LayoutError, match=said):
        open_reader(root)


def test_one_too_deep_is_answered_with_the_folder_above(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    for inner in (FRAMES[0], f"{FRAMES[0]}/image"):
        with pytest.raises(LayoutError, match=r"did you mean .*NYUdata.*\?"):
            open_reader(root / inner)


def test_a_folder_of_many_things_is_none(tmp_path: Path) -> None:
    write_sunrgbd(tmp_path / "data" / "SUNRGBD" / "SUNRGBD")
    (tmp_path / "data" / "other").mkdir()
    (tmp_path / "data" / "other" / "notes.txt").write_text("")
    with pytest.raises(LayoutError, match="expected a known layout") as told:
        open_reader(tmp_path / "data" / "other")
    assert "did you mean" not in str(told.value)


def test_inspect_names_it(tmp_path: Path) -> None:
    root = write_sunrgbd(tmp_path / "SUNRGBD")
    assert inspect_source(root).reader == recognised(root).reader == "sunrgbd"
