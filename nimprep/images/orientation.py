"""EXIF orientation: how an image is to be turned so that it shows what was photographed.

A camera writes it down instead of turning pixels; labelling tools and viewers turn by it. Metadata
that is damaged says nothing: that is what viewers make of it.

Source: Exif 2.32 (CIPA DC-008-2019), 4.6.4 A, tag 274; TIFF 6.0, section 2; PNG, third edition,
eXIf (11.3.2.1); WebP container specification, EXIF.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import open_plain
from nimprep.images import jpeg, png

OrientationRule = Literal["apply", "ignore", "refuse"]
UPRIGHT = 1

_TAG = 274
_EXIF = b"Exif\0\0"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_WHOLE = {3: "H", 4: "I"}
"""TIFF's types of whole numbers that the tag comes in."""

_MOST_CHUNKS = 1 << 16
_APP1, _SCAN = 0xE1, 0xDA


def orientation_of(data: bytes) -> int:
    """Return the orientation that an image file's bytes say, 1 to 8; 1 = as it is."""
    for place in _exif_places(data):
        found = [value for _, _, value in _entries(data, place)]
        if found:
            return found[0] if UPRIGHT <= found[0] <= 8 else UPRIGHT
    return UPRIGHT


def read_orientation(path: Path) -> int:
    """Return an image file's orientation, 1 to 8, as `orientation_of`; of others 1.

    A PNG is read in passing from chunk to chunk, of a JPEG what stands before its pixels.

    Raises
    ------
    DecodeError
        It cannot be read.
    """
    with open_plain(path) as (file, size):
        start = file.read(12)
        if start.startswith(png.SIGNATURE):
            return orientation_of(start[:8] + _png_exif(file, size))
        if start.startswith(jpeg.SIGNATURE):
            return orientation_of(_jpeg_start(file))
        if start.startswith(_TIFF) or (start[:4] == b"RIFF" and start[8:12] == b"WEBP"):
            file.seek(0)
            return orientation_of(file.read(size))
    return UPRIGHT


def upright_tiff(data: bytes) -> bytes:
    """Return a TIFF that says it is upright: OpenCV turns by the tag, whatever it is told."""
    if not data.startswith(_TIFF):
        return data
    made = bytearray(data)
    for place, code, value in _entries(data, 0):
        if value != UPRIGHT:
            struct.pack_into(code, made, place, UPRIGHT)
    return bytes(made) if made != data else data


def checked_orientation(found: int, rule: OrientationRule, path: Path) -> int:
    """Return by which orientation an image is to be turned.

    Raises
    ------
    DecodeError
        It has one, and that is to be refused.
    """
    if rule == "refuse" and found != UPRIGHT:
        raise DecodeError(
            f"{path}: expected an upright image, found EXIF orientation {found}; turn it for good, "
            'or say "orientation": "apply" or "ignore"'
        )
    return found if rule == "apply" else UPRIGHT


def turned(image: npt.NDArray[Any], orientation: int) -> npt.NDArray[Any]:
    """Return an image turned so that its orientation is 1.

    Parameters
    ----------
    image : (H, W) or (H, W, C)
    orientation : int
        1 to 8: how its first row and column lie in what it shows.

    Returns
    -------
    (H, W) or (H, W, C), from 5 on (W, H) or (W, H, C)
        C-contiguous.
    """
    if orientation == UPRIGHT:
        return image
    if orientation >= 5:
        # Rows and columns change places; then it is one of the four that are as wide as it shows.
        image, orientation = image.swapaxes(0, 1), {5: 1, 6: 2, 7: 3, 8: 4}[orientation]
    down, across = orientation in (3, 4), orientation in (2, 3)
    image = image[:: -1 if down else 1, :: -1 if across else 1]
    return np.ascontiguousarray(image)


def _exif_places(data: bytes) -> Iterator[int]:
    """Yield where in an image file TIFF's structure with the tag begins."""
    if data.startswith(_TIFF):
        yield 0
    elif data.startswith(png.SIGNATURE):
        # Hardly any has one, and searching is faster than going from chunk to chunk.
        if b"eXIf" in data:
            yield from (start + 8 for kind, start in _png_chunks(data) if kind == b"eXIf")
    elif data.startswith(jpeg.SIGNATURE):
        for marker, start in _jpeg_segments(data):
            if marker == _APP1 and data.startswith(_EXIF, start + 4):
                yield start + 4 + len(_EXIF)
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        for start in _riff_chunks(data):
            if data[start : start + 4] == b"EXIF":
                prefix = len(_EXIF) if data.startswith(_EXIF, start + 8) else 0
                yield start + 8 + prefix


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, int]]:
    start = len(png.SIGNATURE)
    while start + 12 <= len(data):
        yield data[start + 4 : start + 8], start
        start += 12 + int.from_bytes(data[start : start + 4], "big")


def _png_exif(file: Any, size: int) -> bytes:
    """Return a PNG's chunk eXIf, b"" where it has none, passing over the others."""
    start = len(png.SIGNATURE)
    for _ in range(_MOST_CHUNKS):
        file.seek(start)
        head = file.read(8)
        length = int.from_bytes(head[:4], "big")
        end = start + 12 + length
        if len(head) < 8 or head[4:] == b"IEND" or end > size:
            break
        if head[4:] == b"eXIf":
            return bytes(head + file.read(length + 4))
        start = end
    return b""


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the marker and place of each of a JPEG's segments before its pixels."""
    start = len(jpeg.SIGNATURE)
    while start + 4 <= len(data) and data[start] == 0xFF:
        marker = data[start + 1]
        if marker == 0xFF:
            start += 1
            continue
        if marker == _SCAN:
            return
        yield marker, start
        start += 2 + max(2, int.from_bytes(data[start + 2 : start + 4], "big"))


def _jpeg_start(file: Any) -> bytes:
    """Return a JPEG as far as its first APP1 with EXIF, b"" where it has none before its pixels."""
    start = len(jpeg.SIGNATURE)
    for _ in range(_MOST_CHUNKS):
        file.seek(start)
        head = file.read(4 + len(_EXIF))
        if len(head) < 4 or head[0] != 0xFF or head[1] == _SCAN:
            break
        if head[1] == 0xFF:
            start += 1
            continue
        length = max(2, int.from_bytes(head[2:4], "big"))
        if head[1] == _APP1 and head[4:] == _EXIF:
            file.seek(start)
            return jpeg.SIGNATURE + bytes(file.read(2 + length))
        start += 2 + length
    return b""


def _riff_chunks(data: bytes) -> Iterator[int]:
    start = 12
    while start + 8 <= len(data):
        yield start
        length = int.from_bytes(data[start + 4 : start + 8], "little")
        start += 8 + length + length % 2


def _entries(data: bytes, base: int) -> Iterator[tuple[int, str, int]]:
    """Yield where the tag's value lies in a TIFF's first directory, how it is packed, and it."""
    head = data[base : base + 16]
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 8:
        return
    big = head[3 if order == ">" else 2] == 43
    wide, count_code, size, value_at = ("Q", "Q", 20, 12) if big else ("I", "H", 12, 8)
    try:
        (offset,) = struct.unpack_from(order + wide, data, base + (8 if big else 4))
        start = base + offset
        (count,) = struct.unpack_from(order + count_code, data, start)
        start += struct.calcsize(count_code)
        for entry in range(start, min(start + count * size, len(data) - size + 1), size):
            tag, kind = struct.unpack_from(order + "HH", data, entry)
            if tag == _TAG and kind in _WHOLE:
                code = order + _WHOLE[kind]
                place = entry + value_at
                yield place, code, struct.unpack_from(code, data, place)[0]
    except (struct.error, OverflowError):
        return
