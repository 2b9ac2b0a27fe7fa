"""Image files of every format: damaged anywhere, or made to deceive."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import strategies as st

from nimprep.errors import DecodeError
from nimprep.frame import MAX_PIXELS
from nimprep.images import read_depth, read_header, read_label, read_rgb
from nimprep.images.palette import read_palette_index
from nimprep.kitti.images import read_confidence, read_ground_truth
from tests.hostile import pictures
from tests.hostile.damage import damaged
from tests.hostile.fuzzing import fuzz, limited_time, survives
from tests.hostile.pictures import SAMPLES, bomb, chunk, png

READERS = (
    read_header,
    read_rgb,
    read_depth,
    read_label,
    read_palette_index,
    read_confidence,
    read_ground_truth,
)


def read_all(path: Path, kind: str) -> int:
    """Try every reader on a file; return how many took it."""
    found = [survives(kind, lambda reader=reader: reader(path)) for reader in READERS]
    return sum(result is not None for result in found)


@pytest.mark.parametrize("name", SAMPLES)
def test_whole_files_are_read(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(SAMPLES[name])
    header = read_header(path)
    rgb = read_all(path, "whole images")
    assert rgb >= 2
    if "colour" in name or name.endswith(".jpg"):
        found = read_rgb(path).astype(int)[:, :, ::-1]
        assert found.shape[:2] == (header.height, header.width)
        assert np.abs(found - pictures.picture()).max() <= (20 if "jpg" in name else 0)
    elif "depth" in name or name in ("plain.tif", "float.tif", "columns.npy"):
        assert np.array_equal(read_depth(path), pictures.picture("uint16", 1))


@st.composite
def images(draw: st.DrawFn) -> tuple[str, bytes]:
    name = draw(st.sampled_from(sorted(SAMPLES)))
    data = draw(damaged(SAMPLES[name]))
    # Without, hardly any damage to a PNG would come further than its checksums.
    refit = name.endswith(".png") and draw(st.integers(0, 3))
    return name, pictures.refitted(data) if refit else data


@fuzz(400, image=images())
def test_any_damage_is_refused_or_gives_an_image(tmp_path: Path, image: tuple[str, bytes]) -> None:
    name, data = image
    path = tmp_path / name
    path.write_bytes(data)
    read_all(path, f"images, .{name.rpartition('.')[2]}")


@fuzz(100, data=st.binary(max_size=200), name=st.sampled_from(["a.png", "a.npy"]))
def test_any_bytes_are_refused_or_an_image(tmp_path: Path, data: bytes, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    read_all(path, "images, any bytes")


def animation(frames: int, width: int = 32, height: int = 24) -> bytes:
    control = (0).to_bytes(4, "big") + width.to_bytes(4, "big") + height.to_bytes(4, "big")
    return chunk(b"acTL", frames.to_bytes(4, "big") + bytes(4)) + chunk(
        b"fcTL", control + bytes(8) + b"\0\1\0\1\0\0"
    )


BAD_PNGS = {
    "100000x100000": png(100_000, 100_000, packed=b"x"),
    "4294967295x1": png(0xFFFFFFFF, 1, packed=b"x"),
    "a side of nothing": png(0, 24, packed=b"x"),
    "all the pixels that may be, in 60 bytes": png(8192, 8192, 16, 6, packed=bytes(60)),
    "a palette of 16 bits": png(bits=16, kind=3, before=chunk(b"PLTE", bytes(768))),
    "colour of 4 bits": png(bits=4, kind=2),
    "3 bits": png(bits=3),
    "no such kind": png(kind=5),
    "an unknown interlace": png(interlace=2),
    "a palette that is not there": png(kind=3),
    "no pixels": pictures.SIGNATURE + pictures.header(32, 24) + chunk(b"IEND", b""),
    "pixels twice": png(before=chunk(b"IDAT", b"x") + chunk(b"PLTE", bytes(3))),
    "two headers": png(before=pictures.header(20000, 20000, 16, 6)),
    "a header of another length": png().replace(b"\0\0\0\x0dIHDR", b"\0\0\0\x0eIHDR"),
    "an unknown chunk that matters": png(before=chunk(b"ABCD", b"")),
    "fewer pixels than claimed": png(packed=bomb(1)[:20]),
    "a chunk longer than the file": png()[:-12] + b"\xff\xff\xff\xffIEND",
    "an image of a gigabyte in 24x32": png(packed=bomb(1024)),
}


@pytest.mark.parametrize("case", BAD_PNGS)
def test_a_png_made_to_deceive_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(BAD_PNGS[case])
    for reader in (read_rgb, read_depth, read_label):
        with limited_time(), pytest.raises(DecodeError, match=r"a\.png: expected"):
            reader(path)
    read_all(path, "images, made to deceive")


HARMLESS_PNGS = {
    "a text of a gigabyte": chunk(b"zTXt", b"k\0\0" + bomb(1024)),
    "a colour profile of a gigabyte": chunk(b"iCCP", b"k\0\0" + bomb(1024)),
    "an animation": animation(100_000),
    "an animation of another size": animation(2, 100_000, 100_000),
    "an animation of nothing": chunk(b"acTL", bytes(8)),
}


@pytest.mark.parametrize("case", HARMLESS_PNGS)
def test_what_no_pixel_depends_on_is_passed_over(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(before=HARMLESS_PNGS[case]))
    with limited_time():
        assert read_label(path).shape == (24, 32)
        assert not read_rgb(path).any()
    read_all(path, "images, made to deceive")


def test_an_animation_is_its_still_image(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    hidden = (1).to_bytes(4, "big") + bomb(1)[:60]
    path.write_bytes(png(before=animation(1), after=chunk(b"fdAT", hidden)))
    assert not read_label(path).any()


BIG_JPEG = bytearray(SAMPLES["baseline.jpg"])
_PLACE = BIG_JPEG.index(b"\xff\xc0") + 5
BIG_JPEG[_PLACE : _PLACE + 4] = b"\xff\xff\xff\xff"
SCAN = SAMPLES["progressive.jpg"][SAMPLES["progressive.jpg"].index(b"\xff\xda") : -2]

BAD_JPEGS = {
    "65535x65535": bytes(BIG_JPEG),
    "ten thousand scans": SAMPLES["progressive.jpg"][:-2] + 10_000 * SCAN + b"\xff\xd9",
    "no scan": SAMPLES["baseline.jpg"][: SAMPLES["baseline.jpg"].index(b"\xff\xda")] + b"\xff\xd9",
    "arithmetic coding": SAMPLES["baseline.jpg"].replace(b"\xff\xc0", b"\xff\xc9"),
    "a segment longer than the file": b"\xff\xd8\xff\xe0\xff\xff" + b"x" * 50,
    "a segment of length 0": b"\xff\xd8\xff\xe0\0\0" + b"x" * 50,
    "nothing but markers": b"\xff" * 1000,
}


@pytest.mark.parametrize("case", BAD_JPEGS)
def test_a_jpeg_made_to_deceive_is_refused(tmp_path: Path, case: str) -> None:
    path = tmp_path / "a.jpg"
    path.write_bytes(BAD_JPEGS[case])
    with limited_time(), pytest.raises(DecodeError, match=r"a\.jpg: expected"):
        read_rgb(path)
    read_all(path, "images, made to deceive")


@pytest.mark.parametrize("name", ["baseline.jpg", "progressive.jpg"])
def test_a_jpeg_cut_and_closed_again_is_refused(tmp_path: Path, name: str) -> None:
    image = cv2.resize(pictures.picture(), (320, 240))
    image = image + np.random.default_rng(0).integers(0, 9, image.shape, dtype=np.uint8)
    options = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1) if "prog" in name else ()
    whole = pictures.encoded(".jpg", image, *options)
    path = tmp_path / name
    # The last scan of a progressive JPEG only refines what the others gave.
    end = whole.rindex(b"\xff\xda") if options else len(whole)
    for share in range(1, 10):
        path.write_bytes(whole[: end * share // 10] + b"\xff\xd9")
        with pytest.raises(DecodeError, match=name):
            read_rgb(path)


def test_a_whole_jpeg_that_ends_in_grey_is_read(tmp_path: Path) -> None:
    image = pictures.picture()
    image[8:] = 128
    path = tmp_path / "a.jpg"
    path.write_bytes(pictures.encoded(".jpg", image))
    assert (read_rgb(path)[-1, -1] == 128).all()


def tiff(**tags: int) -> bytes:
    """Return a TIFF's header and directory, without pixels."""
    numbers = {"width": 256, "height": 257, "bits": 258, "packing": 259, "channels": 277}
    numbers |= {"tile_width": 322, "tile_height": 323}
    entries = b"".join(
        numbers[name].to_bytes(2, "little") + b"\4\0\1\0\0\0" + value.to_bytes(4, "little")
        for name, value in tags.items()
    )
    return b"II*\0\x08\0\0\0" + len(tags).to_bytes(2, "little") + entries + bytes(4)


BAD_OTHERS = {
    "a.tif": tiff(width=100_000, height=100_000, bits=8),
    "tiles.tif": tiff(width=32, height=24, bits=8, tile_width=65_536, tile_height=65_536),
    "packed.tif": tiff(width=32, height=24, bits=8, packing=34712),
    "channels.tif": tiff(width=32, height=24, bits=8, channels=60_000),
    "far.tif": b"II*\0\xff\xff\xff\xff",
    "big.tif": b"II+\0\x08\0\0\0" + b"\xff" * 8,
    "a.bmp": b"BM" + bytes(12) + b"\x28\0\0\0" + b"\xff\xff\xff\x7f" * 2 + bytes(20),
    "least.bmp": b"BM" + bytes(12) + b"\x28\0\0\0" + b"\0\0\0\x80" * 2 + bytes(20),
    "a.webp": b"RIFF\xff\xff\0\0WEBPVP8X" + bytes(8) + b"\xff" * 6,
    "animated.webp": b"RIFF\xff\xff\0\0WEBPVP8X\x0a\0\0\0\2" + bytes(20),
    "a.ppm": b"P6 100000 100000 255\n",
    "text.pgm": b"P2 " + b"#" * 5000,
    "a.gif": b"GIF89a" + b"\xff" * 20,
    "a.exr": b"\x76\x2f\x31\x01" + bytes(40),
    "a.hdr": b"#?RADIANCE\n\n-Y 100000 +X 100000\n",
}


@pytest.mark.parametrize("name", BAD_OTHERS)
def test_other_formats_are_refused_by_their_headers(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(BAD_OTHERS[name])
    with limited_time(), pytest.raises(DecodeError, match="expected"):
        read_rgb(path)
    assert read_all(path, "images, made to deceive") == 0


@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "endless", "terabyte"])
@pytest.mark.parametrize("name", ["a.png", "a.npy"])
def test_what_is_no_file_is_no_image(tmp_path: Path, kind: str, name: str) -> None:
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "terabyte":
        path.write_bytes(SAMPLES["depth.png"])
        os.truncate(path, 1 << 40)
    else:
        path.symlink_to("/dev/zero" if kind == "endless" else "/dev/tty")
    for reader in (read_rgb, read_depth, read_label):
        with limited_time(), pytest.raises(DecodeError, match=r"expected"):
            reader(path)


def test_the_largest_image_there_may_be_is_read(tmp_path: Path) -> None:
    side = int(MAX_PIXELS**0.5)
    path = tmp_path / "a.png"
    path.write_bytes(png(side, side, 1))
    assert read_label(path).shape == (side, side)
    path.write_bytes(png(side, side + 1, 1))
    with pytest.raises(DecodeError, match=f"1 to {MAX_PIXELS} pixels"):
        read_label(path)


_READ_ALL = """
import sys
from pathlib import Path
from nimprep.errors import DecodeError
from nimprep.images import read_depth, read_rgb
for path in sorted(Path(sys.argv[1]).iterdir()):
    for read in (read_rgb, read_depth):
        try:
            print(read(path).shape)
        except DecodeError:
            pass
"""


def test_a_file_cut_in_half_makes_no_library_print_anything(tmp_path: Path) -> None:
    for name, data in SAMPLES.items():
        (tmp_path / name).write_bytes(data[: len(data) // 2])
    command = [sys.executable, "-c", _READ_ALL, str(tmp_path)]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (result.stdout, result.stderr) == ("", "")
