"""What shards hold, told by the checksums that their chunks end with: records have them too.

So whether a shard is the one that a record tells of is read from the shard itself. Neither a
listing nor a note of how far a conversion had come has to be right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain

from nimprep.conversion.records import UnitRecord
from nimprep.errors import StoreError
from nimprep.parallel import map_in_order
from nimprep.store.connection import RequestError
from nimprep.store.shards import index_size, parse_index, read_checksums
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreWriter

Contents = Mapping[str, Sequence[int]]
"""By a shard's key, what its chunks end with, in order."""

_AT_ONCE = 16
"""Shards looked at at once: over a network each takes its time."""


def unit_contents(writer: StoreWriter, records: Sequence[UnitRecord]) -> dict[str, list[int]]:
    """Return what the shards of units hold as they were written, one of each modality per unit."""
    return {
        writer.shard_key(modality, record.number): [f.chunk_crc32c[modality] for f in record.frames]
        for record in records
        if record.frames
        for modality in writer.layout.modalities
    }


def packed_contents(writer: StoreWriter, records: Sequence[UnitRecord]) -> dict[str, list[int]]:
    """Return what the shards of units hold once the gaps of skipped frames are closed."""
    facts = list(chain.from_iterable(record.frames for record in records))
    length = writer.layout.shard_length
    return {
        writer.shard_key(modality, number): [
            frame.chunk_crc32c[modality] for frame in facts[start : start + length]
        ]
        for number, start in enumerate(range(0, len(facts), length))
        for modality in writer.layout.modalities
    }


def lost_units(writer: StoreWriter, records: Sequence[UnitRecord]) -> set[int]:
    """Return the numbers of the units of which a shard is gone, cut short or another one."""
    there = held(writer, unit_contents(writer, records))
    return {r.number for r in records if not unit_contents(writer, [r]).keys() <= there}


def changed_shards(writer: StoreWriter, records: Sequence[UnitRecord]) -> dict[str, int]:
    """Return the keys of the shards of units that no longer end as they were written, and whose.

    One read of each: its end holds the places and lengths of all its chunks, their checksum, and
    before it what the last chunk ends with.

    Raises
    ------
    StoreError
        The place cannot be reached.
    """
    asked = [
        (writer.shard_key(modality, record.number), record.number, checksum, last[modality])
        for record in records
        if record.frames
        for last in [record.frames[-1].chunk_crc32c]
        for modality, checksum in record.indices.items()
    ]

    def ends_so(key: str, checksum: int, last: int) -> bool:
        data = _read_end(writer.storage, key, writer.layout.shard_length)
        return data is not None and (data[:4], data[-4:]) == (
            last.to_bytes(4, "little"),
            checksum.to_bytes(4, "little"),
        )

    same = map_in_order(lambda one: ends_so(one[0], *one[2:]), asked, _AT_ONCE)
    return {key: unit for (key, unit, *_), kept in zip(asked, same, strict=True) if not kept}


def _read_end(storage: Storage, key: str, length: int) -> bytes | None:
    """Return a shard's index, with the four bytes before it; None = it has no whole one."""
    size = index_size(length)
    try:
        data, end = storage.read_tail(key, size + 4)
        parse_index(data[-size:], length, end, f"{storage}/{key}")
    except RequestError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        return None
    except StoreError:
        return None
    return data


def held(writer: StoreWriter, contents: Contents, below: str = "") -> set[str]:
    """Return the keys, of these, of the shards that hold just these chunks.

    Parameters
    ----------
    below : str
        Put before each key to find the shard.

    Raises
    ------
    StoreError
        The place cannot be reached.
    """
    length = writer.layout.shard_length

    def look(key: str) -> bool:
        return _holds(writer.storage, f"{below}{key}", length, contents[key])

    there = map_in_order(look, contents, _AT_ONCE)
    return {key for key, found in zip(contents, there, strict=True) if found}


def _holds(storage: Storage, key: str, length: int, expected: Sequence[int]) -> bool:
    try:
        data, end = storage.read_tail(key, index_size(length))
        index = parse_index(data, length, end, f"{storage}/{key}")
        found = read_checksums(storage, key, index, length)
    except RequestError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        return False
    except StoreError:
        return False
    return found == [*expected, *[None] * (length - len(expected))]
