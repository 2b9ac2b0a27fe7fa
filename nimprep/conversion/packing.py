"""Moving compressed chunks between shards, so that frames lie close without being encoded anew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from nimprep.errors import StoreError
from nimprep.store.shards import encode_shard, split_shard
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreLayout, StoreWriter

_PACKED = "packed"
"""Where packed shards wait until all are there."""

_MARKER = f"{_PACKED}/done"
"""There once they are."""


def is_packed(lengths: Sequence[int], shard_length: int) -> bool:
    """Return whether shards of these numbers of frames need no packing: all full but the last."""
    return all(n == shard_length for n in lengths[:-1]) and (not lengths or lengths[-1] > 0)


def pack_shards(storage: Storage, layout: StoreLayout, lengths: Sequence[int]) -> None:
    """Close the gaps that skipped frames left, in every array.

    Cut short at any moment, it can be called again; once it has returned and that is noted,
    `forget_packing` removes what tells how far it had come. Held in memory: three shards.

    Parameters
    ----------
    lengths : sequence of int
        Frames in each shard as it is.
    """
    writer = StoreWriter(storage, layout)
    if storage.read(_MARKER) is None:
        for modality in layout.modalities:
            keys = [writer.shard_key(modality, n) for n in range(len(lengths)) if lengths[n]]
            for number, chunks in enumerate(_regrouped(storage, keys, layout.shard_length)):
                key = f"{_PACKED}/{writer.shard_key(modality, number)}"
                storage.write(key, encode_shard(chunks, layout.shard_length))
        storage.write(_MARKER, [b""])
    for key in storage.keys(_PACKED):
        if key != _MARKER:
            storage.move(key, key.removeprefix(f"{_PACKED}/"))
    for modality in layout.modalities:
        for number in range(-(-sum(lengths) // layout.shard_length), len(lengths)):
            storage.remove(f"{modality}/c/{number}")


def forget_packing(storage: Storage) -> None:
    """Remove what `pack_shards` keeps until it is noted that it was done."""
    storage.remove(_PACKED)


def _regrouped(storage: Storage, keys: Sequence[str], length: int) -> Iterator[list[bytes]]:
    waiting: list[bytes] = []
    for key in keys:
        data = storage.read(key)
        if data is None:
            raise StoreError(f"{storage}/{key}: expected a shard, found none")
        waiting += split_shard(data, length, f"{storage}/{key}")
        while len(waiting) >= length:
            yield waiting[:length]
            del waiting[:length]
    if waiting:
        yield waiting
