"""TIFF: the header of its first image.

Source: TIFF revision 6.0: image file directory (section 2); BigTIFF as libtiff writes it.
"""

from __future__ import annotations

import struct
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.frame import MAX_PIXELS
from nimprep.images.header import ImageHeader, broken

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

_TAGS = {
    256: "width",
    257: "height",
    258: "bits",
    259: "compression",
    277: "channels",
    322: "tile_width",
    323: "tile_height",
}
_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q"}
_MOST_ENTRIES = 4096
_COMPRESSIONS = {1: "none", 5: "LZW", 7: "JPEG", 8: "deflate", 32773: "PackBits", 32946: "deflate"}
_MOST_CHANNELS = 4


def tiff_header(data: bytes, path: Path) -> ImageHeader:
    """Return what the first image's directory says.

    Raises
    ------
    DecodeError
        It is cut short, in tiles of an absurd size, or packed in a way that is not read here.
    """
    try:
        tags = _first_directory(data)
    except struct.error as error:
        raise broken(path, "TIFF", f"it truncated after {len(data)} bytes") from error
    channels = tags.get("channels", 1)
    header = ImageHeader(
        tags.get("height", 0), tags.get("width", 0), tags.get("bits", 1), "TIFF", channels
    )
    tile = tags.get("tile_width", 1) * tags.get("tile_height", 1)
    if tags.get("compression", 1) not in _COMPRESSIONS:
        known = ", ".join(dict.fromkeys(_COMPRESSIONS.values()))
        raise DecodeError(
            f"{path}: expected a TIFF packed by {known}, found code {tags['compression']}"
        )
    sane = 0 < channels <= _MOST_CHANNELS and 0 < header.bits <= 64
    if not sane or tile > MAX_PIXELS:
        raise broken(path, "TIFF", f"{channels} channels of a {header} in tiles of {tile} pixels")
    return header


def _first_directory(data: bytes) -> dict[str, int]:
    order = "<" if data[:2] == b"II" else ">"
    big = data[2:4].strip(b"\0") == b"+"
    offset_type, count_type, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    (place,) = struct.unpack_from(order + offset_type, data, 8 if big else 4)
    # struct takes a place beyond the end for an error, but not one beyond what it can count to.
    place = min(place, len(data))
    (count,) = struct.unpack_from(order + count_type, data, place)
    start = place + (8 if big else 2)
    found: dict[str, int] = {}
    for number in range(min(count, _MOST_ENTRIES)):
        tag, kind = struct.unpack_from(order + "HH", data, start + entry * number)
        if tag in _TAGS and kind in _TYPES:
            # A single value stands in the entry; of several, as for bits, they stand elsewhere.
            found[_TAGS[tag]] = _value(data, start + entry * number, order, big, _TYPES[kind])
    return found


def _value(data: bytes, entry: int, order: str, big: bool, kind: str) -> int:
    size = struct.calcsize(kind)
    (count,) = struct.unpack_from(order + ("Q" if big else "I"), data, entry + 4)
    inline = entry + (12 if big else 8)
    if size * count <= (8 if big else 4):
        return int(struct.unpack_from(order + kind, data, inline)[0])
    (place,) = struct.unpack_from(order + ("Q" if big else "I"), data, inline)
    return int(struct.unpack_from(order + kind, data, min(place, len(data)))[0])
