"""Make a store's checksums fit what was put into it, as whoever put it there on purpose would."""

from __future__ import annotations

import json
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
from numcodecs import zstd

from nimprep.modality import MODALITIES
from nimprep.store.checksums import attributes_digest, chunk_checksum
from nimprep.store.table_specs import table_key, table_specs


def renew_checksums(store: Path, *, chunks: bool = True) -> None:
    """Let the root and the table of chunks say what the store's files are; damage stays damage.

    Parameters
    ----------
    chunks : bool
        The images' checksums too, not only the tables' and the attributes'.
    """
    # What is damaged beyond reading is for the reader to find.
    with suppress(OSError, ValueError, KeyError, TypeError, IndexError, AttributeError):
        root = json.loads((store / "zarr.json").read_bytes())
        attributes = root["attributes"]["nimprep"]
        if attributes["format_version"] == "1.0":
            return
        if chunks:
            with suppress(OSError, ValueError, KeyError, TypeError, IndexError, struct.error):
                _renew_chunks(store, [m for m in MODALITIES if m in attributes["modalities"]])
        for name in table_specs():
            if (store / table_key(name)).is_file():
                attributes["tables"][name] = chunk_checksum((store / table_key(name)).read_bytes())
        attributes["digest"] = attributes_digest(attributes)
        (store / "zarr.json").write_text(json.dumps(root))


def _renew_chunks(store: Path, modalities: list[str]) -> None:
    document = json.loads((store / "chunk_crc32c" / "zarr.json").read_bytes())
    path = store / table_key("chunk_crc32c")
    checksums = np.frombuffer(zstd.decompress(path.read_bytes()[:-4]), "<u4").copy()
    checksums = checksums.reshape(document["shape"])
    for column, name in enumerate(modalities):
        length = json.loads((store / name / "zarr.json").read_bytes())
        capacity = length["chunk_grid"]["configuration"]["chunk_shape"][0]
        for frame in range(len(checksums)):
            found = _checksum(store / name, *divmod(frame, capacity), capacity)
            if found is not None:
                checksums[frame, column] = found
    chunk = zstd.compress(checksums.tobytes(), 3)
    path.write_bytes(chunk + struct.pack("<I", google_crc32c.value(chunk)))


def _checksum(array: Path, shard: int, place: int, capacity: int) -> int | None:
    """Return what a frame's chunk ends with; None where that cannot be told."""
    with suppress(OSError, ValueError, IndexError):
        data = next(p for p in sorted((array / "c" / str(shard)).rglob("*")) if p.is_file())
        whole = data.read_bytes()
        index = np.frombuffer(whole[-16 * capacity - 4 : -4], "<u8").reshape(capacity, 2)
        offset, length = (int(n) for n in index[place])
        end = whole[offset + length - 4 : offset + length]
        return int.from_bytes(end, "little") if len(end) == 4 else None
    return None


def edit_attributes(store: Path, **changes: Any) -> None:
    """Change what a store's attributes say, and their digest with it."""
    root = json.loads((store / "zarr.json").read_text())
    root["attributes"]["nimprep"] |= changes
    (store / "zarr.json").write_text(json.dumps(root))
    renew_checksums(store, chunks=False)
