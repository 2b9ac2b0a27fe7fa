"""Shard files of the Zarr v3 `sharding_indexed` codec: chunks one after another, then an index.

The index holds (offset, length) of each chunk as little-endian uint64 and ends with its CRC-32C.
Each chunk here is one frame's image, compressed, followed by its own CRC-32C. Reading straight
from the file, instead of through a Zarr library, takes the per-read overhead out: one open, one
read, one check and one decompression into place.

Source: Zarr v3 specification, sharding-indexed and crc32c codecs, version 1.0.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import google_crc32c
import numpy as np
import numpy.typing as npt
from numcodecs import blosc

from nimprep.errors import StoreError
from nimprep.store.buffers import empty
from nimprep.store.checksums import MEND
from nimprep.store.spec import ChunkCodec

if TYPE_CHECKING:
    from nimprep.store.storage import Storage

MISSING = 2**64 - 1
"""Offset, in an index, of a chunk that is all fill value and not there."""
_CRC_RESIDUE = 0x48674BC7
"""CRC-32C of any bytes followed by their own CRC-32C: checks a chunk without cutting it apart."""
_LENGTHS = struct.Struct("<3I")
"""In a Blosc header from byte 4 on: unpacked bytes, bytes per block, packed bytes."""
_SHUFFLE = {"noshuffle": 0, "shuffle": 1, "bitshuffle": 2}


def encode_chunk(image: npt.NDArray[Any], codec: ChunkCodec) -> bytes:
    """Return one image as the bytes of its chunk: compressed, with its checksum.

    Safe to call from several threads: one thread each, and the GIL is released meanwhile.
    """
    settings = codec.configuration
    packed: bytes = blosc.compress(
        np.ascontiguousarray(image),
        settings["cname"].encode(),
        settings["clevel"],
        _SHUFFLE[settings["shuffle"]],
        settings["blocksize"],
        typesize=settings["typesize"],
    )
    return packed + struct.pack("<I", google_crc32c.value(packed))


def encode_shard(chunks: Sequence[bytes], capacity: int) -> list[bytes]:
    """Return a shard's parts, to be written one after another: the chunks, then the index.

    Parameters
    ----------
    chunks : sequence of bytes
        In frame order.
    capacity : int
        Frames a full shard holds; the places of those that are not there are marked missing.
    """
    entries, offset = [], 0
    for chunk in chunks:
        entries += [offset, len(chunk)]
        offset += len(chunk)
    entries += [MISSING] * (2 * (capacity - len(chunks)))
    index = struct.pack(f"<{2 * capacity}Q", *entries)
    return [*chunks, index + struct.pack("<I", google_crc32c.value(index))]


def index_size(capacity: int) -> int:
    """Return the bytes of the index that a shard for so many frames ends with."""
    return 16 * capacity + 4


def read_index(storage: Storage, key: str, capacity: int) -> npt.NDArray[np.uint64]:
    """Return a shard's index, (capacity, 2) uint64: offset and length of each chunk.

    Raises
    ------
    StoreError
        The shard is missing, too short, or its index is damaged.
    """
    data, end = storage.read_tail(key, index_size(capacity))
    return parse_index(data, capacity, end, f"{storage}/{key}")


def parse_index(data: bytes, capacity: int, end: int, where: str) -> npt.NDArray[np.uint64]:
    """Return the index that a shard of `end` bytes ends with, checked.

    Raises
    ------
    StoreError
        It is too short or damaged, or names bytes that are not there.
    """
    size = index_size(capacity)
    if len(data) < size:
        raise StoreError(f"{where}: expected a shard of {size} bytes or more, found {end}")
    if google_crc32c.value(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise StoreError(f"{where}: expected an undamaged shard index, found a wrong checksum")
    index = np.frombuffer(data[:-4], dtype="<u8").reshape(capacity, 2)
    there = index[:, 0] != MISSING
    # Compared as Python integers: an overflowing sum would look as if it fitted.
    if any(int(offset) + int(length) > end - size for offset, length in index[there]):
        raise StoreError(f"{where}: expected chunks within {end} bytes, found one beyond the end")
    return index


def split_shard(data: bytes, capacity: int, where: str) -> list[bytes]:
    """Return the chunks that a shard's bytes hold, in frame order, each with its checksum.

    Raises
    ------
    StoreError
        The index or a chunk is damaged.
    """
    index = parse_index(data[-index_size(capacity) :], capacity, len(data), where)
    chunks = []
    for offset, length in index[index[:, 0] != MISSING]:
        chunk = data[int(offset) : int(offset) + int(length)]
        if google_crc32c.value(chunk) != _CRC_RESIDUE:
            raise StoreError(f"{where}: expected undamaged chunks, found a wrong checksum")
        chunks.append(chunk)
    return chunks


def read_checksums(
    storage: Storage, key: str, index: npt.NDArray[np.uint64], frames: int
) -> list[int | None]:
    """Return what each of a shard's first chunks ends with, without the rest of them.

    Parameters
    ----------
    frames : int
        So many are looked at. None for those that are all fill value and therefore not there.

    Raises
    ------
    StoreError
        The shard is gone, cut short, or has a chunk too short for a checksum.
    """
    spans = [_span(index, place) for place in range(frames)]
    short = next((n for n, span in enumerate(spans) if span is not None and span[1] < 4), None)
    if short is not None:
        raise StoreError(
            f"{storage}/{key}: expected at least 4 bytes of chunk {short}, found {spans[short]}"
        )
    there = [(offset + length - 4, 4) for offset, length in filter(None, spans)]
    ends = iter(storage.read_ranges(key, there))
    return [None if span is None else int.from_bytes(next(ends), "little") for span in spans]


def read_chunk(
    storage: Storage, key: str, index: npt.NDArray[np.uint64], place: int
) -> npt.NDArray[np.uint8] | None:
    """Return the checked, still compressed bytes of one chunk, its checksum at the end.

    None where the chunk is all fill value and therefore not there.

    Raises
    ------
    StoreError
        The shard is gone, cut short, or the chunk's checksum does not fit.
    """
    span = _span(index, place)
    if span is None:
        return None
    offset, length = span
    data = empty((length,), np.uint8)
    found = storage.read_into(key, offset, data)
    if found != length or found < 4:
        raise StoreError(
            f"{storage}/{key}: expected {length} bytes of chunk {place}, found {found}; {MEND}"
        )
    if google_crc32c.value(data) != _CRC_RESIDUE:
        raise StoreError(
            f"{storage}/{key}: expected chunk {place} undamaged, found a wrong checksum; {MEND}"
        )
    return data


def _span(index: npt.NDArray[np.uint64], place: int) -> tuple[int, int] | None:
    """Return a chunk's offset and length in its shard; None where it is all fill value."""
    offset, length = int(index[place, 0]), int(index[place, 1])
    return None if offset == MISSING else (offset, length)


def decode_chunk(packed: npt.NDArray[np.uint8] | bytes, out: npt.NDArray[Any], where: str) -> None:
    """Decompress a chunk into `out`, C-contiguous, of the image's shape and dtype.

    Raises
    ------
    StoreError
        It holds another number of bytes, or is no Blosc buffer.
    """
    # A Blosc header tells both lengths: checked first, so that nothing is overrun.
    header = bytes(packed[4:16])
    unpacked, _, length = _LENGTHS.unpack(header) if len(packed) >= 20 else (0, 0, 0)
    if unpacked != out.nbytes or length != len(packed) - 4:
        raise StoreError(
            f"{where}: expected {len(packed) - 4} bytes that become {out.nbytes}, "
            f"found {length} that become {unpacked}"
        )
    try:
        blosc.decompress(packed, out)
    except (RuntimeError, ValueError) as error:
        raise StoreError(f"{where}: expected a Blosc chunk, found {error}") from error
