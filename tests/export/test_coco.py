"""COCO's JSON: pycocotools gets the store's labels, and its run lengths are ours."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from pycocotools import mask as oracle
from pycocotools.coco import COCO

import nimprep
from nimprep.errors import StoreError
from nimprep.export import export_frames
from nimprep.export.coco import masks_of, rle_text, run_lengths
from nimprep.export.places import id_of
from nimprep.store.reader import Store
from tests.fakes import write_gmrp, write_nyu_like

# pycocotools 2.0.11 on NumPy 2.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

PAGE = Path(__file__).parents[2] / "docs" / "exporting.md"


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("coco")
    raw, description = write_nyu_like(root / "raw")
    return nimprep.convert(raw, root / "s.zarr", description=description, split_by="frame")


@pytest.fixture(scope="module")
def out(store: Store, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "coco"
    assert export_frames(store, folder, "coco") == list(store.ids)
    return folder


def test_pycocotools_gets_every_frames_colours_and_labels(store: Store, out: Path) -> None:
    seen = {}
    for split in ("train", "val", "test"):
        coco = COCO(str(out / "annotations" / f"instances_{split}.json"))
        names = {c["id"]: c["name"] for c in coco.loadCats(coco.getCatIds())}
        assert names == {c.id: c.name for c in store.classes} == {0: "other", 1: "floor"}
        for image in coco.loadImgs(coco.getImgIds()):
            frame = store[store.ids.index(id_of(Path(image["file_name"]).stem))]
            seen[frame.id] = split
            assert image["frame_id"] == frame.id
            assert image["group"] == frame.group
            colours = cv2.imread(str(out / "images" / image["file_name"]))
            np.testing.assert_array_equal(colours[:, :, ::-1], frame["rgb"])
            assert (image["height"], image["width"]) == colours.shape[:2]
            times = np.zeros(colours.shape[:2], int)
            for annotation in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
                mask = coco.annToMask(annotation) > 0
                np.testing.assert_array_equal(mask, frame["label"] == annotation["category_id"])
                times += mask
                assert annotation["iscrowd"] == 0
                assert annotation["area"] == oracle.area(annotation["segmentation"]) > 0
                assert annotation["bbox"] == oracle.toBbox(annotation["segmentation"]).tolist()
            np.testing.assert_array_equal(times, frame["label"] != 255)
    assert seen == store.splits


def test_the_pages_way_back_gives_the_labels(store: Store, out: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    code = code.replace("OUT/annotations", f"{out}/annotations")
    code += "    found[image['frame_id']] = label\n"
    found: dict[str, np.ndarray] = {}
    exec(code, {"found": found})
    assert set(found) == {i for i, split in store.splits.items() if split == "train"}
    for frame_id, label in found.items():
        np.testing.assert_array_equal(label, store[store.ids.index(frame_id)]["label"])


def test_run_lengths_are_what_they_are_by_hand() -> None:
    mask = np.array([[0, 1, 1], [0, 1, 0]], bool)
    assert run_lengths(mask).tolist() == [2, 3, 1]
    assert run_lengths(~mask).tolist() == [0, 2, 3, 1]
    assert run_lengths(np.ones((2, 2), bool)).tolist() == [0, 4]
    # 2, 3, 1, and 4 - 3: a digit above "0" each, as all are below 16.
    assert rle_text(np.array([2, 3, 1, 4])) == "2311"


@pytest.mark.parametrize("seed", range(4))
def test_run_lengths_are_pycocotools(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = [(1, 1), (1, 40), (40, 1), (33, 57), (700, 900)]
    for size in sizes:
        smooth = cv2.GaussianBlur(rng.random(size, np.float32), (0, 0), 1 + 9 * seed)
        for mask in (smooth > np.median(smooth), rng.random(size) < 0.001 * 10**seed):
            if not mask.any():
                continue
            (found,) = [m for m in masks_of(mask.astype(np.uint8)) if m["category_id"] == 1]
            wanted = oracle.encode(np.asfortranarray(mask, np.uint8))
            assert found["segmentation"]["counts"] == wanted["counts"].decode()
            assert found["segmentation"]["size"] == wanted["size"]
            assert found["area"] == oracle.area(wanted)
            assert found["bbox"] == oracle.toBbox(wanted).tolist()


def test_frames_without_labels_are_said_and_have_no_annotation(tmp_path: Path) -> None:
    raw, description = write_nyu_like(
        tmp_path / "raw", label={"files": "label/{id}.png", "map": {"40": 255}, "default": 255}
    )
    store = nimprep.convert(raw, tmp_path / "s.zarr", description=description, split_by="frame")
    with pytest.warns(UserWarning, match="4 of 4 frames have no pixel of a class in their labels"):
        export_frames(store, tmp_path / "out", "coco")
    document = json.loads((tmp_path / "out" / "annotations" / "instances_val.json").read_text())
    assert document["annotations"] == []
    assert len(document["images"]) == 1


def test_without_labels_the_lists_are_of_images_alone(store: Store, tmp_path: Path) -> None:
    export_frames(store, tmp_path / "out", "coco", "train", modalities=["rgb", "depth"])
    names = [path.name for path in (tmp_path / "out" / "annotations").iterdir()]
    assert names == ["image_info_train.json"]
    document = json.loads((tmp_path / "out" / "annotations" / names[0]).read_text())
    assert "annotations" not in document
    assert {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()} == {
        "annotations",
        "images",
        "depth_u16",
    }
    bare = nimprep.convert(
        write_gmrp(tmp_path / "raw", 4), tmp_path / "s.zarr", camera=(30, 30, 15, 11), labels=False
    )
    with pytest.raises(StoreError, match="expected label for --format coco"):
        export_frames(bare, tmp_path / "none", "coco")
