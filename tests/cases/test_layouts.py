"""Public layouts, described: ids, groups and splits."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nimprep
from nimprep.errors import LayoutError
from nimprep.readers import Reader, ReaderOptions, open_reader
from tests.cases.cases import layout_scene

BASE: dict[str, Any] = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "layout",
    "camera": {"fx": 80, "fy": 80, "cx": 47.5, "cy": 20},
    "classes": [{"id": 1, "name": "road", "color": [0, 200, 0]}],
}
LAYOUTS: dict[str, dict[str, Any]] = {
    "orfd": {
        "rgb": "{split}/{scene}/image_data/{name}.png",
        "id": "{split}/{scene}/{name}",
        "depth": {"files": "{split}/{scene}/dense_depth/{name}.png", "scale_m": 0.00390625},
        "label": {"files": "{split}/{scene}/gt_image/{name}_fillcolor.png", "default": 255},
        "group": "{scene}",
        "split": {"of": "{split}"},
    },
    "cityscapes": {
        "rgb": "leftImg8bit/{split}/{city}/{name}_leftImg8bit.png",
        "id": "{split}/{name}",
        "label": {"files": "gtFine/{split}/{city}/{name}_gtFine_labelIds.png", "default": 255},
        "group": "{city}",
    },
    "vkitti2": {
        "rgb": "{scene}/{variation}/frames/rgb/Camera_{camera}/rgb_{frame}.jpg",
        "id": "{scene}/{variation}/{camera}/{frame}",
        "depth": {
            "files": "{scene}/{variation}/frames/depth/Camera_{camera}/depth_{frame}.png",
            "scale_m": 0.01,
        },
        "group": "{scene}",
    },
    "rellis": {
        "rgb": "{scene}/pylon_camera_node/{name}.jpg",
        "id": "{scene}/{name}",
        "label": {"files": "{scene}/pylon_camera_node_label_id/{name}.png", "default": 255},
        "group": "{scene}",
        "split": {"lists": {"train": "train.lst"}, "rest": "test"},
    },
    "drno": {
        "rgb": "left/left{id}.png",
        "depth": {"files": "depth/depth{id}.png", "scale_m": 0.001},
        "label": {"files": "labels/label{id}.png", "default": 255},
    },
    "nyuv2_dformer": {
        "rgb": "RGB/{id}.jpg",
        "depth": {"files": "Depth/{id}.png", "scale_m": 0.04},
        "label": {"files": "Label/{id}.png", "default": 255},
    },
    "nyuv2_mat": {
        "rgb": {"files": "nyu_depth_v2_labeled.mat", "key": "images", "axes": "NCWH"},
        "depth": {
            "files": "nyu_depth_v2_labeled.mat",
            "key": "depths",
            "axes": "NWH",
            "scale_m": 1,
        },
        "label": {
            "files": "nyu_depth_v2_labeled.mat",
            "key": "labels",
            "axes": "NWH",
            "map": {"7": 1},
            "default": 255,
        },
    },
    "sunrgbd": {
        "rgb": "{id}/image/*.jpg",
        "depth": {"files": "{id}/depth_bfx/*.png", "scale_m": 0.001},
        "group": "{group}/*",
    },
}


def opened(root: Path, **changes: Any) -> Reader:
    document = {**BASE, **LAYOUTS[root.name], **changes}
    path = root.parent / f"{root.name}.json"
    path.write_text(json.dumps(document))
    return open_reader(root, ReaderOptions(description=path))


def found(reader: Reader) -> dict[str, tuple[str, str | None]]:
    return {i: (reader.group(i), reader.fixed_split(i)) for i in reader.ids}


def test_orfd(layout: Callable[[str], Path]) -> None:
    reader = opened(layout("orfd"))
    frames = found(reader)
    assert frames["training/c2021_0228_1819/1623721491895"] == ("c2021_0228_1819", "train")
    assert Counter(split for _, split in frames.values()) == {"train": 4, "val": 2, "test": 2}
    names = [path.name for path in reader.sources("validation/x0613_1627/1623721492295")]
    assert names == ["1623721492295.png"] * 2 + ["1623721492295_fillcolor.png"]
    with pytest.raises(LayoutError, match="expected a split called training, found 'testing'"):
        opened(reader.root, split={"of": "{split}", "names": {"training": "train"}})
    names_of = {"training": "train", "validation": "val", "testing": "skip"}
    assert len(opened(reader.root, split={"of": "{split}", "names": names_of}).ids) == 6


def test_cityscapes_is_split_by_its_folders(layout: Callable[[str], Path]) -> None:
    frames = found(opened(layout("cityscapes")))
    assert frames["train/bochum_000001_000019"] == ("bochum", "train")
    assert Counter(split for _, split in frames.values()) == {"train": 4, "val": 2, "test": 2}


def test_vkitti2_has_a_frame_of_each_scene_variation_and_camera(
    layout: Callable[[str], Path],
) -> None:
    frames = found(opened(layout("vkitti2")))
    assert len(frames) == 2 * 2 * 2 * 3
    assert frames["Scene02/15-deg-left/1/00002"] == ("Scene02", None)


def test_rellis_is_split_by_its_lists(layout: Callable[[str], Path]) -> None:
    root = layout("rellis")
    frames = found(opened(root))
    assert frames["00000/frame000000-1581624660_149"] == ("00000", "train")
    assert Counter(split for _, split in frames.values()) == {"train": 1, "test": 3}
    with pytest.raises(LayoutError, match=r'found 3 of 4 in none.*"rest" in "split"'):
        opened(root, split={"lists": {"train": "train.lst"}})
    # The fake's lists all name the same frame.
    with pytest.raises(LayoutError, match=r"lst: line 1: expected each frame in one split"):
        opened(root, split={"lists": {"train": "train.lst", "val": "val.lst"}, "rest": "skip"})
    (root / "train.lst").write_text("00000/pylon_camera_node/frame9.jpg x.png\n")
    with pytest.raises(LayoutError, match=r"train.lst: line 1: '.*frame9.*' is no frame's id"):
        opened(root, split={"lists": {"train": "train.lst"}, "rest": "skip"})


@pytest.mark.parametrize(
    ("name", "train"), [("drno", ["0", "1"]), ("nyuv2_dformer", ["0", "1", "2"])]
)
def test_lists_of_names_or_paths_are_found(
    layout: Callable[[str], Path], name: str, train: list[str]
) -> None:
    frames = found(opened(layout(name)))
    assert [i for i, (_, split) in frames.items() if split == "train"] == train
    assert {split for _, split in frames.values()} == {"train", "test"}
    assert {split for _, split in found(opened(layout(name), split=False)).values()} == {None}


def test_sunrgbd_has_a_folder_per_frame(layout: Callable[[str], Path]) -> None:
    frames = found(opened(layout("sunrgbd")))
    assert frames["kv1/NYUdata/NYU0001"] == ("kv1/NYUdata", None)
    assert len(frames) == 4


def test_nyu_is_one_file_of_many_frames(layout: Callable[[str], Path], tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    reader = opened(layout("nyuv2_mat"))
    assert reader.ids == ("000000", "000001", "000002", "000003")
    truth = layout_scene(2)
    frame = reader.read("000002")
    assert np.array_equal(frame["rgb"], truth[0])
    assert np.array_equal(frame["depth"], truth[1])
    assert np.array_equal(frame["label"] == 1, truth[2] == 7)
    assert len(reader.sources("000002")) == 1
    document = tmp_path / "layouts/nyuv2_mat.json"
    store = nimprep.convert(reader.root, tmp_path / "s.zarr", description=document)
    assert np.array_equal(store[2]["rgb"], truth[0])
