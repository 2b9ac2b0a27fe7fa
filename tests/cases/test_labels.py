"""Labels as painted, exported and renamed by the tools that people use."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.conversion.options import ConvertOptions
from nimprep.errors import DecodeError, LayoutError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader

Case = Callable[[str], Path]


def described(root: Path, name: str, description: str) -> Reader:
    return open_reader(root / name, ReaderOptions(description=root / description))


@pytest.mark.parametrize("description", [None, "ids.json", "mapids.json", "mapcol.json"])
def test_a_palettes_index_is_the_class(case: Case, description: str | None) -> None:
    root = case("15-")
    reader = open_reader(root) if description is None else described(root, ".", description)
    for frame_id in ("000000", "000003"):
        expected = np.load(root / f"true_{frame_id}.npy")
        assert np.array_equal(reader.read(frame_id).label, expected)


def test_masks_of_0_and_255_ask_to_be_mapped(case: Case) -> None:
    root = case("16-")
    with pytest.raises(LayoutError, match=r"only 0 and 255 in all of 6.*--label-map 0:0,255:1"):
        open_reader(root)
    reader = open_reader(root, ReaderOptions(label_map="0:0,255:1"))
    label = reader.read("000000").label
    assert label is not None
    assert set(np.unique(label)) == {0, 1}
    ignored = open_reader(root, ReaderOptions(label_map="0:0,255:255")).read("000000").label
    assert np.array_equal(ignored == 255, label == 1)


def test_odd_ids_are_named_and_mapped(case: Case) -> None:
    root = case("17-")
    with pytest.raises(DecodeError, match=r"\[0, 1, 2, 255\], found 15; .*--label-map 15:0"):
        described(root, ".", "a.json").read("000000")
    with pytest.raises(DecodeError, match="found 26001"):
        described(root, ".", "c.json").read("000000")
    right = described(root, ".", "b1.json").read("000001").label
    assert right is not None
    assert set(np.unique(right)) == {0, 1, 2}
    assert np.array_equal(described(root, ".", "c1.json").read("000001").label, right)


def test_colours_are_classes_by_the_map_and_a_map_to_paste_is_shown(case: Case) -> None:
    root = case("19-")
    reader = described(root, ".", "d.json")
    for frame_id in ("0", "3"):
        assert np.array_equal(reader.read(frame_id).label, np.load(root / f"true_{frame_id}.npy"))
    expected = r'3 colours.*"map": {"#000000": 0, "#804080": 1, "#fa3253": 2}'
    with pytest.raises(DecodeError, match=expected):
        described(root, ".", "nomap.json").read("0")


@pytest.mark.parametrize("name", ["o3", "o6"])
def test_images_are_turned_as_viewers_show_them(case: Case, name: str) -> None:
    root = case("20-")
    reader = open_reader(root / name, ReaderOptions(description=root / "d.json"))
    for frame_id in ("0", "3"):
        frame = reader.read(frame_id)
        shown = cv2.imread(str(root / f"shown_{frame_id}.png"))[..., ::-1].astype(int)
        assert reader.shape(frame_id) == (96, 128)
        assert np.abs(frame["rgb"].astype(int) - shown).mean() < 3
        label = cv2.imread(str(root / name / "label" / f"{frame_id}.png"), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(frame["label"], label)


@pytest.mark.parametrize("rule", ["ignore", "refuse"])
def test_an_orientation_can_be_ignored_or_refused(case: Case, rule: str) -> None:
    root = case("20-")
    document = {**json.loads((root / "d.json").read_text()), "orientation": rule, "version": "1.1"}
    (root / "other.json").write_text(json.dumps(document))
    options = ReaderOptions(description=root / "other.json")
    found = r"found EXIF orientation 6" if rule == "refuse" else r"128x96.*EXIF orientation 6 in"
    with pytest.raises(DecodeError, match=found):
        open_reader(root / "o6", options).read("0")
    if rule == "ignore":
        shown = cv2.imread(str(root / "shown_0.png"))[::-1, ::-1, ::-1].astype(int)
        rgb = open_reader(root / "o3", options).read("0")["rgb"]
        assert np.abs(rgb.astype(int) - shown).mean() < 3


@pytest.mark.parametrize(
    ("name", "ends"), [("rgb16", [0, 65535]), ("grey16", [0, 51000]), ("grey8", None)]
)
def test_16_bit_colour_is_scaled_by_its_range(case: Case, name: str, ends: list[int]) -> None:
    root = case("21-")
    options = ReaderOptions(description=root / f"{name}.json")
    if ends is not None:
        with pytest.raises(DecodeError, match=r"8-bit colour.*\"range\": \[0, 65535\]"):
            open_reader(root, options).read("0")
        document = json.loads((root / f"{name}.json").read_text())
        source = {"files": document["rgb"], "range": ends}
        document |= {"rgb": source, "version": "1.1"}
        (root / f"{name}.json").write_text(json.dumps(document))
    found = open_reader(root, options).read("0")["rgb"]
    image = cv2.imread(str(root / name / "0.png"), cv2.IMREAD_UNCHANGED)
    expected = image // image.dtype.type({"rgb16": 257, "grey16": 200, "grey8": 1}[name])
    expected = expected[..., ::-1] if image.ndim == 3 else np.dstack([expected] * 3)
    assert np.array_equal(found, expected)


def test_alpha_leaves_colour_as_it_is(case: Case) -> None:
    root = case("22-")
    reader = open_reader(root, ReaderOptions(description=root / "d.json"))
    for frame_id in reader.ids:
        assert np.array_equal(reader.read(frame_id)["rgb"], np.load(root / f"rgb_{frame_id}.npy"))


@pytest.mark.parametrize(
    ("kind", "most"),
    [("cmyk", 3), ("prog", 3), ("webp", 0), ("bmp", 0), ("pal", 3), ("wrongext", 0)],
)
def test_odd_kinds_of_images_have_the_right_colours(case: Case, kind: str, most: int) -> None:
    root = case("43-")
    reader = open_reader(root / kind, ReaderOptions(description=root / kind / "d.json"))
    difference = np.abs(reader.read("0")["rgb"].astype(int) - np.load(root / "rgb.npy"))
    assert difference.mean() <= most


@pytest.mark.parametrize(("kind", "name"), [("gif", "GIF"), ("heic", "HEI")])
def test_kinds_that_are_not_read_are_named(case: Case, kind: str, name: str) -> None:
    root = case("43-")
    reader = open_reader(root / kind, ReaderOptions(description=root / kind / "d.json"))
    with pytest.raises(DecodeError, match=name):
        reader.read("0")


def test_what_was_turned_is_said_with_the_number_of_frames(case: Case, tmp_path: Path) -> None:
    root = case("20-")
    options = ConvertOptions(description=root / "d.json", split_by="frame")
    with pytest.warns(UserWarning, match=r"turned by their EXIF orientation, 3, .*\(4 frames"):
        nimprep.convert(root / "o3", tmp_path / "s.zarr", options)


def describe(root: Path, **said: object) -> Reader:
    """Return the reader of a public layout by a description."""
    classes = [
        {"id": 0, "name": "other", "color": [0, 0, 0]},
        {"id": 1, "name": "road", "color": [0, 200, 0]},
        {"id": 2, "name": "car", "color": [0, 0, 200]},
    ]
    document = {"format": "nimprep-folder", "version": "1.1", "name": "own", "classes": classes}
    (root / "d.json").write_text(json.dumps({**document, **said}))
    return open_reader(root, ReaderOptions(description=root / "d.json"))


def png(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


def test_r2ds_label_is_the_red_channel(layout: Case) -> None:
    root = layout("r2d")
    reader = describe(
        root,
        rgb="training/{town}/rgb/{id}.jpg",
        label={
            "files": "training/{town}/label/{id}.png",
            "channel": "R",
            "map": {"7": 1},
            "default": 0,
        },
        id="{town}/{id}",
    )
    red = png(root / "training" / "Town02" / "label" / "000000.png")[..., 2]
    assert np.array_equal(reader.read("Town02/000000")["label"], red == 7)
    assert set(np.unique(red)) == {1, 7}


def test_kittis_semantic_ids_are_mapped(layout: Case) -> None:
    root = layout("kitti_semantics")
    reader = describe(
        root,
        rgb="training/image_2/{id}_10.png",
        label={
            "files": "training/semantic/{id}_10.png",
            "map": {"0-6": 255, "7": 1, "8-23": 0, "24-33": 2},
        },
    )
    ids = png(root / "training" / "semantic" / "000001_10.png")
    expected = np.select([ids == 7, ids == 26, ids == 11, ids == 23], [1, 2, 0, 0], 9)
    assert np.array_equal(reader.read("000001")["label"], expected)


def test_mfnets_thermal_is_the_fourth_channel(layout: Case) -> None:
    root = layout("mfnet")
    reader = describe(
        root,
        rgb="images/{id}.png",
        label={"files": "labels/{id}.png"},
        planes={"thermal": {"files": "images/{id}.png", "channel": "A", "dtype": "uint8"}},
    )
    frame = reader.read("00001D", ("rgb", "label", "thermal"))
    image = png(root / "images" / "00001D.png")
    assert np.array_equal(frame["rgb"], image[..., 2::-1])
    assert np.array_equal(frame["thermal"], image[..., 3])
    assert np.array_equal(frame["label"], png(root / "labels" / "00001D.png"))
