"""EXIF orientation of every kind of file that can have one, against Pillow's turning."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageOps, TiffImagePlugin

from nimprep.errors import DecodeError
from nimprep.images import Layout, read_header, read_label, read_orientation, read_plane, read_rgb
from nimprep.images.orientation import orientation_of, turned, upright_tiff
from nimprep.images.palette import read_palette_index
from tests.hostile.fuzzing import survives
from tests.hostile.pictures import chunk

GREY = np.arange(12, dtype=np.uint8).reshape(3, 4) * np.uint8(20)
COLOR = np.dstack([GREY, GREY + 1, 255 - GREY])
ALL = range(1, 9)


def as_shown(image: np.ndarray, orientation: int) -> np.ndarray:
    """Return an image turned by Pillow."""
    shown = Image.fromarray(image)
    shown.getexif()[0x0112] = orientation
    return np.asarray(ImageOps.exif_transpose(shown))


def exif(orientation: int) -> Image.Exif:
    made = Image.Exif()
    made[0x0112] = orientation
    return made


def write(path: Path, image: np.ndarray, orientation: int, **options: object) -> Path:
    if path.suffix == ".tif":
        info = TiffImagePlugin.ImageFileDirectory_v2()
        info[0x0112] = orientation
        Image.fromarray(image).save(path, tiffinfo=info, **options)
    else:
        Image.fromarray(image).save(path, exif=exif(orientation), **options)
    return path


@pytest.mark.parametrize("orientation", ALL)
def test_an_image_is_turned_as_pillow_turns_it(orientation: int) -> None:
    assert np.array_equal(turned(GREY, orientation), as_shown(GREY, orientation))
    assert np.array_equal(turned(COLOR, orientation), as_shown(COLOR, orientation))


@pytest.mark.parametrize("orientation", ALL)
@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.webp"])
def test_what_is_read_is_what_is_shown(tmp_path: Path, name: str, orientation: int) -> None:
    lossless = {"lossless": True} if name == "a.webp" else {}
    path = write(tmp_path / name, COLOR, orientation, **lossless)
    expected = as_shown(COLOR, orientation)
    assert read_orientation(path) == orientation
    assert np.array_equal(read_rgb(path), expected)
    assert np.array_equal(read_plane(path)[..., :3], expected)
    header = read_header(path)
    assert (header.height, header.width) == expected.shape[:2]
    ignored = Layout(orientation="ignore")
    assert np.array_equal(read_plane(path, ignored)[..., :3], COLOR)
    assert (read_header(path, ignored).height, read_header(path, ignored).width) == (3, 4)


@pytest.mark.parametrize("orientation", ALL)
def test_a_jpeg_is_turned(tmp_path: Path, orientation: int) -> None:
    image = np.kron(GREY, np.ones((8, 8), np.uint8))
    path = write(tmp_path / "a.jpg", image, orientation, quality=95)
    found = read_rgb(path)[..., 0].astype(int)
    assert found.shape == as_shown(image, orientation).shape
    assert np.abs(found - as_shown(image, orientation)).max() < 12
    assert read_orientation(path) == orientation


@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_16_bit_and_packed_tiffs_are_turned_once(tmp_path: Path, orientation: int) -> None:
    image = GREY.astype(np.uint16) * np.uint16(257)
    path = write(tmp_path / "a.tif", image, orientation, compression="tiff_lzw")
    expected = turned(image, orientation)
    assert np.array_equal(read_label(path), expected)
    assert np.array_equal(read_plane(path, Layout(orientation="ignore")), image)
    data = path.read_bytes()
    assert orientation_of(upright_tiff(data)) == 1
    assert (upright_tiff(data) is data) == (orientation == 1)


def test_a_palettes_indices_are_turned(tmp_path: Path) -> None:
    image = Image.frombytes("P", (4, 3), (GREY // 20).tobytes())
    image.putpalette(list(range(36)))
    image.save(tmp_path / "a.png", exif=exif(6))
    found = read_palette_index(tmp_path / "a.png")
    assert np.array_equal(found, turned(GREY // 20, 6))


def test_a_tag_behind_a_pngs_pixels_is_found(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    Image.fromarray(GREY).save(buffer, "PNG")
    data, end = buffer.getvalue(), len(buffer.getvalue()) - 12
    tag = b"II*\0\x08\0\0\0\1\0\x12\1\3\0\1\0\0\0\6\0\0\0\0\0\0\0"
    (tmp_path / "a.png").write_bytes(data[:end] + chunk(b"eXIf", tag) + data[end:])
    assert read_orientation(tmp_path / "a.png") == 6
    assert read_header(tmp_path / "a.png").height == 4
    assert np.array_equal(read_label(tmp_path / "a.png"), turned(GREY, 6))


def test_an_orientation_can_be_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", GREY, 3)
    with pytest.raises(DecodeError, match="upright image, found EXIF orientation 3; turn it"):
        read_plane(path, Layout(orientation="refuse"))
    upright = write(tmp_path / "b.png", GREY, 1)
    assert np.array_equal(read_plane(upright, Layout(orientation="refuse")), GREY)


@pytest.mark.parametrize("value", [0, 9, 65535])
def test_an_orientation_that_is_none_is_passed_over(tmp_path: Path, value: int) -> None:
    assert read_orientation(write(tmp_path / "a.jpg", GREY, value)) == 1


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "a.webp"])
def test_damaged_tags_are_survived(tmp_path: Path, name: str) -> None:
    data = write(tmp_path / name, GREY, 6).read_bytes()
    rng = np.random.default_rng(0)
    for number in range(300):
        damaged = bytearray(data[: rng.integers(len(data))] if number % 3 == 0 else data)
        for place in rng.integers(0, max(1, min(len(damaged), 200)), 3):
            if damaged:
                damaged[place] = rng.integers(256)
        assert 1 <= orientation_of(bytes(damaged)) <= 8
        (tmp_path / name).write_bytes(damaged)
        survives("orientation", lambda: read_orientation(tmp_path / name))
        upright_tiff(bytes(damaged))


def test_a_png_of_endless_chunks_costs_little(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    Image.fromarray(GREY).save(buffer, "PNG")
    data = buffer.getvalue()
    path = tmp_path / "a.png"
    path.write_bytes(data[:33] + bytes(8) * 300_000 + data[33:])
    assert read_orientation(path) == 1
