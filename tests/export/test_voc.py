"""PASCAL VOC's layout, read as torchvision reads it and as VOC's development kit says."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.export import export_frames
from nimprep.export.places import id_of
from nimprep.export.voc import voc_palette
from nimprep.store.reader import Store
from tests.export.networks import Voc
from tests.fakes import write_nyu_like

pytestmark = pytest.mark.filterwarnings("ignore:.*colour is JPEG")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Classes 0 and 254, void, and smooth colour, which JPEG keeps to a few levels."""
    root = tmp_path_factory.mktemp("voc")
    classes = [
        {"id": 0, "name": "other: all", "color": [9, 9, 9]},
        {"id": 254, "name": "floor", "color": [0, 255, 0]},
    ]
    label = {"files": "label/{id}.png", "map": {"40": 254, "300": 255}, "default": 0}
    raw, description = write_nyu_like(root / "raw", classes=classes, label=label)
    rows, columns = np.mgrid[:24, :32]
    smooth = np.stack([rows * 8, columns * 6, 200 - rows * 4], axis=2).astype(np.uint8)
    for path in (raw / "color").rglob("*.png"):
        assert cv2.imwrite(str(path), smooth[:, :, ::-1])
    return nimprep.convert(raw, root / "s.zarr", description=description, split_by="frame")


@pytest.fixture(scope="module")
def out(store: Store, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "VOCdevkit" / "VOC2012"
    with pytest.warns(UserWarning, match="colour is JPEG of quality 95"):
        assert export_frames(store, folder, "voc") == list(store.ids)
    return folder


@pytest.mark.parametrize("split", ["train", "val", "trainval"])
def test_its_loader_gets_the_frames_of_a_split(store: Store, out: Path, split: str) -> None:
    loader, palette = Voc(out), voc_palette()
    wanted = [i for i, found in store.splits.items() if found in split]
    names = loader.names(split)
    assert [id_of(name) for name in names] == wanted
    for frame_id, name in zip(wanted, names, strict=True):
        frame, got = store[store.ids.index(frame_id)], loader.load(name)
        np.testing.assert_array_equal(got.label, frame["label"])
        assert set(np.unique(frame["label"])) == {0, 254, 255}
        # Shown in VOC's colours.
        np.testing.assert_array_equal(got.x, palette[frame["label"]])
        assert np.abs(got.rgb.astype(int) - frame["rgb"]).max() <= 8


def test_the_test_list_and_the_class_map(store: Store, out: Path) -> None:
    names = (out / "ImageSets" / "Segmentation" / "test.txt").read_text().splitlines()
    assert [id_of(n) for n in names] == [i for i, s in store.splits.items() if s == "test"]
    # The colour of 254: bits 7 to 0 of each channel by the development kit, by hand.
    assert (out / "labelmap.txt").read_text().splitlines() == [
        "# label:color_rgb:parts:actions",
        "other all:0,0,0::",
        "floor:96,224,192::",
    ]


def test_the_palette_is_vocs() -> None:
    palette = voc_palette()
    # Of the development kit's figure: background, aeroplane ... tvmonitor, and void.
    assert palette[:4].tolist() == [[0, 0, 0], [128, 0, 0], [0, 128, 0], [128, 128, 0]]
    assert palette[8:12].tolist() == [[64, 0, 0], [192, 0, 0], [64, 128, 0], [192, 128, 0]]
    assert palette[20].tolist() == [0, 64, 128]
    assert palette[255].tolist() == [224, 224, 192]
    assert len(np.unique(palette, axis=0)) == 256


def test_other_modalities_stand_beside_as_the_store_has_them(store: Store, tmp_path: Path) -> None:
    wanted = ["rgb", "label", "depth", "normal"]
    export_frames(store, tmp_path / "out", "voc", modalities=wanted)
    name = store.ids[1].replace("/", "%2F")
    depth = cv2.imread(str(tmp_path / "out" / "depth_u16" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(depth, store.arrays["depth"].read(1))
    document = json.loads((tmp_path / "out" / "encodings.json").read_text())
    assert list(document["modalities"]) == [m for m in store.modalities if m in wanted]
    with pytest.raises(StoreError, match="found 'disparities'"):
        export_frames(store, tmp_path / "no", "voc", modalities=["disparities"])
