"""Label images of every kind that tools write, and what is said where they cannot be class ids."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import LabelClass
from nimprep.images.palette import read_palette_index
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.description import LabelSource
from nimprep.readers.description_file import description_from_document
from nimprep.readers.label_map import map_from_text, with_map
from nimprep.readers.label_values import label_image
from nimprep.readers.matching import Place
from tests.fakes import write_gmrp, write_png
from tests.readers.test_folder import GMRP_DESCRIBED

CLASSES = tuple(LabelClass(n, name, (n, n, n)) for n, name in enumerate(("other", "road", "car")))
FILES = LabelSource(files="label/{id}.png")
IDS = np.repeat(np.arange(4, dtype=np.uint8)[:, None], 5, axis=1) % 3
PALETTE = np.array([[9, 9, 9], [255, 0, 0], [0, 255, 0]], np.uint8)


def mapped(named: dict[str, int], **changes: object) -> LabelSource:
    return with_map(LabelSource(files="label/{id}.png", **changes), named, CLASSES, "test")  # type: ignore[arg-type]


def read(path: Path, source: LabelSource = FILES) -> npt.NDArray[np.uint8]:
    return label_image(Place(path), source, CLASSES)


def write_palette(path: Path, bits: int = 8, ids: npt.NDArray[np.uint8] = IDS) -> Path:
    image = Image.fromarray(ids, mode=None).convert("L")
    image = Image.frombytes("P", image.size, ids.tobytes())
    image.putpalette(PALETTE[: ids.max() + 1].ravel().tolist())
    image.save(path, bits=bits) if path.suffix == ".png" else image.save(path)
    return path


@pytest.mark.parametrize("bits", [2, 4, 8])
def test_a_palettes_index_is_read_at_any_number_of_bits(tmp_path: Path, bits: int) -> None:
    path = write_palette(tmp_path / "label.png", bits)
    assert cv2.imread(str(path)).shape == (4, 5, 3)
    assert np.array_equal(read(path), IDS)


def test_a_palette_of_1_bit_and_one_of_a_bmp_are_read_by_index(tmp_path: Path) -> None:
    ids = (IDS > 0).astype(np.uint8)
    assert np.array_equal(read(write_palette(tmp_path / "label.png", 1, ids)), ids)
    assert np.array_equal(read(write_palette(tmp_path / "label.bmp")), IDS)
    Image.fromarray(ids * 255).convert("1").save(tmp_path / "mask.bmp")
    assert np.array_equal(read(tmp_path / "mask.bmp"), ids)


def test_a_bmp_of_grey_or_of_colours_is_no_palette(tmp_path: Path) -> None:
    Image.fromarray(IDS).save(tmp_path / "grey.bmp")
    Image.fromarray(PALETTE[IDS]).save(tmp_path / "colour.bmp")
    assert read_palette_index(tmp_path / "grey.bmp") is None
    assert read_palette_index(tmp_path / "colour.bmp") is None
    assert np.array_equal(read(tmp_path / "grey.bmp"), IDS)


def test_a_palettes_colours_count_where_the_map_names_colours(tmp_path: Path) -> None:
    path = write_palette(tmp_path / "label.png")
    source = mapped({"#090909": 2, "#FF0000": 0, "#00ff00": 255})
    assert np.array_equal(read(path, source), np.array([2, 0, 255], np.uint8)[IDS])


def test_values_and_colours_of_one_map_are_refused_for_a_palette(tmp_path: Path) -> None:
    path = write_palette(tmp_path / "label.png")
    both = mapped({"#090909": 0, "#ff0000": 1, "2": 2}, default=255)
    with pytest.raises(DecodeError, match="a map of either colours or values for an image with a"):
        read(path, both)


def test_grey_saved_as_colour_is_read_as_one_channel(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", np.dstack([IDS] * 3))
    assert np.array_equal(read(path), IDS)
    assert np.array_equal(read(path, mapped({"0-1": 1, "2": 0})), np.array([1, 1, 0])[IDS])


def test_one_channel_of_several_is_read(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", np.dstack([IDS, IDS + 7, IDS * 0]))
    assert np.array_equal(read(path, LabelSource(files="", channel="R")), IDS)
    source = mapped({"7-8": 0, "9": 2}, channel=1)
    assert np.array_equal(read(path, source), np.array([0, 0, 2])[IDS])


def test_alpha_can_be_the_channel_and_is_passed_over_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "label.png"
    image = np.dstack([IDS, IDS, IDS, 2 - IDS])
    assert cv2.imwrite(str(path), image)
    assert np.array_equal(read(path), IDS)
    assert np.array_equal(read(path, LabelSource(files="", channel="A")), 2 - IDS)


def test_sixteen_bits_in_equal_channels_and_numpy_arrays_are_read(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", np.dstack([IDS] * 3).astype(np.uint16))
    assert np.array_equal(read(path), IDS)
    np.save(tmp_path / "label.npy", IDS.astype(np.int64) + 70_000)
    source = mapped({"70000": 0, "70001": 1}, default=2)
    assert np.array_equal(read(tmp_path / "label.npy", source), IDS)
    np.save(tmp_path / "label.npy", IDS.astype(np.int32) - 1)
    with pytest.raises(DecodeError, match="found -1;"):
        read(tmp_path / "label.npy")
    np.save(tmp_path / "label.npy", IDS.astype(np.float32))
    with pytest.raises(DecodeError, match="whole numbers as labels, found float32"):
        read(tmp_path / "label.npy")


def test_grey_values_are_colours_to_a_map_of_colours(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", IDS * np.uint8(100))
    source = mapped({"#000000": 0, "#646464": 1, "#c8c8c8": 2})
    assert np.array_equal(read(path, source), IDS)


def test_ranges_and_instance_ids_of_16_bits_are_mapped(tmp_path: Path) -> None:
    ids = np.array([0, 26001, 33000], np.uint16)[IDS]
    path = write_png(tmp_path / "label.png", ids)
    assert np.array_equal(read(path, mapped({"0": 0, "26000-26999": 1, "33000": 2})), IDS)
    expected = np.array([0, 1, 255])[IDS]
    assert np.array_equal(read(path, mapped({"0": 0, "26000-26999": 1}, default=255)), expected)
    with pytest.raises(DecodeError, match="map, found 33000; add it"):
        read(path, mapped({"0": 0, "26000-26999": 1}))


def test_a_default_without_a_map_is_for_ids_that_are_no_class(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", np.array([0, 1, 9], np.uint8)[IDS])
    source = LabelSource(files="", default=255)
    assert np.array_equal(read(path, source), np.array([0, 1, 255])[IDS])


def test_a_colour_that_the_map_lacks_is_named_or_has_the_default(tmp_path: Path) -> None:
    path = write_png(tmp_path / "label.png", PALETTE[IDS])
    with pytest.raises(DecodeError, match="found #00ff00; add it"):
        read(path, mapped({"#090909": 0, "#ff0000": 1}))
    source = mapped({"#090909": 0, "#ff0000": 1}, default=2)
    assert np.array_equal(read(path, source), IDS)


@pytest.mark.parametrize(
    "named", [{"7": 0, "5-9": 1}, {"7": 0, "007": 1}, {"#FFFFFF": 0, "#ffffff": 1}]
)
def test_a_map_that_names_a_value_twice_is_refused(named: dict[str, int]) -> None:
    with pytest.raises(LayoutError, match=r"once in a label map, found .* twice"):
        mapped(named)
    document = {**GMRP_DESCRIBED, "label": {"files": "label/{id}.png", "map": named}}
    with pytest.raises(LayoutError, match="twice"):
        description_from_document(document, "test")


@pytest.mark.parametrize("text", ["", "1", "1:2,", "1:2,1:3", "x:1", "#fff:1", "1-:2", "-1:0"])
def test_a_label_map_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(LayoutError, match=r"--label-map: expected value:class"):
        map_from_text(text)


def test_a_label_map_to_a_class_that_there_is_not_is_refused(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path)
    with pytest.raises(LayoutError, match=r"--label-map: expected .*\(0, 1, 2, 255\), found 3"):
        open_reader(root, ReaderOptions(label_map="0:3"))


def write_jpeg_labels(root: Path) -> Path:
    write_gmrp(root)
    for path in (root / "label").iterdir():
        label = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * np.uint8(100)
        done, data = cv2.imencode(".jpg", label, [cv2.IMWRITE_JPEG_QUALITY, 50])
        assert done
        path.write_bytes(data.tobytes())
    return root


def test_jpeg_is_named_as_the_cause_of_strange_ids(tmp_path: Path) -> None:
    root = write_jpeg_labels(tmp_path)
    options = ReaderOptions(label_map="0:0,100:1,200:2")
    with pytest.raises(DecodeError, match=r"found .*; JPEG changes values .* PNG originals"):
        open_reader(root, options).read("000000")


def test_jpeg_labels_whose_values_are_mapped_are_said(tmp_path: Path) -> None:
    root = write_jpeg_labels(tmp_path)
    reader = open_reader(root, ReaderOptions(label_map="0-50:0,51-150:1,151-255:2"))
    assert any("labels are JPEG" in note for note in reader.info.notes)
    label = reader.read("000000").label
    assert label is not None
    assert label[0, 0] == 0
    assert label[-12, -1] == 1


def masks(root: Path, *, both: int, frames: int = 5) -> Path:
    write_gmrp(root, frames)
    for number, path in enumerate(sorted((root / "label").iterdir())):
        image = np.zeros((24, 32), np.uint8)
        image[12:] = 255 if number < both else 0
        write_png(path, image)
    return root


def test_a_dataset_of_masks_is_refused_before_it_is_converted(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="only 0 and 255 in all of 5"):
        open_reader(masks(tmp_path, both=1))


def test_frames_without_any_road_are_no_masks(tmp_path: Path) -> None:
    open_reader(masks(tmp_path / "none", both=0))
    root = masks(tmp_path / "mixed", both=4)
    label = np.zeros((24, 32), np.uint8)
    label[0, 0] = 1
    write_png(root / "label" / "000004.png", label)
    open_reader(root)


def test_labels_that_are_255_throughout_are_no_masks(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path)
    for path in (root / "label").iterdir():
        write_png(path, np.full((24, 32), 255, np.uint8))
    assert set(np.unique(open_reader(root).read("000000").label)) == {255}


def test_a_map_in_the_description_is_an_answer_to_masks(tmp_path: Path) -> None:
    root = masks(tmp_path / "gmrp", both=5)
    label = {"files": "label/{id}.png", "map": {"0": 0, "255": 1}}
    path = tmp_path / "d.json"
    path.write_text(json.dumps({**GMRP_DESCRIBED, "label": label}))
    reader = open_reader(root, ReaderOptions(description=path))
    assert set(np.unique(reader.read("000000").label)) == {0, 1}
