"""Headers of TIFF, BMP, WebP and PNM: what they say, and that Pillow's ways do not show."""

from __future__ import annotations

import io
import struct
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from nimprep.errors import DecodeError
from nimprep.images import Layout, read_depth, read_header, read_rgb
from tests.hostile.pictures import SAMPLES, encoded, picture

HEIGHT, WIDTH = 24, 32
SHORT, LONG, RATIONAL, SIGNED_LONG = 3, 4, 5, 9
DEPTH_M = picture("float32", 1)

Entries = dict[int, list[tuple[int, int]]]


def float_tiff(changed: Entries | None = None, *, order: str = "<", big: bool = False) -> bytes:
    """Return depth of one channel, its directory at the end as OpenCV puts it.

    A tag's entries are pairs of a type and a value; those given take the place of the right ones.
    """
    start = 16 if big else 8
    pixels = DEPTH_M.astype(order + "f4").tobytes()
    tags: Entries = {256: [(LONG, WIDTH)], 257: [(LONG, HEIGHT)], 258: [(SHORT, 32)]}
    tags |= {259: [(SHORT, 1)], 262: [(SHORT, 1)], 273: [(LONG, start)], 277: [(SHORT, 1)]}
    tags |= {278: [(LONG, HEIGHT)], 279: [(LONG, len(pixels))], 339: [(SHORT, 3)]}
    tags |= changed or {}
    size, count, width = ("Q", "Q", 8) if big else ("I", "H", 4)
    directory = struct.pack(order + count, sum(map(len, tags.values())))
    for tag, entries in sorted(tags.items()):
        for kind, value in entries:
            inline = struct.pack(order + ("H" if kind == SHORT else "I"), value)
            directory += struct.pack(order + "HH" + size, tag, kind, 1) + inline.ljust(width, b"\0")
    version = struct.pack(order + "HHH", 43, 8, 0) if big else struct.pack(order + "H", 42)
    place = struct.pack(order + size, start + len(pixels))
    magic = b"II" if order == "<" else b"MM"
    return magic + version + place + pixels + directory + bytes(width)


def saved(kind: str, image: np.ndarray, **options: object) -> bytes:
    """Return the image as Pillow writes it."""
    file = io.BytesIO()
    PIL.Image.fromarray(image).save(file, kind, **options)
    return file.getvalue()


COLOUR = picture()
ALPHA = np.dstack([COLOUR, COLOUR[:, :, :1]])
SECOND_PAGE = [PIL.Image.new("L", (7, 5))]

HEADERS = {
    "a bit.tif": (saved("TIFF", COLOUR[:, :, 0] > 99), 1, "TIFF", 1),
    "grey.tif": (saved("TIFF", COLOUR[:, :, 0]), 8, "TIFF", 1),
    "colour.tif": (saved("TIFF", COLOUR, compression="tiff_lzw"), 8, "TIFF", 3),
    "alpha.tif": (saved("TIFF", ALPHA), 8, "TIFF", 4),
    "sixteen.tif": (SAMPLES["plain.tif"], 16, "TIFF", 1),
    "float.tif": (SAMPLES["float.tif"], 32, "TIFF", 1),
    "double.tif": (encoded(".tif", picture("float64", 1)), 64, "TIFF", 1),
    "pages.tif": (saved("TIFF", COLOUR, save_all=True, append_images=SECOND_PAGE), 8, "TIFF", 3),
    "turned.tif": (saved("TIFF", COLOUR, tiffinfo={274: 6}), 8, "TIFF", 3),
    "signed.tif": (float_tiff({258: [(SIGNED_LONG, 32)]}), 32, "TIFF", 1),
    "grey.bmp": (encoded(".bmp", COLOUR[:, :, 0]), 8, "BMP", 4),
    "colour.bmp": (SAMPLES["colour.bmp"], 8, "BMP", 4),
    "lossy.webp": (saved("WEBP", COLOUR), 8, "WebP", 4),
    "lossless.webp": (saved("WEBP", ALPHA, lossless=True), 8, "WebP", 4),
    "bits.pbm": (b"P4 32 24\n" + bytes(96), 1, "PNM", 1),
    "eight.pgm": (b"P5 32 24 255\n" + bytes(768), 8, "PNM", 1),
    "sixteen.pgm": (SAMPLES["depth.pgm"], 16, "PNM", 1),
    "eight.ppm": (SAMPLES["colour.ppm"], 8, "PNM", 3),
    "sixteen.ppm": (b"P6 32 24 1000\n" + bytes(4608), 16, "PNM", 3),
    "comments.ppm": (b"P6\n# 1 2\n32\n#\n24\n# 255\n65535\n" + bytes(4608), 16, "PNM", 3),
    "text.pgm": (b"P2 32 24 15\n" + b"7 " * 768, 8, "PNM", 1),
    "text.ppm": (b"P3 32 24 256\n" + b"7 " * 2304, 16, "PNM", 3),
    "grey.pfm": (SAMPLES["depth.pfm"], 32, "PNM", 1),
    "colour.pfm": (b"PF 32 24 -1.0\n" + bytes(9216), 32, "PNM", 3),
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_is_of_the_pixels_as_stored(tmp_path: Path, name: str) -> None:
    data, bits, kind, channels = HEADERS[name]
    path = tmp_path / name
    path.write_bytes(data)
    found = read_header(path, Layout(orientation="ignore"))
    assert (found.height, found.width) == (HEIGHT, WIDTH)
    assert (found.bits, found.kind, found.channels) == (bits, kind, channels)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_depth_of_either_byte_order_and_size_of_tiff_is_read(
    tmp_path: Path, order: str, big: bool
) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(float_tiff(order=order, big=big))
    assert np.array_equal(read_depth(path), DEPTH_M)


ODD_BITS = {"signed": [(SIGNED_LONG, 32)], "twice": [(SHORT, 32), (SHORT, 1)]}


@pytest.mark.parametrize("case", ODD_BITS)
def test_bits_that_are_written_oddly_leave_the_depth_right(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(float_tiff({258: ODD_BITS[case]}))
    assert np.array_equal(read_depth(path), DEPTH_M)


@pytest.mark.parametrize("name", ["sixteen.ppm", "comments.ppm", "sixteen.pgm", "grey.pfm"])
def test_colour_of_more_than_8_bits_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(HEADERS[name][0])
    with pytest.raises(DecodeError, match=r"expected an 8-bit colour image, found 32x24 (16|32)-"):
        read_rgb(path)


def test_a_tiff_that_is_cut_anywhere_has_no_header(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    whole = float_tiff()
    for length in range(4, len(whole), 5):
        path.write_bytes(whole[:length])
        with pytest.raises(DecodeError, match="expected a whole TIFF, found"):
            read_header(path)


BAD = {
    "no width": (b"II*\0\x08\0\0\0" + bytes(20), "whole TIFF.* tag 256 is None"),
    "a fraction of bits": (float_tiff({258: [(RATIONAL, 8)]}), "whole TIFF.* tag 258"),
    "entries without end": (
        b"II+\0\x08\0\0\0" + struct.pack("<QQ", 16, 1 << 40) + bytes(2 << 20),
        "whole TIFF.* more than it has bytes",
    ),
    "an animation": (
        saved("WEBP", COLOUR, save_all=True, append_images=[PIL.Image.fromarray(COLOUR[::-1])]),
        "whole WebP, found an animation",
    ),
    "half a WebP": (HEADERS["lossy.webp"][0][:25], "whole WebP, found one of 25 bytes"),
    "half a BMP": (SAMPLES["colour.bmp"][:20], "whole BMP, found one of 20 bytes"),
    "a comment without end": (b"P5 #" + bytes(2 << 20), "whole PNM"),
    "100 megapixels": (
        SAMPLES["colour.bmp"].replace(struct.pack("<ii", 32, 24), struct.pack("<ii", 10000, 9999)),
        "1 to 67108864 pixels, found a header of 10000x9999 8-bit BMP",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_header_is_refused_in_one_line_that_says_why(tmp_path: Path, case: str) -> None:
    data, said = BAD[case]
    path = tmp_path / "a.image"
    path.write_bytes(data)
    with pytest.raises(DecodeError, match=rf"a\.image: expected an? .*{said}") as caught:
        read_header(path)
    assert "\n" not in str(caught.value)


def test_no_thread_hears_of_odd_tags_and_no_filter_of_warnings_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    # Its description of 99 letters would stand beyond the file's end.
    odd = bytearray(float_tiff({270: [(2, 1 << 31)]}))
    place = odd.index(struct.pack("<HHI", 270, 2, 1))
    odd[place + 4 : place + 8] = struct.pack("<I", 99)
    path.write_bytes(odd)
    whole = tmp_path / "b.tif"
    whole.write_bytes(SAMPLES["float.tif"])
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        with ThreadPoolExecutor(4) as pool:
            bits = list(pool.map(lambda _: read_header(whole).bits, range(40)))
            ends = [pool.submit(read_header, path).exception() for _ in range(40)]
        warnings.warn("still heard", stacklevel=1)
    assert bits == [32] * 40
    assert {type(end) for end in ends} <= {DecodeError, type(None)}
    assert [str(warning.message) for warning in heard] == ["still heard"]


_LOADED = """
import sys
from pathlib import Path
from nimprep.images import read_rgb
for name in ("baseline.jpg", "colour.png", "lzw.tif"):
    read_rgb(Path(sys.argv[1]) / name)
    print("PIL" in sys.modules)
"""


def test_pillow_is_imported_when_it_is_first_needed(tmp_path: Path) -> None:
    for name in ("baseline.jpg", "colour.png", "lzw.tif"):
        (tmp_path / name).write_bytes(SAMPLES[name])
    command = [sys.executable, "-c", _LOADED, str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False", "True"]
