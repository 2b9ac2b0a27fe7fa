"""Joining stores into one: their compressed images move over as they are wherever they can."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate, chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep import __version__
from nimprep.conversion.compatibility import check_alike, normal_dtype, padded_size, shard_length
from nimprep.conversion.plan import warn_of_padding
from nimprep.conversion.provenance import (
    joined_fixed,
    joined_metadata,
    joined_source,
    least_certain,
    parts,
)
from nimprep.conversion.records import depth_percentiles
from nimprep.conversion.shard_assembly import Chunks, StoreChunks, depth_counts, join_shards
from nimprep.conversion.workspace import (
    check_apart,
    check_unchanged,
    local_folder,
    open_workspace,
    root_digest,
)
from nimprep.errors import SplitError, StoreError
from nimprep.parallel import Progress, available_cores, no_progress
from nimprep.store.reader import Store, open_store
from nimprep.store.spec import PRESETS
from nimprep.store.table_specs import CHUNK_CHECKSUMS, TABLES
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
        raise StoreError(f"{target}: expected stores to merge, found none")
    for folder in folders:
        check_apart(folder, target)
    found = [root_digest(folder) for folder in folders]
    opened = [open_store(folder) for folder in folders]
    check_alike(opened)
    merge = _Merge(opened, prefixes or [""] * len(opened), workers or available_cores())
    merge.check()
    start = progress or no_progress
    with open_workspace(target, overwrite=overwrite, task="merge") as workspace:
        workspace.clear()
        writer = StoreWriter(workspace.store, merge.layout())
        merge.write(writer, start)
        for folder, digest in zip(folders, found, strict=True):
            check_unchanged(folder, digest)
        workspace.publish()
    return open_store(target)


class _Merge:
    """What several stores come to together."""

    def __init__(self, stores: Sequence[Store], prefixes: Sequence[str], workers: int) -> None:
        if len(prefixes) != len(stores):
            raise StoreError(
                f"--prefix: expected one for each of {len(stores)} stores, found {len(prefixes)}"
            )
        self._stores = stores
        self._prefixes = prefixes
        self._workers = workers
        self._frames = sum(len(store) for store in stores)
        self._ids = self._prefixed("frame_id")
        self._groups = self._prefixed("group")

    def _prefixed(self, table: str) -> list[str]:
        """Return every frame's text of a table; frames without a scene stay without."""
        return [
            f"{prefix}{text}" if text else ""
            for store, prefix in zip(self._stores, self._prefixes, strict=True)
            for text in getattr(store.tables, table)
        ]

    def check(self) -> None:
        """Raise where two frames have one id, or a scene would straddle splits."""
        twice = [i for i, n in Counter(self._ids).items() if n > 1]
        if twice:
            raise StoreError(
                f"{self._stores[-1].path}: expected frames that no other store has, found "
                f"{twice[0]!r} twice ({len(twice)} ids are); --prefix tells them apart"
            )
        if self._split()["rule"] != "group":
            return
        splits = chain.from_iterable(store.splits.values() for store in self._stores)
        seen: dict[str, str] = {}
        for group, split in zip(self._groups, splits, strict=True):
            if seen.setdefault(group, split) != split:
                raise SplitError(
                    f"scene {group!r}: expected it in one split, found it in {seen[group]!r} and "
                    f"{split!r}; split one of the stores anew, or tell scenes apart by --prefix"
                )

    def layout(self) -> StoreLayout:
        """Return the new store's shape."""
        first = self._stores[0]
        codec = first.attributes["codec"]
        if codec not in PRESETS:
            raise StoreError(
                f"{first.path}: expected a codec of {', '.join(PRESETS)}, found {codec!r}"
            )
        sizes = [padded_size(store) for store in self._stores]
        shapes: dict[tuple[int, int], list[str]] = {}
        for store in self._stores:
            for size, frame_id in zip(store.tables.image_size.tolist(), store.ids, strict=True):
                shapes.setdefault((size[0], size[1]), []).append(frame_id)
        warn_of_padding(shapes, self._stores[0].path)
        return StoreLayout(
            frames=self._frames,
            height=max(height for height, _ in sizes),
            width=max(width for _, width in sizes),
            modalities=first.modalities,
            classes=first.classes,
            normal_dtype=normal_dtype(first),
            codec=codec,
            shard_length=shard_length(first),
        )

    def write(self, writer: StoreWriter, start: Progress) -> None:
        """Write everything."""
        with ThreadPoolExecutor(self._workers, thread_name_prefix="nimprep") as pool:
            chunks = self._chunks(writer.layout, pool)
            checksums = join_shards(writer, chunks, start("merging", self._frames))
        percentiles = None
        if "depth" in writer.layout.modalities:
            done = start("reading depth", self._frames)
            counts = sum(depth_counts(store, self._workers, done) for store in self._stores)
            percentiles = depth_percentiles(np.asarray(counts))
        tables = {**self._tables(), CHUNK_CHECKSUMS: checksums}
        writer.finish(tables, self._attributes(percentiles))

    def _chunks(self, layout: StoreLayout, pool: ThreadPoolExecutor) -> Chunks:
        sources = [StoreChunks(store, layout) for store in self._stores]
        starts = [0, *accumulate(len(store) for store in self._stores)]

        def chunks(modality: str, frames: range) -> list[bytes]:
            def one(index: int) -> bytes:
                number = int(np.searchsorted(starts, index, side="right")) - 1
                return sources[number].chunk(modality, index - starts[number])

            return list(pool.map(one, frames))

        return chunks

    def _tables(self) -> dict[str, npt.NDArray[Any]]:
        found = {
            name: np.concatenate([getattr(store.tables, name) for store in self._stores])
            for name in TABLES
            if name not in ("frame_id", "group")
        }
        return {
            **found,
            "frame_id": np.array(self._ids, dtype="T"),
            "group": np.array(self._groups, dtype="T"),
        }

    def _split(self) -> dict[str, Any]:
        """Return the rule that all were split by; where they differ, none made these splits."""
        found: list[dict[str, Any]] = [store.attributes["split"] for store in self._stores]
        return found[0] if all(split == found[0] for split in found) else {"rule": "file"}

    def _attributes(self, percentiles: Mapping[str, float] | None) -> dict[str, Any]:
        """Return the new store's `nimprep` object."""
        first = self._stores[0].attributes
        known = set(self._ids)
        both = list(zip(self._stores, self._prefixes, strict=True))
        made = list(chain.from_iterable(parts(s.attributes, len(s)) for s in self._stores))
        fixed = joined_fixed(
            [
                {k: [prefix + i for i in ids] for k, ids in split.items()}
                for store, prefix in both
                if (split := store.attributes.get("fixed_splits", {}))
            ]
        )
        skipped = [
            {**frame, "id": prefix + frame["id"]}
            for store, prefix in both
            for frame in store.attributes.get("skipped", [])
            if prefix + frame["id"] not in known
        ]
        metadata = joined_metadata(
            [(s.attributes.get("frame_metadata", {}), len(s)) for s in self._stores]
        )
        extra = {"fixed_splits": fixed, "frame_metadata": metadata, "skipped": skipped}
        names = dict.fromkeys(part["dataset"] for part in made)
        return {
            **{name: value for name, value in first.items() if name not in ("complete", *extra)},
            "tool_version": __version__,
            "dataset": "+".join(names),
            "calibration": {**first["calibration"], "origin": least_certain(made)},
            "split": self._split(),
            **{name: value for name, value in extra.items() if value},
            "depth_percentiles_m": percentiles,
            "source": joined_source(made),
        }
