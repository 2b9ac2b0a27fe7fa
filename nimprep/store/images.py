"""One image array of a store, read frame by frame straight from its shards."""

from __future__ import annotations

import math
import os
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.frame import MAX_PIXELS, LabelClass
from nimprep.modality import Modality
from nimprep.store.buffers import empty
from nimprep.store.metadata import ROOT, read_document
from nimprep.store.shards import (
    MISSING,
    check_chunk,
    chunk_span,
    decode_chunk,
    parse_index,
    read_chunk,
    read_index,
)
from nimprep.store.spec import MAX_FRAMES, ArraySpec, image_spec
from nimprep.store.storage import LocalStorage, Storage

Index = npt.NDArray[np.uint64]
"""Of a shard: see `nimprep.store.shards.read_index`."""

_CHUNK_OVERHEAD = 20
"""What a chunk can be larger than its image by: Blosc's header and the checksum."""


class ImageArray:
    """Read the images of one modality; each shard's index is read once.

    Safe to use from several threads, after a fork, and across processes (it pickles).

    Parameters
    ----------
    storage : Storage
        Of the store.
    modality : Modality
        As this store holds it.
    classes : tuple of LabelClass
        The store's.
    document : dict, optional
        The array's metadata, where it has been read already.

    Raises
    ------
    StoreError
        The array is missing or not laid out as the format says.
    """

    def __init__(
        self,
        storage: Storage,
        modality: Modality,
        classes: tuple[LabelClass, ...] = (),
        document: dict[str, Any] | None = None,
    ) -> None:
        self.modality = modality
        self.name = name = modality.name
        self.spec = spec = image_spec(modality, classes)
        self._storage = storage
        self._root = storage.root if isinstance(storage, LocalStorage) else None
        document = document or read_document(storage, f"{name}/{ROOT}")
        problems = layout_problems(document, spec)
        if problems:
            raise StoreError(f"{storage}/{name}/{ROOT}: {problems[0]}")
        self.shape: tuple[int, ...] = tuple(document["shape"])
        self.dtype = np.dtype(document["data_type"])
        self.shard_length: int = document["chunk_grid"]["configuration"]["chunk_shape"][0]
        self._shards: dict[int, tuple[Path, Index]] = {}
        self._indices: dict[int, Index] = {}
        self._asked: dict[tuple[int, int], Future[Index]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_asked": {}}

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def shards(self) -> range:
        """The numbers of the shards."""
        return range(-(-len(self) // self.shard_length))

    def shard_key(self, shard: int) -> str:
        """Return where a shard lies in the store."""
        return "/".join((self.name, "c", str(shard), *["0"] * (len(self.shape) - 1)))

    def read_index(self, shard: int) -> Index:
        """Return a shard's index, read anew.

        Raises
        ------
        StoreError
            The shard is missing, too short, or its index is damaged.
        """
        key = self.shard_key(shard)
        if isinstance(self._storage, LocalStorage):
            index = read_index(self._storage.locate(key), self.shard_length)
        else:
            data, size = self._storage.read_tail(key, 16 * self.shard_length + 4)
            index = parse_index(data, self.shard_length, size, f"{self._storage}/{key}")
        largest = math.prod(self.shape[1:]) * self.dtype.itemsize + _CHUNK_OVERHEAD
        if (index[index[:, 0] != MISSING, 1] > largest).any():
            raise StoreError(
                f"{self._storage}/{key}: expected chunks of at most {largest} bytes, found a larger"
            )
        return index

    def fetch(self, frame: int) -> npt.NDArray[np.uint8] | None:
        """Return a frame's checked, still compressed chunk; None where it is all fill value."""
        shard, position = divmod(frame, self.shard_length)
        if self._root is None:
            return self._requested(shard, position)
        if shard not in self._shards:
            self._shards[shard] = self._root / self.shard_key(shard), self.read_index(shard)
        return read_chunk(*self._shards[shard], position)

    def _requested(self, shard: int, position: int) -> npt.NDArray[np.uint8] | None:
        """Return a chunk by one request, after one for the index at the first of a shard."""
        span = chunk_span(self._index_once(shard), position)
        if span is None:
            return None
        offset, length = span
        found = self._storage.read_range(self.shard_key(shard), offset, length)
        data = empty((length,), np.uint8)
        data[: len(found)] = np.frombuffer(found, dtype=np.uint8)
        check_chunk(data, len(found), position, f"{self._storage}/{self.shard_key(shard)}")
        return data

    def _index_once(self, shard: int) -> Index:
        """Return a shard's index; of several threads that need it one asks, and the others wait."""
        if shard in self._indices:
            return self._indices[shard]
        # By process: a fork leaves behind the thread that would have brought the answer.
        asked = (os.getpid(), shard)
        mine: Future[Index] = Future()
        first = self._asked.setdefault(asked, mine)
        if first is mine:
            try:
                # Another thread's request may have come back since this one looked.
                if shard not in self._indices:
                    self._indices[shard] = self.read_index(shard)
                mine.set_result(self._indices[shard])
            except BaseException as error:
                mine.set_exception(error)
                raise
            finally:
                del self._asked[asked]
        return first.result()

    def decode(
        self, packed: npt.NDArray[np.uint8] | None, out: npt.NDArray[Any], frame: int
    ) -> None:
        """Decompress what `fetch` returned into `out`, of `shape[1:]`, C-contiguous."""
        if packed is None:
            out[...] = self.spec.fill
        else:
            decode_chunk(packed, out, f"{self._storage}/{self.name}: frame {frame}")

    def read(self, frame: int) -> npt.NDArray[Any]:
        """Return one image as stored, padding included.

        Raises
        ------
        StoreError
            Its shard is missing, or its checksum does not fit.
        """
        out = empty(self.shape[1:], self.dtype)
        self.decode(self.fetch(frame), out, frame)
        return out


def layout_problems(document: dict[str, Any], spec: ArraySpec) -> list[str]:
    """Return in what an image array's zarr.json differs from the format, a line each."""
    try:
        return _layout_problems(document, spec)
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        return [f"expected an array's metadata, found it malformed ({error!r:.200})"]


def _byte_orders(spec: ArraySpec, codec: dict[str, Any]) -> tuple[str, str]:
    found = codec.get("configuration", {}).get("endian", "little")
    return "little", found if spec.dtype.endswith("16") else "little"


def _layout_problems(document: dict[str, Any], spec: ArraySpec) -> list[str]:
    problems = []
    shape = document["shape"]
    grid = document["chunk_grid"]["configuration"]["chunk_shape"]
    sharding = document["codecs"][0]
    inner = sharding["configuration"]
    blosc = [codec["name"] for codec in inner["codecs"]]
    expected: list[tuple[str, Any, Any]] = [
        ("zarr_format", 3, document["zarr_format"]),
        ("node_type", "array", document["node_type"]),
        ("key encoding", "default", document["chunk_key_encoding"]["name"]),
        ("dimension names", list(spec.dims), document.get("dimension_names")),
        ("data type", spec.dtype, document["data_type"]),
        ("fill value", spec.fill, document["fill_value"]),
        ("dimensions", len(spec.dims), len(shape)),
        ("chunk grid", "regular", document["chunk_grid"]["name"]),
        ("key encoding", {"separator": "/"}, document["chunk_key_encoding"]["configuration"]),
        ("codec", "sharding_indexed", sharding["name"]),
        ("codecs", 1, len(document["codecs"])),
        ("chunk codecs", ["bytes", "blosc", "crc32c"], blosc),
        ("byte order", *_byte_orders(spec, inner["codecs"][0])),
        ("chunk shape", [1, *shape[1:]], inner["chunk_shape"]),
        ("shard shape", [grid[0], *shape[1:]], grid),
        ("index place", "end", inner.get("index_location", "end")),
        ("index codecs", ["bytes", "crc32c"], [c["name"] for c in inner["index_codecs"]]),
        (
            "index byte order",
            "little",
            inner["index_codecs"][0].get("configuration", {}).get("endian", "little"),
        ),
        ("transformers", [], document.get("storage_transformers", [])),
    ]
    for what, wanted, found in expected:
        if wanted != found:
            problems.append(f"expected {what} {wanted}, found {found!r:.200}")
    numbers = [*shape, grid[0]]
    sane = all(type(n) is int and n > 0 for n in numbers)
    if not sane or grid[0] > 1 << 16 or shape[0] > MAX_FRAMES:
        problems.append(
            f"expected positive sizes, found shape {shape!r:.200} in shards of {grid[0]!r:.200}"
        )
    elif shape[1] * shape[2] > MAX_PIXELS or (len(shape) == 4 and shape[3] != 3):
        problems.append(f"expected images of at most {MAX_PIXELS} pixels, found shape {shape}")
    return problems
