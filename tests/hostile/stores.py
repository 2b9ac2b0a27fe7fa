"""Parts of a store made by hand, with checksums that fit: tables, chunks, shards."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import numpy.typing as npt
from numcodecs import blosc, zstd

from nimprep.store.info import info_text, store_info
from nimprep.store.reader import open_store
from nimprep.store.table_specs import table_key as table_file
from nimprep.store.validate import validate_store
from tests.checksums import renew_checksums

MISSING = 2**64 - 1


def sealed(data: bytes) -> bytes:
    """Return bytes followed by their CRC-32C."""
    return data + struct.pack("<I", google_crc32c.value(data))


def strings(values: list[str] | list[bytes], count: int | None = None) -> bytes:
    """Return strings as vlen-utf8 has them, or as if there were `count`."""
    raw = [v.encode("utf-8", "surrogatepass") if isinstance(v, str) else v for v in values]
    parts = [struct.pack("<I", len(raw) if count is None else count)]
    parts += [struct.pack("<I", len(v)) + v for v in raw]
    return b"".join(parts)


def table(values: npt.NDArray[Any] | list[str]) -> bytes:
    """Return a table's chunk."""
    data = strings(values) if isinstance(values, list) else values.tobytes()
    return sealed(zstd.compress(data, 1))


def zstd_bomb(size: int) -> bytes:
    """Return a Zstandard frame that says, rightly, that it unpacks to so many zeros."""
    blocks = []
    left = size
    while left:
        count = min(left, 1 << 17)
        left -= count
        blocks.append((count << 3 | 1 << 1 | (left == 0)).to_bytes(3, "little") + b"\0")
    header = b"\x28\xb5\x2f\xfd" + bytes([0b11100000]) + struct.pack("<Q", size)
    return header + b"".join(blocks)


def packed(image: npt.NDArray[Any]) -> bytes:
    """Return an image as a Blosc buffer, without its checksum."""
    return bytes(blosc.compress(np.ascontiguousarray(image), b"lz4hc", 5, 0, 0, typesize=1))


def shard(chunks: list[bytes], entries: list[int] | None = None, capacity: int = 2) -> bytes:
    """Return a shard of these chunks with the index that fits, or with these offsets and sizes."""
    if entries is None:
        entries, offset = [], 0
        for chunk in chunks:
            entries += [offset, len(chunk)]
            offset += len(chunk)
        entries += [MISSING] * (2 * (capacity - len(chunks)))
    return b"".join(chunks) + sealed(struct.pack(f"<{len(entries)}Q", *entries))


@contextmanager
def changed(store: Path, files: dict[str, Any]) -> Iterator[Path]:
    """Replace files of a store, and put them back; documents are written as JSON.

    Checksums are made to fit: whoever means harm makes them fit too.
    """
    sealing = ("zarr.json", table_file("chunk_crc32c"))
    before = {key: (store / key).read_bytes() for key in (*files, *sealing)}
    try:
        for key, content in files.items():
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            (store / key).write_bytes(data)
        # A root, or a table of chunks, that a test wrote stays as that is.
        renew_checksums(store, chunks=sealing[1] not in files)
        yield store
    finally:
        for key, data in before.items():
            (store / key).write_bytes(data)


def document(store: Path, name: str = "") -> Any:
    """Return the root's document, or an array's."""
    return json.loads((store / name / "zarr.json").read_bytes())


def show(store: Path) -> None:
    """Do what `nimprep info` does."""
    found = store_info(store)
    info_text(found)
    json.dumps(found, allow_nan=False)


def check(store: Path) -> None:
    """Do what `nimprep validate --deep` does; damage is in its report."""
    report = validate_store(store, deep=True)
    json.dumps(report.to_dict(), allow_nan=False)
    assert len(report.problems) <= 100
    assert all("\n" not in problem and len(problem) <= 1000 for problem in report.problems)


def read(store: Path) -> None:
    """Read every image of every frame."""
    opened = open_store(store)
    for frame in opened:
        for name in ("rgb", "depth_m", "normal", "hha", "label"):
            getattr(frame, name)
