"""Zarr arrays by way of memory: zarr-python codes them, a `Storage` keeps the bytes.

So every file and every object is written and read in one way, whole and with one request, and what
goes wrong is said in one way.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy.typing as npt

from nimprep.store.metadata import ROOT
from nimprep.store.table_specs import table_key


class MemoryFiles:
    """Hold files by key, for zarr-python to read and write.

    Attributes
    ----------
    zarr : MemoryStore
        What zarr-python opens.
    """

    def __init__(self, files: Mapping[str, bytes]) -> None:
        from zarr.core.buffer import cpu
        from zarr.storage import MemoryStore

        self._buffers: Any = {key: cpu.Buffer.from_bytes(data) for key, data in files.items()}
        self.zarr = MemoryStore(self._buffers)

    def contents(self) -> dict[str, bytes]:
        """Return the files as they are now."""
        return {key: buffer.to_bytes() for key, buffer in self._buffers.items()}


def encode_table(name: str, document: bytes, values: npt.NDArray[Any]) -> bytes:
    """Return the chunk of a per-frame array that has this metadata and these values."""
    import zarr

    files = MemoryFiles({f"{name}/{ROOT}": document})
    # What is all fill value is written too: a chunk that is not there counts as damage.
    array = zarr.open_array(
        files.zarr, path=name, mode="r+", zarr_format=3, config={"write_empty_chunks": True}
    )
    array[...] = values
    return files.contents()[table_key(name)]
