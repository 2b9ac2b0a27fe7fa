"""Headers of BMP, WebP, PNM and PFM: sizes at fixed places, or in text."""

from __future__ import annotations

import re
import struct
from pathlib import Path

from nimprep.images.header import ImageHeader, broken

_GAP = rb"(?:\s|#[^\n]*\n)+"
_PNM = re.compile(rb"P([1-6fF])" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})\s+(\d{1,9}|-)?")
_PNM_BITS = {b"1": 1, b"4": 1, b"f": 32, b"F": 32}
_PNM_START = 1 << 12
_ANIMATED = 0x02


def pnm_header(data: bytes, path: Path) -> ImageHeader:
    """Return what the text says that a PNM (P1 to P6) or a PFM (Pf, PF) begins with."""
    match = _PNM.match(data[:_PNM_START])
    if match is None:
        raise broken(path, "PNM", "no sizes in its header")
    kind, width, height, largest = match.groups()
    channels = 3 if kind in b"36F" else 1
    bits = _PNM_BITS.get(kind) or (8 if int(largest or 0) < 256 else 16)
    return ImageHeader(int(height), int(width), bits, "PNM", channels)


def bmp_header(data: bytes, path: Path) -> ImageHeader:
    """Return a BMP's size; its pixels become three or four channels of 8 bits."""
    if len(data) < 26:
        raise broken(path, "BMP", f"it truncated after {len(data)} bytes")
    (length,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if length == 12 else "<ii", data, 18)
    # A negative height says that the rows come from the top.
    return ImageHeader(abs(height), width, 8, "BMP", 4)


def webp_header(data: bytes, path: Path) -> ImageHeader:
    """Return a still WebP's size."""
    if len(data) < 30:
        raise broken(path, "WebP", f"it truncated after {len(data)} bytes")
    if data[12:16] == b"VP8X":
        if data[20] & _ANIMATED:
            raise broken(path, "WebP", "an animation")
        width, height = (int.from_bytes(data[i : i + 3], "little") + 1 for i in (24, 27))
    elif data[12:16] == b"VP8L":
        (both,) = struct.unpack_from("<I", data, 21)
        width, height = (both & 0x3FFF) + 1, (both >> 14 & 0x3FFF) + 1
    else:
        width, height = (size & 0x3FFF for size in struct.unpack_from("<HH", data, 26))
    return ImageHeader(height, width, 8, "WebP", 4)
