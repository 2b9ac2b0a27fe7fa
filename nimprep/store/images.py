"""One image array of a store, read frame by frame straight from its shards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.frame import MAX_PIXELS
from nimprep.store.buffers import empty
from nimprep.store.metadata import read_document
from nimprep.store.shards import decode_chunk, read_chunk, read_index
from nimprep.store.spec import MAX_FRAMES, ArraySpec


class ImageArray:
    """Read the images of one modality; each shard's index is read once.

    Safe to use from several threads, after a fork, and across processes (it pickles).

    Parameters
    ----------
    store : Path
        The store's folder.
    name : str
        The modality.
    spec : ArraySpec
        What the format says of it.

    Raises
    ------
    StoreError
        The array is missing or not laid out as the format says.
    """

    def __init__(self, store: Path, name: str, spec: ArraySpec) -> None:
        self.path = store / name
        self.spec = spec
        document = read_document(self.path / "zarr.json")
        problems = layout_problems(document, spec)
        if problems:
            raise StoreError(f"{self.path / 'zarr.json'}: {problems[0]}")
        self.shape: tuple[int, ...] = tuple(document["shape"])
        self.dtype = np.dtype(document["data_type"])
        self.shard_length: int = document["chunk_grid"]["configuration"]["chunk_shape"][0]
        self._shards: dict[int, tuple[Path, npt.NDArray[np.uint64]]] = {}

    def __len__(self) -> int:
        return self.shape[0]

    def shard_path(self, shard: int) -> Path:
        """Return the file of a shard."""
        return self.path.joinpath("c", str(shard), *["0"] * (len(self.shape) - 1))

    def fetch(self, frame: int) -> npt.NDArray[np.uint8] | None:
        """Return a frame's checked, still compressed chunk; None where it is all fill value."""
        shard, position = divmod(frame, self.shard_length)
        if shard not in self._shards:
            path = self.shard_path(shard)
            self._shards[shard] = path, read_index(path, self.shard_length)
        return read_chunk(*self._shards[shard], position)

    def decode(
        self, packed: npt.NDArray[np.uint8] | None, out: npt.NDArray[Any], frame: int
    ) -> None:
        """Decompress what `fetch` returned into `out`, of `shape[1:]`, C-contiguous."""
        if packed is None:
            out[...] = self.spec.fill
        else:
            decode_chunk(packed, out, f"{self.path}: frame {frame}")

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
        return [f"expected an array's metadata, found it malformed ({error!r})"]


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
        ("transformers", [], document.get("storage_transformers", [])),
    ]
    for what, wanted, found in expected:
        if wanted != found:
            problems.append(f"expected {what} {wanted}, found {found}")
    numbers = [*shape, grid[0]]
    sane = all(type(n) is int and n > 0 for n in numbers)
    if not sane or grid[0] > 1 << 16 or shape[0] > MAX_FRAMES:
        problems.append(f"expected positive sizes, found shape {shape} in shards of {grid[0]}")
    elif shape[1] * shape[2] > MAX_PIXELS or (len(shape) == 4 and shape[3] != 3):
        problems.append(f"expected images of at most {MAX_PIXELS} pixels, found shape {shape}")
    return problems
