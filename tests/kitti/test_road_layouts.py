"""What KITTI road's folders are in practice: a validation folder, other endings, no road frame."""

from __future__ import annotations

import json
import shutil
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError, SplitError
from nimprep.readers import open_reader
from nimprep.store.resplit import resplit

from .scenes import road_folder, write_calibration

NAMES = tuple(f"{category}_{k:06d}" for category in ("um", "umm", "uu") for k in range(4))


def with_validation(root: Path, folder: str, names: tuple[str, ...] = ("um_000001",)) -> Path:
    """Move training frames into a folder of their own."""
    road_folder(root, NAMES)
    road_folder(root, ("uu_000007",), "testing")
    for path in sorted((root / "training").rglob("*.*")):
        frame = path.stem.replace("_road", "").replace("_lane", "")
        if frame in names:
            target = root / folder / path.parent.name / path.name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(path, target)
    return root


@pytest.mark.parametrize("folder", ["validation", "validating"])
def test_frames_of_a_validation_folder_are_val_and_no_others(tmp_path: Path, folder: str) -> None:
    root = with_validation(tmp_path / "road", folder, ("um_000001", "uu_000003"))
    reader = open_reader(root)
    val = [f"{folder}/um_000001", f"{folder}/uu_000003"]
    assert len(reader.ids) == len(NAMES) + 1
    assert [i for i in reader.ids if reader.fixed_split(i) == "val"] == val
    assert [reader.group(i) for i in val] == ["um", "uu"]
    label = reader.read(val[0]).label
    assert label is not None
    assert np.unique(label).tolist() == [0, 1]
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb", "label"))
    assert Counter(store.splits.values()) == {"train": 10, "val": 2, "test": 1}
    assert [i for i in store.ids if store.splits[i] == "val"] == val


def test_a_validation_folder_gives_way_to_another_split(tmp_path: Path) -> None:
    root = with_validation(tmp_path / "road", "validation")
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb",), split_by="eighth")
    # An eighth of each category's four, at least one; test stays what it is.
    assert Counter(store.splits.values()) == {"train": 9, "val": 3, "test": 1}


def test_a_validation_frame_without_truth_is_bad(tmp_path: Path) -> None:
    root = with_validation(tmp_path / "road", "validation")
    shutil.rmtree(root / "validation" / "gt_image_2")
    with pytest.raises(DecodeError, match="ground truth of frame validation/um_000001, found none"):
        open_reader(root).read("validation/um_000001")


def test_a_validation_folder_alone_is_known(tmp_path: Path) -> None:
    root = with_validation(tmp_path / "road", "validation")
    shutil.rmtree(root / "training")
    shutil.rmtree(root / "testing")
    assert open_reader(root).ids == ("validation/um_000001",)


@pytest.mark.parametrize("ending", [".jpg", ".JPEG", ".bmp", ".tiff", ".PNG"])
def test_colour_of_any_ending_is_taken(tmp_path: Path, ending: str) -> None:
    root = road_folder(tmp_path / "road", NAMES)
    expected = {}
    for path in sorted((root / "training" / "image_2").iterdir()):
        image = cv2.imread(str(path))
        path.unlink()
        assert cv2.imwrite(str(path.with_suffix(ending)), image)
        expected[f"training/{path.stem}"] = cv2.imread(str(path.with_suffix(ending)))[..., ::-1]
    reader = open_reader(root)
    assert reader.ids == tuple(sorted(expected))
    for frame_id in (reader.ids[0], reader.ids[-1]):
        np.testing.assert_array_equal(reader.read(frame_id).rgb, expected[frame_id])
        assert reader.sources(frame_id)[0].suffix == ending


def test_truth_is_never_taken_from_what_changes_its_values(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "road", ("um_000000", "um_000001"))
    path = root / "training" / "gt_image_2" / "um_road_000000.png"
    image = cv2.imread(str(path))
    path.unlink()
    cv2.imwrite(str(path.with_suffix(".bmp")), image)
    label = open_reader(root).read("training/um_000000").label
    np.testing.assert_array_equal(label, image[..., 0] > 0)
    path.with_suffix(".bmp").unlink()
    cv2.imwrite(str(path.with_suffix(".jpg")), image)
    with pytest.raises(DecodeError, match="expected the ground truth of frame training/um_000000"):
        open_reader(root).read("training/um_000000")


def test_two_images_of_one_frame_are_refused(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "road", NAMES)
    image = root / "training" / "image_2" / "um_000000.png"
    shutil.copy(image, image.with_suffix(".tif"))
    with pytest.raises(LayoutError, match=r"one image of frame training/um_000000.*take one away"):
        open_reader(root)


def test_without_a_road_frame_there_is_none(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "road", ("um_000000", "um_000001"))
    write_calibration(root / "training" / "calib" / "um_000001.txt", Tr_cam_to_road=None)
    reader = open_reader(root)
    assert reader.read("training/um_000000").cam_to_road is not None
    assert reader.read("training/um_000001").cam_to_road is None
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb", "depth"))
    assert [store.cam_to_road(i) is None for i in range(2)] == [False, True]


def test_categories_are_no_scenes_to_split_by(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "road", NAMES)
    said = r"um, umm, uu are categories.*--split-by eighth"
    with pytest.raises(SplitError, match=said):
        nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb",), split_by="group")
    assert not (tmp_path / "s.zarr").exists()
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb",))
    before = dict(store.splits)
    with pytest.raises(SplitError, match=said):
        resplit(tmp_path / "s.zarr", rule="group")
    assert nimprep.open_store(tmp_path / "s.zarr").splits == before


def test_whose_it_is_goes_into_the_store(tmp_path: Path) -> None:
    root = road_folder(tmp_path / "road", NAMES)
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("rgb",))
    assert "ITSC 2013" in store.about.references[0]["citation"]
    done = CliRunner().invoke(main, ["info", str(tmp_path / "s.zarr"), "--json"])
    assert json.loads(done.stdout)["references"] == store.about.references
    text = CliRunner().invoke(main, ["info", str(tmp_path / "s.zarr")]).stdout
    assert "licence  CC BY-NC-SA 3.0\n" in text
