"""PNG: its header, and its chunks as far as pixels depend on them.

Source: PNG specification, third edition: chunks (5.3), their order (5.6), IHDR (11.2.1).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.images.header import ImageHeader, broken

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_BYTES = 33
"""The signature and the chunk IHDR."""

# By colour type: name, channels as stored and as decoded, bits there can be.
_KINDS = {
    0: ("grey", 1, 1, (1, 2, 4, 8, 16)),
    2: ("RGB", 3, 4, (8, 16)),
    3: ("palette", 1, 4, (1, 2, 4, 8)),
    4: ("grey with alpha", 2, 4, (8, 16)),
    6: ("RGBA", 4, 4, (8, 16)),
}
_USED = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
"""Chunks that pixels depend on. Texts, profiles and animations do not matter and can be bombs."""

_HARMLESS = (b"tIME", b"pHYs", b"gAMA", b"sRGB", b"cHRM", b"sBIT", b"bKGD")
"""Chunks of a few bytes that many files have: taking them out would cost a copy of the file."""

_BEST_RATIO = 1032
"""Deflate makes at most so many bytes of one: 258 of two bits."""


def png_header(data: bytes, path: Path) -> ImageHeader:
    """Return what IHDR says, from a file's first `HEADER_BYTES`.

    Raises
    ------
    DecodeError
        It is cut short, or says what no PNG can be.
    """
    if len(data) < 29 or data[8:16] != b"\0\0\0\x0dIHDR":
        raise DecodeError(f"{path}: expected a PNG with a header, found a truncated file")
    width, height, bits, kind, packing, filters, interlace = struct.unpack(">IIBBBBB", data[16:29])
    name, _, channels, depths = _KINDS.get(kind, (f"kind {kind}", 0, 1, ()))
    header = ImageHeader(height, width, bits, name, channels)
    if bits not in depths or packing or filters or interlace > 1:
        raise DecodeError(f"{path}: expected a kind of PNG there is, found a header of {header}")
    return header


def checked_png(data: bytes, path: Path) -> bytes:
    """Return a PNG without the chunks that no pixel depends on, the others checked.

    So a cut or damaged file is told before libpng complains of it, an animation is its still
    image, and what would unpack to gigabytes is left alone.

    Raises
    ------
    DecodeError
        It is cut short, a checksum is wrong, or its pixels cannot be as many as it says.
    """
    view, seen, packed = memoryview(data), [b""], 0
    kept = [view[: len(SIGNATURE)]]
    for kind, start, end in _chunks(data, path):
        if kind in _HARMLESS:
            kept.append(view[start:end])
            continue
        if kind not in _USED:
            if not kind[0] & 0x20:
                raise broken(path, "PNG", f"a chunk {kind!r}, which nobody knows")
            continue
        if (kind == b"IHDR") != (seen == [b""]):
            raise broken(path, "PNG", "its header out of place")
        packed += (end - start) * (kind == b"IDAT")
        kept.append(view[start:end])
        if kind != seen[-1]:
            seen.append(kind)
    if seen.count(b"IDAT") != 1 or (data[25] == 3 and b"PLTE" not in seen):
        raise broken(path, "PNG", "its pixels or their palette missing or out of place")
    _check_pixels(data, packed, path)
    return data if sum(map(len, kept)) == len(data) else b"".join(kept)


def _chunks(data: bytes, path: Path) -> Iterator[tuple[bytes, int, int]]:
    """Yield each chunk's kind and place, IEND's last; other bytes may follow it."""
    view, start, kind = memoryview(data), len(SIGNATURE), b""
    while kind != b"IEND":
        length = int.from_bytes(view[start : start + 4], "big")
        end = start + 12 + length
        if end > len(view):
            raise broken(path, "PNG", f"it truncated after {len(view)} bytes")
        kind = bytes(view[start + 4 : start + 8])
        if zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise DecodeError(
                f"{path}: expected an undamaged PNG, found a wrong checksum at byte {start + 4}"
            )
        yield kind, start, end
        start = end


def _check_pixels(data: bytes, packed: int, path: Path) -> None:
    """Check that the packed bytes can be the pixels: neither too few nor many times too many."""
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    rows = height * -(-width * _KINDS[kind][1] * bits // 8)
    if rows > _BEST_RATIO * packed:
        raise broken(path, "PNG", f"{packed} bytes, too few for {width}x{height} pixels")
    # Rows of an interlaced image come in pieces, each with a byte of its own.
    if packed > 2 * (rows + 2 * height) + (1 << 16):
        raise broken(path, "PNG", f"{packed} bytes, too many for {width}x{height} pixels")
