"""Putting a store's shards together from compressed images that are there already."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from itertools import chain, groupby
from operator import itemgetter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.conversion.records import DEPTHS, UnitRecord
from nimprep.errors import StoreError
from nimprep.folders import link_or_copy
from nimprep.store.checksums import MEND, chunk_checksum
from nimprep.store.reader import Store
from nimprep.store.shards import encode_chunk, read_checksums, read_index, split_shard
from nimprep.store.storage import LocalStorage
from nimprep.store.writer import StoreLayout, StoreWriter


class StoreChunks:
    """Hand out a store's compressed images: as they are, or made anew where the new store's differ.

    They do where its padded images are of another size or the codec is another.

    Parameters
    ----------
    pool : executor, optional
        Whose threads share the work; then no file is taken as it is.
    """

    def __init__(self, store: Store, layout: StoreLayout, pool: Executor | None = None) -> None:
        self._store = store
        self._layout = layout
        self._pool = pool
        shape = next(iter(store.arrays.values())).shape[1:3]
        codec = store.about.codec
        self._anew = (*shape, codec) != (layout.height, layout.width, layout.codec)

    def __len__(self) -> int:
        return len(self._store)

    def chunks(self, modality: str, frames: range) -> list[bytes]:
        """Return frames' chunks.

        Raises
        ------
        StoreError
            One is damaged.
        """
        one = partial(self._chunk, modality)
        return list(map(one, frames) if self._pool is None else self._pool.map(one, frames))

    def _chunk(self, modality: str, index: int) -> bytes:
        array = self._store.arrays[modality]
        packed = None if self._anew else array.fetch(index)
        if packed is not None:
            data: bytes = packed.tobytes()
            return data
        # Of an absent chunk, too: other programs leave out those that are all fill value.
        shape, fill = self._layout.image_shape(modality), int(self._layout.spec(modality).fill)
        image = np.full(shape, fill, dtype=array.dtype)
        image[: array.shape[1], : array.shape[2]] = array.read(index)
        return encode_chunk(image, self._layout.chunk_codec(modality))

    def whole(self, modality: str, frames: range) -> Path | None:
        """Return the file of a shard that can stay as it is; None = it lacks a chunk.

        Other programs leave out chunks that are all fill value; since format 1.1 none may lack.
        """
        array = self._store.arrays[modality]
        shard = frames.start // array.shard_length
        if self._pool is not None or len(frames) < array.shard_length:
            return None
        if self._store.tables.chunk_crc32c is None and None in array.read_checksums(shard):
            return None
        return Path(self._store.path) / array.shard_key(shard)


class UnitChunks:
    """Hand out the compressed images that units of a conversion wrote, skipped frames left out.

    Parameters
    ----------
    storage : LocalStorage
        Where they wrote them.
    layout : StoreLayout
    records : sequence of UnitRecord
    """

    def __init__(
        self, storage: LocalStorage, layout: StoreLayout, records: Sequence[UnitRecord]
    ) -> None:
        self._storage = storage
        self._writer = StoreWriter(storage, layout)
        self._places = [(r.number, n) for r in records for n in range(len(r.frames))]
        self._lengths = {r.number: len(r.frames) for r in records}

    def __len__(self) -> int:
        return len(self._places)

    def chunks(self, modality: str, frames: range) -> list[bytes]:
        """Return the chunks of some of the units' frames.

        Raises
        ------
        StoreError
            A shard is gone or damaged.
        """
        places = self._places[frames.start : frames.stop]
        found = []
        for unit, of_unit in groupby(places, key=itemgetter(0)):
            key = self._writer.shard_key(modality, unit)
            data = self._storage.read(key)
            if data is None:
                raise StoreError(
                    f"{self._storage}/{key}: expected a shard, found none; the same command makes "
                    "it again"
                )
            length = self._writer.layout.shard_length
            chunks = split_shard(data, length, f"{self._storage}/{key}")
            found += [chunks[position] for _, position in of_unit]
        return found

    def whole(self, modality: str, frames: range) -> Path | None:
        """Return the shard that holds these frames and no others; None = there is none."""
        places = self._places[frames.start : frames.stop]
        unit = places[0][0]
        if places != [(unit, n) for n in range(self._lengths[unit])]:
            return None
        return self._storage.root / self._writer.shard_key(modality, unit)


Chunks = StoreChunks | UnitChunks


def join_shards(
    writer: StoreWriter, parts: Sequence[Chunks], done: Callable[[], None]
) -> npt.NDArray[np.uint32]:
    """Write the shards of every image array; one shard at a time is held in memory.

    A file that holds just what a shard is to is linked, or copied where it cannot be.

    Parameters
    ----------
    writer : StoreWriter
    parts : sequence of Chunks
        Whose frames, one after the other, the new store has.
    done : callable
        Called for each frame.

    Returns
    -------
    (frames, modalities) uint32
        What the chunks end with that are in the shards now.

    Raises
    ------
    StoreError
        What is there is damaged, or the disk is full.
    """
    layout = writer.layout
    found = np.zeros((layout.frames, len(layout.modalities)), dtype=np.uint32)
    for number, first in enumerate(range(0, layout.frames, layout.shard_length)):
        frames = range(first, min(layout.frames, first + layout.shard_length))
        shares = list(_shares(parts, frames))
        for column, modality in enumerate(layout.modalities):
            path = shares[0][0].whole(modality, shares[0][1]) if len(shares) == 1 else None
            if path is None:
                some = list(chain.from_iterable(p.chunks(modality, own) for p, own in shares))
                writer.write_shard(modality, number, some)
                checksums = [chunk_checksum(chunk) for chunk in some]
            else:
                key = writer.shard_key(modality, number)
                link_or_copy(path, Path(str(writer.storage)) / key, StoreError)
                checksums = _checksums_of(writer, key, len(frames))
            found[frames.start : frames.stop, column] = checksums
        for _ in frames:
            done()
    return found


def _shares(parts: Sequence[Chunks], frames: range) -> Iterator[tuple[Chunks, range]]:
    """Yield the parts that have some of these frames, with the numbers that those have there."""
    before = 0
    for part in parts:
        own = range(max(0, frames.start - before), min(len(part), frames.stop - before))
        if own:
            yield part, own
        before += len(part)


def _checksums_of(writer: StoreWriter, key: str, frames: int) -> list[int]:
    """Return what each chunk of a shard that was linked ends with."""
    length = writer.layout.shard_length
    index = read_index(writer.storage, key, length)
    found = read_checksums(writer.storage, key, index, frames)
    there = [checksum for checksum in found if checksum is not None]
    if len(there) < frames:
        raise StoreError(
            f"{writer.storage}/{key}: expected the chunks of {frames} frames, found {len(there)}; "
            f"{MEND}"
        )
    return there


def depth_counts(store: Store, workers: int, done: Callable[[], None]) -> npt.NDArray[np.int64]:
    """Return how many pixels of a store have each depth, (65536,) int64, by millimetre.

    Zeros where it has no depth. Every frame's depth is read.

    Raises
    ------
    StoreError
        One is damaged.
    """
    array = store.arrays.get("depth")

    def count(start: int) -> npt.NDArray[np.int64]:
        total = np.zeros(DEPTHS, dtype=np.int64)
        for frame in range(start, len(store), workers):
            if array is not None:
                total += np.bincount(array.read(frame).reshape(-1), minlength=DEPTHS)
            done()
        return total

    with ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool:
        counts: npt.NDArray[np.int64] = np.sum(list(pool.map(count, range(workers))), axis=0)
    return counts
