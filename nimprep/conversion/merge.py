"""Joining stores into one: their compressed images move over as they are wherever they can."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.conversion.compatibility import (
    check_alike,
    depth_unit,
    normal_dtype,
    padded_size,
    shard_length,
)
from nimprep.conversion.doubted import with_doubts_of_all
from nimprep.conversion.plan import warn_of_padding
from nimprep.conversion.provenance import joined_attributes, with_prefix
from nimprep.conversion.records import depth_percentiles
from nimprep.conversion.shard_assembly import StoreChunks, depth_counts, join_shards
from nimprep.conversion.workspace import (
    check_apart,
    check_unchanged,
    local_folder,
    open_workspace,
    root_digest,
)
from nimprep.errors import SplitError, StoreError
from nimprep.parallel import Progress, available_cores, no_progress
from nimprep.store.attributes import Split, StoreAttributes
from nimprep.store.depth_loss import joined_loss
from nimprep.store.frame_tables import is_name
from nimprep.store.reader import Store, open_store
from nimprep.store.spec import PRESETS
from nimprep.store.statistics import class_pixels_of
from nimprep.store.table_specs import CHUNK_CHECKSUMS, CLASS_PIXELS, TABLES
from nimprep.store.writer import StoreLayout, StoreWriter


def merge_stores(
    stores: Sequence[Path | str],
    target: Path | str,
    *,
    prefixes: Sequence[str] | None = None,
    workers: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Store:
    """Join stores of one kind into a new one; frames keep their order and their split.

    They must agree in modalities and how each was made, classes and crop. Codec and shard length
    are the first one's, the padded size the largest. Compressed images are copied as they are;
    those of another codec or a smaller padded size are compressed anew, without loss. Held in
    memory: one shard, and one image per worker. Cut short, nothing is left at the target, and the
    next call begins anew.

    Parameters
    ----------
    stores : sequence of path
        Folders on this machine; nothing in them is written to.
    target : path
        The new store's folder. It gets its name when it is complete.
    prefixes : sequence of str, optional
        As many as stores: put before each one's frame ids and scenes, such as "day/".
    workers : int, optional
        Threads; None = the cores this process may use. The bytes do not depend on it.
    overwrite : bool
        Replace a complete store at the target.
    progress : callable, optional
        As for `convert`.

    Returns
    -------
    Store
        The new store, open.

    Raises
    ------
    StoreError
        A store is missing, damaged, or of another kind than the first; two have a frame of one id;
        or the target cannot be written.
    SplitError
        All were split by scene, and two put one scene into different splits.
    """
    target = local_folder(target, "merge into")
    folders = [local_folder(store, "merge") for store in stores]
    if not folders:
        raise StoreError(f"{target}: expected stores to merge, found none; name two or more")
    for folder in folders:
        check_apart(folder, target)
    found = [root_digest(folder) for folder in folders]
    opened = [open_store(folder) for folder in folders]
    check_alike(opened)
    merge = _plan(opened, prefixes or [""] * len(opened))
    start = progress or no_progress
    with open_workspace(target, overwrite=overwrite, task="merge") as workspace:
        workspace.clear()
        writer = StoreWriter(workspace.store, _layout(opened))
        _write(merge, writer, workers or available_cores(), start)
        for folder, digest in zip(folders, found, strict=True):
            check_unchanged(folder, digest)
        workspace.publish()
    return open_store(target)


@dataclass(frozen=True)
class _Merge:
    """What several stores come to together: ids and groups with their store's prefix."""

    stores: Sequence[Store]
    prefixes: Sequence[str]
    ids: list[str]
    groups: list[str]
    split: Split


def _plan(stores: Sequence[Store], prefixes: Sequence[str]) -> _Merge:
    """Plan a merge; raise where two frames have one id, or a scene would straddle splits."""
    if len(prefixes) != len(stores):
        raise StoreError(
            f"--prefix: expected one for each of {len(stores)} stores, found {len(prefixes)}; "
            "give as many"
        )
    ids, groups = (_prefixed(stores, prefixes, table) for table in ("frame_id", "group"))
    # Nobody could open the store.
    if bad := next((i for i in ids if not is_name(i)), None):
        raise StoreError(
            "--prefix: expected one that makes names that files below a folder can have, found "
            f"{bad!a}; give another"
        )
    twice = [i for i, n in Counter(ids).items() if n > 1]
    if twice:
        raise StoreError(
            f"{stores[-1].path}: expected frames that no other store has, found "
            f"{twice[0]!r} twice ({len(twice)} ids are); --prefix tells them apart"
        )
    found = [store.about.split for store in stores]
    # Where their rules differ, none made these splits.
    split: Split = found[0] if all(one == found[0] for one in found) else {"rule": "file"}
    if split["rule"] == "group":
        _check_scenes(groups, chain.from_iterable(store.splits.values() for store in stores))
    return _Merge(stores, prefixes, ids, groups, split)


def _prefixed(stores: Sequence[Store], prefixes: Sequence[str], table: str) -> list[str]:
    """Return every frame's text of a table; frames without a scene stay without."""
    return [
        f"{prefix}{text}" if text else ""
        for store, prefix in zip(stores, prefixes, strict=True)
        for text in getattr(store.tables, table)
    ]


def _check_scenes(groups: Iterable[str], splits: Iterable[str]) -> None:
    seen: dict[str, str] = {}
    for group, split in zip(groups, splits, strict=True):
        if seen.setdefault(group, split) != split:
            raise SplitError(
                f"scene {group!r}: expected it in one split, found it in {seen[group]!r} and "
                f"{split!r}; split one of the stores anew, or tell scenes apart by --prefix"
            )


def _layout(stores: Sequence[Store]) -> StoreLayout:
    """Return the new store's shape."""
    first = stores[0]
    codec = first.about.codec
    if codec not in PRESETS:
        raise StoreError(
            f"{first.path}: expected a codec of {', '.join(PRESETS)}, found {codec!r}; name "
            "another store first"
        )
    sizes = [padded_size(store) for store in stores]
    shapes: dict[tuple[int, int], list[str]] = {}
    for store in stores:
        for size, frame_id in zip(store.tables.image_size.tolist(), store.ids, strict=True):
            shapes.setdefault((size[0], size[1]), []).append(frame_id)
    warn_of_padding(shapes, first.path)
    return StoreLayout(
        frames=sum(map(len, stores)),
        height=max(height for height, _ in sizes),
        width=max(width for _, width in sizes),
        modalities=first.modalities,
        classes=first.classes,
        normal_dtype=normal_dtype(first),
        codec=codec,
        shard_length=shard_length(first),
        planes=first.planes,
        depth_unit=depth_unit(first),
    )


def _write(merge: _Merge, writer: StoreWriter, workers: int, start: Progress) -> None:
    frames = writer.layout.frames
    with ThreadPoolExecutor(workers, thread_name_prefix="nimprep") as pool:
        chunks = [StoreChunks(store, writer.layout, pool) for store in merge.stores]
        checksums = join_shards(writer, chunks, start("merging", frames))
    percentiles, known = None, 0
    if "depth" in writer.layout.modalities:
        done = start("reading depth", frames)
        counts = np.asarray(sum(depth_counts(store, workers, done) for store in merge.stores))
        percentiles = depth_percentiles(counts, writer.layout.modality("depth"))
        known = int(counts[1:].sum())
    pixels = np.concatenate([class_pixels_of(store) for store in merge.stores])
    tables = {**_tables(merge), CLASS_PIXELS: pixels, CHUNK_CHECKSUMS: checksums}
    lost = joined_loss((store.about.depth_lost for store in merge.stores), known)
    about = replace(_attributes(merge, percentiles), depth_lost=lost)
    writer.finish(tables, with_doubts_of_all(about, tables, writer.layout.classes))


def _tables(merge: _Merge) -> dict[str, npt.NDArray[Any]]:
    ours = {"frame_id": merge.ids, "group": merge.groups}
    return {
        name: np.array(ours[name], dtype="T")
        if name in ours
        else np.concatenate([getattr(store.tables, name) for store in merge.stores])
        for name in TABLES
    }


def _attributes(merge: _Merge, percentiles: dict[str, float] | None) -> StoreAttributes:
    """Return what is said of the new store."""
    known, found = set(merge.ids), []
    for store, prefix in zip(merge.stores, merge.prefixes, strict=True):
        about = store.about
        fixed = {k: [prefix + i for i in ids] for k, ids in about.fixed_splits.items()}
        skipped = [{**frame, "id": prefix + frame["id"]} for frame in about.skipped]
        left_out = [frame for frame in skipped if frame["id"] not in known]
        doubts, findings = (
            [{**d, "frames": [prefix + i for i in d["frames"]]} for d in each]
            for each in (about.doubts, about.findings)
        )
        part = replace(
            about,
            fixed_splits=fixed,
            skipped=left_out,
            doubts=doubts,
            findings=findings,
            normals_chosen=with_prefix(about.normals_chosen, prefix),
        )
        found.append((part, len(store)))
    joined = joined_attributes(found, split=merge.split, depth_percentiles_m=percentiles)
    names = dict.fromkeys(part["dataset"] for part in joined.source["parts"])
    return replace(joined, dataset="+".join(names))
