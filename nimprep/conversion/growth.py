"""A store and the frames that join it, put together: shards, tables, attributes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.conversion.doubted import with_doubts_of_all
from nimprep.conversion.plan import Plan, described, fixed_splits, of_no_split
from nimprep.conversion.provenance import joined_attributes
from nimprep.conversion.records import (
    FrameFacts,
    Records,
    depth_percentiles,
    tables,
)
from nimprep.conversion.shard_assembly import StoreChunks, UnitChunks, depth_counts, join_shards
from nimprep.conversion.workspace import LocalWorkspace
from nimprep.errors import StoreError
from nimprep.parallel import Progress, available_cores
from nimprep.readers import Reader
from nimprep.splits import SPLITS, extend_splits
from nimprep.store.checksums import MEND
from nimprep.store.depth_loss import joined_loss
from nimprep.store.extras import carry_over
from nimprep.store.reader import Store
from nimprep.store.statistics import class_pixels_of
from nimprep.store.table_specs import CHUNK_CHECKSUMS, CLASS_PIXELS, TABLES
from nimprep.store.writer import StoreWriter


def grow(
    old: Store, plan: Plan, records: Records, workspace: LocalWorkspace, start: Progress
) -> None:
    """Write the store that has an old one's frames and then the plan's, as `workspace.joined`.

    Raises
    ------
    StoreError
        An image is not the one that was stored, or it cannot be written.
    """
    frames = len(old) + len(records.facts)
    layout = replace(plan.job.layout, frames=frames, classes=old.classes)
    workspace.joined.remove("")
    writer = StoreWriter(workspace.joined, layout)
    units = UnitChunks(workspace.store, layout, records.units)
    checksums = join_shards(writer, [StoreChunks(old, layout), units], start("joining", frames))
    _check_chunks(old, records.facts, layout.modalities, checksums)
    counts = records.depth_counts
    if "depth" in old.modalities:
        done = start("reading the depth there was", len(old))
        counts = counts + depth_counts(old, plan.job.options.workers or available_cores(), done)
    new, depth = described(plan, records), layout.modality("depth")
    news = {*(f.id for f in records.facts), *(f.id for f in records.skipped)}
    skipped = [frame for frame in old.about.skipped if frame["id"] not in news]
    about = joined_attributes(
        [(replace(old.about, skipped=skipped), len(old)), (new, len(records.facts))],
        depth_percentiles_m=depth_percentiles(counts, depth) if "depth" in old.modalities else None,
        depth_lost=joined_loss((old.about.depth_lost, new.depth_lost), int(counts[1:].sum())),
    )
    joined = _tables(old, plan.reader, records.facts, checksums)
    writer.finish(joined, with_doubts_of_all(about, joined, old.classes))
    carry_over(Path(old.path), workspace.joined.root)


def _check_chunks(
    old: Store,
    facts: Sequence[FrameFacts],
    modalities: Sequence[str],
    found: npt.NDArray[np.uint32],
) -> None:
    """Raise where a chunk is not the one that the store, or the new frame's record, names."""
    there = old.tables.chunk_crc32c
    new = [[frame.chunk_crc32c[m] for m in modalities] for frame in facts]
    known = np.concatenate([found[: len(old)] if there is None else there, np.array(new, "u4")])
    for frame, column in np.argwhere(found != known):
        ids = [*old.ids, *(frame.id for frame in facts)]
        raise StoreError(
            f"{old.path}/{modalities[column]}: frame {ids[frame]!r}: expected the "
            f"image that was stored, found another version's; {MEND}"
        )


def grown_splits(old: Store, reader: Reader, groups: Mapping[str, str]) -> list[str]:
    """Return the splits of frames that join a store, by their groups.

    Raises
    ------
    SplitError
        The store's split rule does not fit them.
    """
    split = old.about.split
    everyone = dict(zip(old.ids, old.tables.group, strict=True)) | dict(groups)
    before = {i: n for n, ids in old.about.fixed_splits.items() for i in ids}
    fixed = {i: SPLITS[name] for i, name in (before | fixed_splits(reader, groups)).items()}
    known = {**old.splits, **of_no_split(reader, groups)}
    splits = extend_splits(everyone, known, split["rule"], split.get("seed", 0), fixed)
    return [splits[i] for i in groups]


def _tables(
    old: Store, reader: Reader, facts: Sequence[FrameFacts], checksums: npt.NDArray[np.uint32]
) -> dict[str, npt.NDArray[Any]]:
    splits = grown_splits(old, reader, {frame.id: frame.group for frame in facts})
    new = tables(facts, splits, old.modalities)
    joined = {
        name: np.concatenate([np.asarray(getattr(old.tables, name), new[name].dtype), new[name]])
        for name in TABLES
    }
    pixels = np.concatenate([class_pixels_of(old), new[CLASS_PIXELS]])
    return {**joined, CLASS_PIXELS: pixels, CHUNK_CHECKSUMS: checksums}
