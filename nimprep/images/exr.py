"""OpenEXR through the Academy's own package, OpenEXR (the extra `exr`).

The header is read here: a size that cannot be costs no memory, and a file that was cut is told
before the library, which prints what it thinks of it, sees it.

Source: OpenEXR file layout, version 2: magic number, version field, header attributes, offset
table, chunks of scan lines.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.images.archive import missing_key
from nimprep.images.header import ImageHeader, broken, check_header

SIGNATURE = b"\x76\x2f\x31\x01"

_TYPES = (np.dtype(np.uint32), np.dtype(np.float16), np.dtype(np.float32))
_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
"""Rows in a chunk by the code of compression."""

_TILED, _DEEP, _PARTS = 0x200, 0x800, 0x1000
_MOST_CHANNELS = 256


@dataclass(frozen=True)
class ExrHeader:
    """Tell what an EXR file says of itself.

    Attributes
    ----------
    height, width : int
    types : mapping of channel's name to dtype
    """

    height: int
    width: int
    types: dict[str, np.dtype[Any]]

    def chosen(self, key: str | None, path: Path) -> list[str]:
        """Return the channels that make the image: the one named, colours, or the only one.

        Raises
        ------
        DecodeError
            They do not tell.
        """
        names = list(self.types)
        if key is not None:
            if key in names:
                return [key]
            raise DecodeError(missing_key(path, key, names))
        if len(names) == 1:
            return names
        colors = [name for name in "RGBA" if name in names]
        if len(colors) == len(names) and colors[:3] == ["R", "G", "B"]:
            return colors
        raise DecodeError(missing_key(path, None, names))


def exr_header(data: bytes, path: Path, key: str | None = None) -> ImageHeader:
    """Return what an EXR file's image is, of the channel `key` or of all.

    Raises
    ------
    DecodeError
        It is cut short, deep, of several parts, or the channel is not in it.
    """
    header = _parsed(data, path)
    names = header.chosen(key, path)
    bits = 8 * max(header.types[name].itemsize for name in names)
    return ImageHeader(header.height, header.width, bits, "EXR", len(names))


def decode_exr(data: bytes, path: Path, key: str | None = None) -> npt.NDArray[Any]:
    """Return an EXR file's channel `key`, or its only one, as (H, W); colours as (H, W, 3 or 4).

    float16 and float32 stay; channels in the order R, G, B, A.

    Raises
    ------
    DecodeError
        As for the header; it is damaged, or the package OpenEXR is not there.
    """
    header = _parsed(data, path)
    names = header.chosen(key, path)
    try:
        import OpenEXR
    except ImportError as error:
        raise DecodeError(
            f"{path}: expected OpenEXR for an EXR file, found none; "
            "install the extra: pip install 'nimprep[exr]'"
        ) from error
    try:
        # Threads of its own would not live across a fork.
        file = OpenEXR.File(str(path), separate_channels=True, num_threads=0)
        planes = [np.asarray(file.channels()[name].pixels) for name in names]
    except MemoryError:
        raise
    except Exception as error:  # pybind's classes, by what the library threw
        raise broken(path, "EXR image", f"one that cannot be read: {error!s:.200}") from error
    if any(plane.shape != (header.height, header.width) for plane in planes):
        raise broken(path, "EXR image", f"pixels of {planes[0].shape}")
    return np.ascontiguousarray(planes[0]) if len(planes) == 1 else np.dstack(planes)


def _parsed(data: bytes, path: Path) -> ExrHeader:
    try:
        found, end = _attributes(data)
        header, version = _sizes(found), struct.unpack_from("<I", data, 4)[0]
        display, window = (found[f"{name}Window"] for name in ("display", "data"))
        packing = found["compression"][0]
    except (struct.error, KeyError, ValueError, IndexError) as error:
        raise broken(path, "EXR image", f"a header of {len(data)} bytes that is none") from error
    kind = f"{header.width}x{header.height} EXR of {len(header.types)} channels"
    size = sum(dtype.itemsize for dtype in header.types.values())
    # As one channel of so many bytes: all of them are decoded, whichever counts.
    check_header(ImageHeader(header.height, header.width, 8 * size, kind), path)
    if version & (_DEEP | _PARTS):
        raise DecodeError(
            f"{path}: expected a flat EXR of one part, found a deep one or one of many parts; "
            "save the channel that counts as one image"
        )
    if display != window:
        raise DecodeError(
            f"{path}: expected an EXR whose data window is its display window, found another; "
            "save it uncropped"
        )
    if not version & _TILED and packing in _ROWS:
        _check_chunks(data, end, -(-header.height // _ROWS[packing]), path)
    return header


def _attributes(data: bytes) -> tuple[dict[str, bytes], int]:
    """Return the header's attributes by name, and where they end."""
    found, place = {}, 8
    while data[place] != 0:
        name_end = data.index(b"\0", place, place + 256)
        kind_end = data.index(b"\0", name_end + 1, name_end + 257)
        (size,) = struct.unpack_from("<I", data, kind_end + 1)
        start = kind_end + 5
        if start + size > len(data):
            raise ValueError
        found[data[place:name_end].decode("latin-1")] = data[start : start + size]
        place = start + size
    return found, place + 1


def _sizes(found: dict[str, bytes]) -> ExrHeader:
    left, top, right, bottom = struct.unpack("<4i", found["dataWindow"])
    types: dict[str, np.dtype[Any]] = {}
    place, channels = 0, found["channels"]
    while channels[place] != 0 and len(types) <= _MOST_CHANNELS:
        end = channels.index(b"\0", place)
        kind, _, across, down = struct.unpack_from("<iIii", channels, end + 1)
        if kind not in range(3) or (across, down) != (1, 1):
            raise ValueError
        types[channels[place:end].decode("latin-1")] = _TYPES[kind]
        place = end + 17
    if not types:
        raise ValueError
    return ExrHeader(bottom - top + 1, right - left + 1, types)


def _check_chunks(data: bytes, table: int, count: int, path: Path) -> None:
    """Check that every chunk of rows is there."""
    if table + 8 * count > len(data):
        raise broken(path, "EXR image", f"it truncated after {len(data)} bytes")
    for start in struct.unpack_from(f"<{count}Q", data, table):
        size = int.from_bytes(data[start + 4 : start + 8], "little")
        if not table < start or start + 8 + size > len(data):
            raise broken(path, "EXR image", f"it truncated after {len(data)} bytes")
