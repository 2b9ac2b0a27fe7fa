"""Image files made byte by byte, and the same pixels in every format that is read."""

from __future__ import annotations

import io
import struct
import zlib
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

SIGNATURE = b"\x89PNG\r\n\x1a\n"
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a PNG chunk with the checksum that fits."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(width: int, height: int, bits: int = 8, kind: int = 0, interlace: int = 0) -> bytes:
    """Return the chunk IHDR."""
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, interlace))


def png(
    width: int = 32,
    height: int = 24,
    bits: int = 8,
    kind: int = 0,
    *,
    interlace: int = 0,
    packed: bytes | None = None,
    before: bytes = b"",
    after: bytes = b"",
) -> bytes:
    """Return a black PNG, with chunks before and after its pixels."""
    if packed is None:
        row = -(-width * CHANNELS.get(kind, 1) * bits // 8)
        packed = zlib.compress(bytes((row + 1) * height))
    pixels = chunk(b"IDAT", packed)
    parts = (header(width, height, bits, kind, interlace), before, pixels, after)
    return SIGNATURE + b"".join(parts) + chunk(b"IEND", b"")


def refitted(data: bytes) -> bytes:
    """Return a damaged PNG with the checksums made to fit, so that the damage reaches libpng."""
    out, place = [data[:8]], 8
    while place + 12 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        if place + 12 + length > len(data):
            break
        out.append(chunk(data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    return b"".join([*out, data[place:]])


@cache
def bomb(megabytes: int) -> bytes:
    """Return a zlib stream that unpacks to so many megabytes of zeros."""
    packer = zlib.compressobj(9)
    zeros = bytes(1 << 20)
    return b"".join(packer.compress(zeros) for _ in range(megabytes)) + packer.flush()


def picture(dtype: str = "uint8", channels: int = 3) -> npt.NDArray[np.generic]:
    """Return some smooth image of 24x32 pixels."""
    v, u = np.mgrid[:24, :32]
    plane = 1000 + 40 * v + 13 * u if dtype != "uint8" else 60 + 4 * v + 2 * u
    image = np.stack([plane + 9 * c for c in range(channels)], axis=2).astype(dtype)
    return image[:, :, 0] if channels == 1 else image


def encoded(ending: str, image: npt.NDArray[np.generic], *options: int) -> bytes:
    """Return the image as OpenCV writes it."""
    written, data = cv2.imencode(ending, image, list(options))
    assert written
    return data.tobytes()


def npy(array: npt.NDArray[np.generic], *, pickled: bool = False) -> bytes:
    """Return the array as NumPy writes it."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=pickled)
    return file.getvalue()


def npy_of(text: str, data: bytes = b"", version: int = 1) -> bytes:
    """Return a NumPy file with this header."""
    size = struct.pack("<H" if version == 1 else "<I", len(text))
    return b"\x93NUMPY" + bytes((version, 0)) + size + text.encode("latin-1") + data


SAMPLES: dict[str, bytes] = {
    "colour.png": encoded(".png", picture()),
    "palette.png": png(kind=3, before=chunk(b"PLTE", bytes(range(48)))),
    "depth.png": encoded(".png", picture("uint16", 1)),
    "label.png": png(bits=2),
    "interlaced.png": png(
        8, 8, interlace=1, packed=zlib.compress(bytes(2 + 2 + 3 + 6 + 10 + 20 + 36))
    ),
    "baseline.jpg": encoded(".jpg", picture()),
    "progressive.jpg": encoded(".jpg", picture(), cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "restarts.jpg": encoded(".jpg", picture(), cv2.IMWRITE_JPEG_RST_INTERVAL, 1),
    "lzw.tif": encoded(".tif", picture()),
    "plain.tif": encoded(".tif", picture("uint16", 1), cv2.IMWRITE_TIFF_COMPRESSION, 1),
    "float.tif": encoded(".tif", picture("float32", 1)),
    "colour.bmp": encoded(".bmp", picture()),
    "colour.webp": encoded(".webp", picture()),
    "colour.ppm": encoded(".ppm", picture()),
    "depth.pgm": encoded(".pgm", picture("uint16", 1)),
    "depth.pfm": encoded(".pfm", picture("float32", 1)),
    "depth.npy": npy(picture("float32", 1)),
    "columns.npy": npy(np.asfortranarray(picture("uint16", 1))),
}
"""A whole file of each format and kind."""
