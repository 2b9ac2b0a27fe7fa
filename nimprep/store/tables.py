"""The bytes of a per-frame array: one chunk, packed by Zstandard, with a CRC-32C.

Decoded here and not by a Zarr library: what a store from anywhere names as its codecs is compared
with what the format says instead of looked up and run, and how much it unpacks to is known before
memory is taken for it.

Source: Zarr v3 specification; RFC 8878, 3.1.1 (the frame header of Zstandard); the vlen-utf8 codec
of numcodecs.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import google_crc32c
import numpy as np
import numpy.typing as npt

from nimprep.store.spec import MAX_FRAMES, ArraySpec

LARGEST_CHUNK = 1 << 28
"""Packed bytes; a table of the most frames takes less even where nothing can be packed."""

_ROOM_FOR_TEXT = 1 << 20
_TEXT_PER_FRAME = 256
"""Bytes that the names of frames may take on average, beside the room that all may share."""

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class TableError(ValueError):
    """A table is damaged, or laid out in another way than the format says; what was found."""


def decode_table(document: dict[str, Any], spec: ArraySpec, chunk: bytes) -> npt.NDArray[Any]:
    """Return the values of a per-frame array, (frame, *spec.rest), from its metadata and its chunk.

    Raises
    ------
    TableError
        It is laid out in another way than the format says, or damaged.
    """
    shape = check_table(document, spec)
    if len(chunk) < 4 or google_crc32c.value(chunk[:-4]) != int.from_bytes(chunk[-4:], "little"):
        raise TableError("a wrong checksum")
    if spec.dtype == "string":
        return _strings(_unpacked(chunk[:-4], None, shape[0]), shape[0])
    dtype = np.dtype(spec.dtype).newbyteorder("<")
    data = _unpacked(chunk[:-4], math.prod(shape) * dtype.itemsize, shape[0])
    return np.frombuffer(data, dtype).astype(spec.dtype).reshape(shape)


def check_table(document: dict[str, Any], spec: ArraySpec) -> tuple[int, ...]:
    """Return a per-frame array's shape.

    Raises
    ------
    TableError
        Its metadata is not what the format says.
    """
    first = "vlen-utf8" if spec.dtype == "string" else "bytes"
    try:
        shape, codecs = document["shape"], document["codecs"]
        chunk_shape = document["chunk_grid"]["configuration"]["chunk_shape"]
        endian = (codecs[0].get("configuration") or {}).get("endian", "little")
        expected: list[tuple[str, Any, Any]] = [
            ("zarr_format", 3, document["zarr_format"]),
            ("node_type", "array", document["node_type"]),
            ("data type", spec.dtype, document["data_type"]),
            ("dimensions", list(spec.dims), document.get("dimension_names")),
            ("dimensions of shape", len(spec.dims), len(shape)),
            ("shape after the frame", list(spec.rest), shape[1:]),
            ("chunk grid", "regular", document["chunk_grid"]["name"]),
            ("one chunk of shape", shape, chunk_shape),
            ("codecs", [first, "zstd", "crc32c"], [codec["name"] for codec in codecs]),
            ("byte order", "little", endian),
            ("transformers", [], document.get("storage_transformers", [])),
        ]
    except (KeyError, TypeError, IndexError, AttributeError) as error:
        raise TableError(f"metadata that is malformed ({error!r:.200})") from error
    for what, wanted, found in expected:
        if wanted != found:
            raise TableError(f"other metadata than {what} {wanted}: {found!r:.200}")
    if type(shape[0]) is not int or not 0 < shape[0] <= MAX_FRAMES:
        raise TableError(f"{shape[0]!r:.200} frames; a store holds 1 to {MAX_FRAMES}")
    return tuple(shape)


def _unpacked(packed: bytes, size: int | None, frames: int) -> bytes:
    """Return the `size` bytes that were packed; None = as many as names of frames may take."""
    from numcodecs import zstd

    claimed = _content_size(packed)
    most = _ROOM_FOR_TEXT + (4 + _TEXT_PER_FRAME) * frames
    if claimed is None or (claimed > most if size is None else claimed != size):
        raise TableError(f"a chunk of {claimed} bytes, unpacked")
    out = np.empty(claimed, dtype=np.uint8)
    try:
        zstd.decompress(packed, out)
    except RuntimeError as error:
        raise TableError(str(error)) from error
    return out.tobytes()


def _content_size(packed: bytes) -> int | None:
    """Return how many bytes a Zstandard frame says it unpacks to; None = it does not say."""
    if len(packed) < 6 or packed[:4] != _ZSTD_MAGIC:
        return None
    flags = packed[4]
    single = flags >> 5 & 1
    start = 5 + (1 - single) + (0, 1, 2, 4)[flags & 3]
    length = (single, 2, 4, 8)[flags >> 6]
    field = packed[start : start + length]
    if length == 0 or len(field) < length:
        return None
    return int.from_bytes(field, "little") + (256 if length == 2 else 0)


def _strings(data: bytes, count: int) -> npt.NDArray[Any]:
    """Return the strings of numcodecs' vlen-utf8: how many, then each one's length and bytes."""
    strings, place = [], 4
    if data[:4] != struct.pack("<I", count):
        raise TableError(f"another number of strings than {count}")
    for _ in range(count):
        length = int.from_bytes(data[place : place + 4], "little")
        stop = place + 4 + length
        if stop > len(data):
            raise TableError("strings that end beyond their chunk")
        try:
            strings.append(data[place + 4 : stop].decode("utf-8"))
        except UnicodeDecodeError as error:
            raise TableError(f"a string that is no UTF-8 ({error.reason})") from error
        place = stop
    return np.array(strings, dtype=object)
