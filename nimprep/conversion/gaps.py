"""Moving compressed chunks between shards, so that frames lie close without being encoded anew.

Cut short at any moment it goes on: every shard is then either in its place or waits for it, which
the shards themselves tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set

from nimprep.conversion.records import UnitRecord
from nimprep.conversion.shard_contents import Contents, held, packed_contents
from nimprep.errors import StoreError
from nimprep.store.checksums import chunk_checksum
from nimprep.store.extras import PACKED
from nimprep.store.shards import encode_shard, split_shard
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreWriter


def is_packed(lengths: Sequence[int], shard_length: int) -> bool:
    """Return whether shards of these numbers of frames need no packing: all full but the last."""
    return all(n == shard_length for n in lengths[:-1]) and (not lengths or lengths[-1] > 0)


def packing_goes_on(writer: StoreWriter, records: Sequence[UnitRecord]) -> bool:
    """Return whether every packed shard is in its place, or waits for it.

    Raises
    ------
    StoreError
        The place cannot be reached.
    """
    contents = packed_contents(writer, records)
    return _others_wait(writer, contents, held(writer, contents))


def _others_wait(writer: StoreWriter, contents: Contents, there: Set[str]) -> bool:
    """Return whether the packed shards that are not in their place wait for it."""
    left = {key: chunks for key, chunks in contents.items() if key not in there}
    return held(writer, left, f"{PACKED}/") == left.keys()


def pack_shards(writer: StoreWriter, records: Sequence[UnitRecord]) -> None:
    """Close the gaps that skipped frames left, in every array; held in memory: three shards.

    Parameters
    ----------
    records : sequence of UnitRecord
        Of every unit, in order.

    Raises
    ------
    StoreError
        A shard is not the one that its unit's record tells of, or it cannot be written.
    """
    storage, contents = writer.storage, packed_contents(writer, records)
    there = held(writer, contents)
    if not _others_wait(writer, contents, there):
        for modality in writer.layout.modalities:
            for number, chunks in enumerate(_regrouped(writer, modality, records)):
                key = writer.shard_key(modality, number)
                if key not in there:
                    parts = encode_shard(chunks, writer.layout.shard_length)
                    storage.write(f"{PACKED}/{key}", parts)
    # By their names: of shards that a listing left out the old ones would stay.
    for key in sorted(contents.keys() - there):
        storage.move(f"{PACKED}/{key}", key)
    frames = sum(len(record.frames) for record in records)
    for modality in writer.layout.modalities:
        for number in range(-(-frames // writer.layout.shard_length), len(records)):
            # With its folders where it has some, and where not, by its name.
            storage.remove(f"{modality}/c/{number}")
            storage.remove(writer.shard_key(modality, number))
    if lost := contents.keys() - held(writer, contents):
        raise StoreError(foreign(storage, min(lost)))
    forget_packing(storage)


def forget_packing(storage: Storage) -> None:
    """Remove what waits for its place."""
    storage.remove(PACKED)


def _regrouped(
    writer: StoreWriter, modality: str, records: Sequence[UnitRecord]
) -> Iterator[list[bytes]]:
    storage, length = writer.storage, writer.layout.shard_length
    waiting: list[bytes] = []
    for record in records:
        if not record.frames:
            continue
        key = writer.shard_key(modality, record.number)
        data = storage.read(key)
        chunks = [] if data is None else split_shard(data, length, f"{storage}/{key}")
        expected = [frame.chunk_crc32c[modality] for frame in record.frames]
        if [chunk_checksum(chunk) for chunk in chunks] != expected:
            raise StoreError(foreign(storage, key))
        waiting += chunks
        while len(waiting) >= length:
            yield waiting[:length]
            del waiting[:length]
    if waiting:
        yield waiting


def foreign(storage: Storage, key: str) -> str:
    """Return what to say of a shard that is not the one that was written."""
    return (
        f"{storage}/{key}: expected a shard of the frames that were encoded, found another or "
        "none; the same command makes it again"
    )
