"""Colour of every depth of bits, order of channels and kind of number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nimprep.errors import DecodeError, LayoutError
from nimprep.readers.color_values import color_image, color_notes
from nimprep.readers.description import ColorSource
from nimprep.readers.description_file import description_from_document
from nimprep.readers.matching import Place
from tests.fakes import write_png
from tests.readers.test_folder import GMRP_DESCRIBED

GREY = np.arange(0, 240, 20, dtype=np.uint8).reshape(3, 4)
COLOR = np.dstack([GREY, GREY + 1, 255 - GREY])


def read(path: Path, **said: object) -> np.ndarray:
    return color_image(Place(path), ColorSource(files="rgb/{id}", **said))  # type: ignore[arg-type]


def array(path: Path, image: np.ndarray) -> Path:
    np.save(path / "a.npy", image)
    return path / "a.npy"


def test_16_bits_are_scaled_by_their_range_to_the_nearest(tmp_path: Path) -> None:
    path = write_png(tmp_path / "a.png", COLOR.astype(np.uint16) * np.uint16(257))
    assert np.array_equal(read(path, range=(0, 65535)), COLOR)
    # 10 bits in 16; beyond the range is cut off.
    values = np.array([[0, 1, 2, 3, 100, 1021, 1022, 1023, 1024, 60000]], np.uint16)
    found = read(write_png(tmp_path / "b.png", values), range=(0, 1023))
    expected = [0, 0, 0, 1, 25, 255, 255, 255, 255, 255]
    assert np.array_equal(found, np.repeat(np.array([expected], np.uint8)[..., None], 3, 2))


def test_a_range_need_not_begin_at_0(tmp_path: Path) -> None:
    path = array(tmp_path, np.array([[-1.5, -1.0, 0.0, 1.0, np.inf, -np.inf]]))
    assert read(path, range=(-1, 1))[0, :, 1].tolist() == [0, 0, 128, 255, 255, 0]


@pytest.mark.parametrize(
    ("image", "shown"),
    [
        (COLOR.astype(np.uint16) * np.uint16(257), r"uint16 of at most 65535; .*\[0, 65535\]"),
        (COLOR.astype(np.uint16) * np.uint16(4), r"uint16 of at most 1020; .*\[0, 1023\]"),
        (COLOR.astype(np.uint16), r"\[0, 255\]"),
        ((COLOR / 255).astype(np.float32), r"float32 of at most 1; .*\[0, 1\]"),
        (COLOR.astype(np.float64), r"float64 of at most 255; .*\[0, 255\]"),
    ],
)
def test_a_range_is_asked_for_and_one_is_shown(
    tmp_path: Path, image: np.ndarray, shown: str
) -> None:
    with pytest.raises(DecodeError, match=shown):
        read(array(tmp_path, image))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.int32])
def test_arrays_are_scaled_whatever_their_numbers(tmp_path: Path, dtype: type) -> None:
    assert np.array_equal(read(array(tmp_path, COLOR.astype(dtype)), range=(0, 255)), COLOR)


def test_channels_can_come_first_and_in_the_order_of_opencv(tmp_path: Path) -> None:
    path = array(tmp_path, np.moveaxis(COLOR[..., ::-1] / np.float32(255), 2, 0))
    assert np.array_equal(read(path, axes="CHW", channels="BGR", range=(0, 1)), COLOR)
    assert np.array_equal(read(array(tmp_path, COLOR[..., ::-1]), channels="BGR"), COLOR)
    saved = write_png(tmp_path / "a.png", COLOR[..., ::-1].copy())
    assert np.array_equal(read(saved, channels="BGR"), COLOR)


def test_nan_is_no_colour(tmp_path: Path) -> None:
    path = array(tmp_path, np.full((2, 2, 3), np.nan))
    with pytest.raises(DecodeError, match="found NaN; write 0"):
        read(path, range=(0, 1))


def test_grey_alpha_palettes_and_few_bits_are_colour(tmp_path: Path) -> None:
    grey = np.dstack([GREY] * 3)
    assert np.array_equal(read(write_png(tmp_path / "a.png", GREY)), grey)
    assert np.array_equal(read(array(tmp_path, np.dstack([GREY, GREY * 0]))), grey)
    assert np.array_equal(read(array(tmp_path, np.dstack([COLOR, GREY * 0]))), COLOR)
    Image.fromarray(COLOR).quantize(4).save(tmp_path / "p.png", bits=2)
    shown = np.asarray(Image.open(tmp_path / "p.png").convert("RGB"))
    assert np.array_equal(read(tmp_path / "p.png"), shown)
    assert np.array_equal(
        read(write_png(tmp_path / "c.png", COLOR), channel="B")[..., 0], 255 - GREY
    )


def test_five_channels_are_no_colour(tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match="1 to 4 channels of colour, found 5"):
        read(array(tmp_path, np.zeros((2, 2, 5), np.uint8)))


def test_the_range_is_said(tmp_path: Path) -> None:
    assert color_notes(ColorSource(files="")) == ()
    (note,) = color_notes(ColorSource(files="", range=(0, 65535)))
    assert "0 becomes 0 and 65535 becomes 255" in note
    document = {
        **GMRP_DESCRIBED,
        "version": "1.1",
        "rgb": {"files": "rgb/{id}.png", "range": [5, 5]},
    }
    with pytest.raises(LayoutError, match=r"from less to more in 'rgb', found \[5, 5\]"):
        description_from_document(document, "test")
