"""Change who is train, val and test in a store, without touching an image."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from nimprep.errors import StoreError
from nimprep.readers.given_splits import given_splits
from nimprep.splits import SPLIT_CODES, SplitName, SplitRule, assign_splits, check_scenes
from nimprep.store.attributes import PastSplit, Split, StoreAttributes
from nimprep.store.checksums import chunk_checksum
from nimprep.store.location import Place
from nimprep.store.lock import changing
from nimprep.store.memory import encode_table
from nimprep.store.metadata import ROOT, write_attributes
from nimprep.store.reader import Store, open_store
from nimprep.store.spec import check_changeable
from nimprep.store.storage import Storage
from nimprep.store.table_specs import table_key


def resplit(
    path: Place | Storage,
    *,
    split_file: Path | str | None = None,
    rule: SplitRule | None = None,
    seed: int = 0,
) -> dict[str, str]:
    """Split a store's frames anew, by a file or by a rule.

    Parameters
    ----------
    split_file : path, optional
        In place of a rule: a split file, or lists such as train.txt, by ids, as `convert` takes it.
    rule : {"frame", "group", "stratified", "eighth"}, optional
        None = the rule the store was split by last, or by frame where that was a file.
    seed : int

    Frames whose split the dataset's authors chose keep it under every rule; a file may move them.

    Returns
    -------
    dict of frame id to split

    Raises
    ------
    SplitError
        The file or the rule does not fit the frames; the store is as it was.
    StoreError
        There is no store, somebody else changes it, or it cannot be written.
    """
    with changing(path) as storage:
        return _resplit(open_store(storage), split_file, rule, seed)


def _resplit(
    store: Store, split_file: Path | str | None, rule: SplitRule | None, seed: int
) -> dict[str, str]:
    about = store.about
    check_changeable(about.format_version, str(store.path))
    if split_file is not None:
        splits = given_splits(split_file, {i: (i,) for i in store.ids})
        described: Split = {"rule": "file"}
    else:
        fixed: dict[str, SplitName] = {
            frame_id: split for split, ids in about.fixed_splits.items() for frame_id in ids
        }
        if rule is None:
            last = about.split["rule"]
            rule = "frame" if last == "file" else last
        groups = dict(zip(store.ids, store.tables.group, strict=True))
        check_scenes(about.dataset, rule, groups.values())
        splits = dict(assign_splits(groups, rule, seed, fixed))
        described = {"rule": rule, "seed": seed}
    _write(store.storage, replace(about, split=described), about.split, splits)
    return splits


def _write(
    storage: Storage,
    changed: StoreAttributes,
    past: Split,
    splits: Mapping[str, str],
) -> None:
    """Change table and rule in one step, whatever happens: see `nimprep.store.checksums`."""
    codes = np.array([SPLIT_CODES[name] for name in splits.values()], dtype=np.uint8)
    chunk = encode_table("split", storage.read(f"split/{ROOT}") or b"", codes)
    before, after = (chunk_checksum(c) for c in (storage.read(table_key("split")) or b"", chunk))
    if changed.tables is not None:
        changed = replace(changed, tables={**changed.tables, "split": after})
    if before == after:
        write_attributes(storage, changed.to_json())
        return
    reminder: PastSplit = {**past, "crc32c": before}
    write_attributes(storage, replace(changed, split_before=reminder).to_json())
    storage.write(table_key("split"), [chunk])
    # The split is changed by now, with the reminder or without.
    with suppress(StoreError):
        write_attributes(storage, changed.to_json())
