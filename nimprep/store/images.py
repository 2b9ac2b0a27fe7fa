"""One image array of a store, read frame by frame straight from its shards."""

from __future__ import annotations

import math
import os
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.frame import LabelClass
from nimprep.modality import Modality
from nimprep.store.buffers import empty
from nimprep.store.checksums import MEND
from nimprep.store.image_layout import layout_problems
from nimprep.store.metadata import ROOT, read_document
from nimprep.store.shards import (
    MISSING,
    decode_chunk,
    read_checksums,
    read_chunk,
    read_index,
)
from nimprep.store.spec import image_spec
from nimprep.store.storage import Storage

Index = npt.NDArray[np.uint64]
"""Of a shard: see `nimprep.store.shards.read_index`."""

_CHUNK_OVERHEAD = 20
"""What a chunk can be larger than its image by: Blosc's header and the checksum."""


@dataclass(frozen=True)
class OwnChunks:
    """Say which chunks of an image array are a store's own.

    Attributes
    ----------
    ids : tuple of str
        Frame ids, for messages.
    checksums : bytes
        What each frame's chunk ends with, four bytes a frame.
    """

    ids: tuple[str, ...]
    checksums: bytes

    def of_frame(self, index: int) -> bytes:
        """Return what a frame's chunk ends with."""
        return self.checksums[4 * index : 4 * index + 4]


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
    own : OwnChunks, optional
        What every chunk is compared with; None = any that is undamaged will do.

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
        own: OwnChunks | None = None,
    ) -> None:
        self.modality = modality
        self.name = name = modality.name
        self.spec = spec = image_spec(modality, classes)
        self._storage = storage
        self._own = own
        document = document or read_document(storage, f"{name}/{ROOT}")
        problems = layout_problems(document, spec)
        if problems:
            raise StoreError(f"{storage}/{name}/{ROOT}: {problems[0]}")
        self.shape: tuple[int, ...] = tuple(document["shape"])
        self.dtype = np.dtype(document["data_type"])
        self.shard_length: int = document["chunk_grid"]["configuration"]["chunk_shape"][0]
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
        index = read_index(self._storage, key, self.shard_length)
        largest = math.prod(self.shape[1:]) * self.dtype.itemsize + _CHUNK_OVERHEAD
        if (index[index[:, 0] != MISSING, 1] > largest).any():
            raise StoreError(
                f"{self._storage}/{key}: expected chunks of at most {largest} bytes, found a larger"
            )
        return index

    def fetch(self, index: int) -> npt.NDArray[np.uint8] | None:
        """Return a frame's checked, still compressed chunk; None where it is all fill value.

        Raises
        ------
        StoreError
            It is damaged, or not the one that the store's tables go with.
        """
        shard, place = divmod(index, self.shard_length)
        entries = self._index_once(shard)
        packed = read_chunk(self._storage, self.shard_key(shard), entries, place)
        if self._own is not None:
            found = None if packed is None else packed[-4:].tobytes()
            if found != self._own.of_frame(index):
                raise StoreError(self._foreign(index, found))
        return packed

    def _foreign(self, index: int, found: bytes | None) -> str:
        """Return what to say of a chunk that ends with other bytes than the store's own does."""
        assert self._own is not None
        place = f"{self._storage}/{self.shard_key(index // self.shard_length)}"
        what = "none" if found is None else "another version's"
        return (
            f"{place}: frame {self._own.ids[index]!r}: expected the image that the store's tables "
            f"go with, found {what}; {MEND}"
        )

    def read_checksums(self, shard: int) -> list[int | None]:
        """Return what each chunk of a shard ends with; None for one that is not there.

        Raises
        ------
        StoreError
            The shard is missing, too short, or its index is damaged.
        """
        frames = min(self.shard_length, len(self) - shard * self.shard_length)
        index = self.read_index(shard)
        return read_checksums(self._storage, self.shard_key(shard), index, frames)

    def check_shard(self, shard: int) -> None:
        """Look at a shard's index and checksums, without its images.

        Raises
        ------
        StoreError
            The index is damaged, or a chunk is not the one that the store's tables go with.
        """
        if self._own is None:
            self.read_index(shard)
            return
        for frame, checksum in enumerate(self.read_checksums(shard), shard * self.shard_length):
            found = None if checksum is None else checksum.to_bytes(4, "little")
            if found != self._own.of_frame(frame):
                raise StoreError(self._foreign(frame, found))

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
        self, packed: npt.NDArray[np.uint8] | None, out: npt.NDArray[Any], index: int
    ) -> None:
        """Decompress what `fetch` returned into `out`, of `shape[1:]`, C-contiguous."""
        if packed is None:
            out[...] = self.spec.fill
        else:
            decode_chunk(packed, out, f"{self._storage}/{self.name}: frame {index}")

    def read(self, index: int) -> npt.NDArray[Any]:
        """Return one image as stored, padding included.

        Raises
        ------
        StoreError
            Its shard is missing, or its checksum does not fit.
        """
        out = empty(self.shape[1:], self.dtype)
        self.decode(self.fetch(index), out, index)
        return out
