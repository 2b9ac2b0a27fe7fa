"""What a store says of each frame: its tables, read and checked."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.store.attributes import StoreAttributes
from nimprep.store.checksums import MEND, chunk_checksum, in_force
from nimprep.store.metadata import ROOT, read_document
from nimprep.store.storage import Storage
from nimprep.store.table_specs import CHUNK_CHECKSUMS, CLASS_PIXELS, table_key, table_specs
from nimprep.store.tables import LARGEST_CHUNK, TableError, decode_table

_SLASHES = re.compile(r"[/\\]")


@dataclass(frozen=True)
class Tables:
    """Hold what a store says of each frame; every array has the frame first.

    `class_pixels`, (frame, class or ignored), and `chunk_crc32c`, (frame, modality), are None in a
    store of format 1.0.
    """

    frame_id: tuple[str, ...]
    split: npt.NDArray[np.uint8]
    group: tuple[str, ...]
    image_size: npt.NDArray[np.int32]
    intrinsics: npt.NDArray[np.float64]
    baseline: npt.NDArray[np.float64]
    cam_to_road: npt.NDArray[np.float64]
    gravity: npt.NDArray[np.float64]
    channel_sums: npt.NDArray[np.int64]
    class_pixels: npt.NDArray[np.uint32] | None
    chunk_crc32c: npt.NDArray[np.uint32] | None


def read_tables(
    storage: Storage,
    about: StoreAttributes,
    modalities: Sequence[str],
    copies: Mapping[str, dict[str, Any]],
) -> tuple[Tables, StoreAttributes]:
    """Read the per-frame arrays of a store.

    Parameters
    ----------
    about : StoreAttributes
        What the root says.
    modalities : sequence of str
        All that the store has, in order.
    copies : mapping of str to dict
        Metadata of arrays that has been read already.

    Returns
    -------
    Tables
    StoreAttributes
        The attributes that are in force with them.

    Raises
    ------
    StoreError
        One is missing, damaged, another version's than the root, of another dtype or of another
        length than the others.
    """
    specs = table_specs(modalities, about.format_version, about.class_ids)
    keys = {name: table_key(name) for name in specs}
    read = storage.read_many(list(keys.values()), LARGEST_CHUNK)
    chunks = {name: read[key] for name, key in keys.items()}
    about = in_force(about, chunk_checksum(chunks["split"] or b""))
    arrays: dict[str, Any] = {CLASS_PIXELS: None, CHUNK_CHECKSUMS: None}
    for name, spec in specs.items():
        where = f"{storage}/{name}"
        try:
            document = copies.get(name) or read_document(storage, f"{name}/{ROOT}")
            # A chunk that is gone would be all fill value to a Zarr library.
            if (chunk := chunks[name]) is None:
                raise StoreError(f"{where}: expected its chunk, found none; {MEND}")
            if about.tables is not None and about.tables.get(name) != chunk_checksum(chunk):
                raise StoreError(
                    f"{where}: expected the table that the root's attributes name, found another "
                    f"version's; {MEND}"
                )
            arrays[name] = decode_table(document, spec, chunk)
        except TableError as error:
            raise StoreError(f"{where}: expected a table in one chunk, found {error}") from error
    lengths = {name: len(values) for name, values in arrays.items() if values is not None}
    if len(set(lengths.values())) != 1:
        raise StoreError(f"{storage}: expected tables of one length, found {lengths}")
    for frame_id in arrays["frame_id"]:
        if not is_name(frame_id):
            raise StoreError(
                f"{storage}/frame_id: expected names that files below a folder can have, "
                f"found {frame_id!a}; convert it again from files of other names"
            )
    for name in ("frame_id", "group"):
        arrays[name] = tuple(str(text) for text in arrays[name])
    return Tables(**arrays), about


def is_name(frame_id: str) -> bool:
    """Return whether an id leads nowhere else as a file's name: others write it."""
    return frame_id.isprintable() and {"", ".", ".."}.isdisjoint(_SLASHES.split(frame_id))
