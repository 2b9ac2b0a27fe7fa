"""Adding frames to a store: encoded as its own are, then put together with its shards."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep import __version__
from nimprep.conversion.compatibility import check_frames, options_like, padded_size
from nimprep.conversion.journal import kept_journal
from nimprep.conversion.plan import Base, fixed_splits, frame_metadata
from nimprep.conversion.provenance import (
    joined_fixed,
    joined_metadata,
    joined_source,
    least_certain,
    parts,
)
from nimprep.conversion.records import (
    SkippedFrame,
    depth_percentiles,
    source_digest,
    tables,
)
from nimprep.conversion.run import encode, make_plan
from nimprep.conversion.shard_assembly import StoreChunks, UnitChunks, depth_counts, join_shards
from nimprep.conversion.sources import frame_states, listed_state
from nimprep.conversion.workspace import (
    LocalWorkspace,
    check_apart,
    check_unchanged,
    local_folder,
    open_workspace,
    root_digest,
)
from nimprep.errors import StoreError
from nimprep.parallel import Progress, available_cores, no_progress
from nimprep.readers import open_reader
from nimprep.readers.subset import SubsetReader
from nimprep.splits import SPLITS, extend_splits
from nimprep.store.checksums import MEND
from nimprep.store.extras import carry_over, check_growable
from nimprep.store.metadata import read_attributes
from nimprep.store.reader import Store, open_store
from nimprep.store.table_specs import CHUNK_CHECKSUMS, TABLES
from nimprep.store.writer import StoreLayout, StoreWriter


@dataclass(frozen=True)
class AppendOptions:
    """Say how frames are read that join a store; what is made of them, the store says.

    Attributes
    ----------
    reader, description, camera, depth_scale, target, depth_from, sparse
        As in `ConvertOptions`; to be given again as they were for the store.
    skip_existing : bool
        Leave frames out whose ids the store has already; else they are an error.
    workers : int, optional
        Threads; None = the cores this process may use. The bytes do not depend on it.
    restart : bool
        Begin anew where an earlier append to the store was cut short; else go on there.
    on_error : {"stop", "skip"}
        What a bad frame does: end it all, or be left out and listed in the metadata.
    """

    reader: str = "auto"
    description: Path | str | None = None
    camera: Path | str | tuple[float, float, float, float] | None = None
    depth_scale: float | None = None
    target: Literal["road", "lane"] = "road"
    depth_from: Literal["auto", "lidar", "stereo"] = "auto"
    sparse: bool = False
    skip_existing: bool = False
    workers: int | None = None
    restart: bool = False
    on_error: Literal["stop", "skip"] = "stop"


@dataclass(frozen=True)
class Appended:
    """Say what came of an append.

    Attributes
    ----------
    store : Store
        With the new frames, open.
    ids : tuple of str
        The frames that were added.
    existing : int
        Frames of the source that the store had already.
    skipped : tuple of SkippedFrame
        Frames that were bad and left out.
    """

    store: Store
    ids: tuple[str, ...]
    existing: int
    skipped: tuple[SkippedFrame, ...]


def append_frames(
    source: Path | str,
    store: Path | str,
    options: AppendOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> Appended:
    """Add a raw dataset's frames to a store of the same kind.

    Modalities, recipe, codec and crop are the store's. Its frames keep their split; new ones get
    theirs by `nimprep.splits.extend_splits`. Complete shards stay the files they are. The new
    store is made in a hidden folder beside the old one and takes its place when it is whole: at
    every moment the one or the other is there. Cut short, the same call goes on.

    Parameters
    ----------
    source : path
        The dataset's folder; nothing in it is written to.
    store : path
        A store's folder on this machine.
    options : AppendOptions, optional
    progress : callable, optional
        As for `convert`.
    **changes
        Fields of `AppendOptions`, over those of `options`.

    Raises
    ------
    LayoutError, DecodeError, CameraError
        The dataset is not what it should be, or its frames are not of the store's kind.
    SplitError
        The store's split rule does not fit the new frames.
    StoreError
        There is no complete store, it has frames of these ids, or it cannot be written.
    """
    options = replace(options or AppendOptions(), **changes)
    source, target = Path(source), _folder(store)
    check_apart(source, target)
    start = progress or no_progress
    with open_workspace(target, overwrite=True, task="append") as workspace:
        opened = root_digest(target)
        append = _Append(source, open_store(target), options, workspace, opened)
        done = (append.finished() if workspace.published else None) or append.run(start)
    for note in append.reader.info.notes:
        warnings.warn(f"{source}: {note}", stacklevel=2)
    return done


def _folder(store: Path | str) -> Path:
    """Return the folder of a store that is there, or that a kill left nameless for the moment."""
    path = local_folder(store, "append to")
    # What is replaced is the store, and not a link to it.
    path = path.resolve() if path.is_symlink() else path
    if path.exists() or not LocalWorkspace(path, overwrite=True).folder.is_dir():
        read_attributes(path)
    return path


class _Append:
    """One append, from its checks to the store in its place."""

    def __init__(
        self,
        source: Path,
        store: Store,
        options: AppendOptions,
        workspace: LocalWorkspace,
        opened: str,
    ) -> None:
        self._source = source
        self._store = store
        self._options = options
        self._workspace = workspace
        self._opened = opened
        reading = asdict(options)
        del reading["skip_existing"]
        self._convert = options_like(store, **reading)
        self._workers = options.workers or available_cores()
        self.reader = open_reader(source, self._convert.reader, self._convert.reading)
        self._existing = frozenset(store.ids) & frozenset(self.reader.ids)
        self._ids: tuple[str, ...] = ()
        self._skipped: list[SkippedFrame] = []

    def finished(self) -> Appended | None:
        """Return what an append of this very source did that was killed at its last step."""
        kept = kept_journal(self._workspace.journal, self._workspace.where)
        ours = {} if kept is None else kept.plan["files"]
        here = SubsetReader(self.reader, [i for i in self.reader.ids if i in ours])
        states = frame_states(here, skip_bad=self._options.on_error == "skip")
        known = self._existing | ours.keys()
        if (
            not ours
            or {i: listed_state(state) for i, state in states.items()} != ours
            or not known.issuperset(self.reader.ids)
            or not (self._options.skip_existing or set(self.reader.ids) == set(ours))
        ):
            self._workspace.clear()
            return None
        # The store that has its name says what came of them, and not what is left of a journal.
        there = frozenset(self._store.ids)
        self._ids = tuple(i for i in ours if i in there)
        left_out = self._store.attributes.get("skipped", [])
        self._skipped = [SkippedFrame(**frame) for frame in left_out if frame["id"] in ours]
        self._existing -= frozenset(self._ids)
        self._workspace.clear()
        return self._appended(self._store)

    def run(self, start: Progress) -> Appended:
        """Check, encode, join, and put the new store in the old one's place."""
        new = [i for i in self.reader.ids if i not in self._existing]
        self._check(new)
        if not new:
            return self._appended(self._store)
        path, digest = Path(self._store.path), self._store.attributes["source"]["digest"]
        base = Base(len(self._store), *padded_size(self._store), digest)
        reader = SubsetReader(self.reader, new)
        plan = make_plan(self._source, reader, self._convert, self._workspace, start, base)
        records = encode(plan, start)
        self._facts, self._skipped = records.facts, records.skipped
        self._ids = tuple(facts.id for facts in self._facts)
        if not self._facts:
            self._workspace.clear()
            return self._appended(self._store)
        frames = len(self._store) + len(self._facts)
        layout = replace(plan.job.layout, frames=frames, classes=self._store.classes)
        self._workspace.joined.remove("")
        units = UnitChunks(self._workspace.store, layout, records.units)
        checksums = self._join(layout, units, start("joining", frames))
        counts = records.depth_counts
        if "depth" in self._store.modalities:
            before = start("reading the depth there was", len(self._store))
            counts = counts + depth_counts(self._store, self._workers, before)
        writer = StoreWriter(self._workspace.joined, layout)
        writer.finish(self._tables(checksums), self._attributes(depth_percentiles(counts)))
        carry_over(path, self._workspace.joined.root)
        check_unchanged(path, self._opened)
        self._workspace.publish(self._workspace.joined)
        return self._appended(open_store(path))

    def _check(self, new: Sequence[str]) -> None:
        """Raise where these frames cannot join the store."""
        if self._existing and not self._options.skip_existing:
            raise StoreError(
                f"{self._store.path}: expected frames that are not in it yet, found "
                f"{min(self._existing)!r} ({len(self._existing)} of {len(self.reader.ids)} are); "
                "--skip-existing leaves those as they are"
            )
        check_growable(Path(self._store.path))
        check_frames(self._store, self.reader, new)
        self._splits(new, {i: self.reader.group(i) for i in new})

    def _join(
        self, layout: StoreLayout, units: UnitChunks, done: Callable[[], None]
    ) -> npt.NDArray[np.uint32]:
        """Put old and new chunks together and return what they end with, per frame and modality."""
        old, writer = StoreChunks(self._store, layout), StoreWriter(self._workspace.joined, layout)
        count = len(self._store)

        def chunks(modality: str, frames: range) -> list[bytes]:
            new = range(max(0, frames.start - count), max(0, frames.stop - count))
            kept = [old.chunk(modality, i) for i in range(frames.start, min(frames.stop, count))]
            return kept + units.chunks(modality, new)

        def whole(modality: str, frames: range) -> Path | None:
            if frames.stop <= count:
                return old.whole(modality, frames.start // layout.shard_length)
            if frames.start < count:
                return None
            return units.whole(modality, range(frames.start - count, frames.stop - count))

        found = join_shards(writer, chunks, done, whole)
        self._check_chunks(layout.modalities, found)
        return found

    def _check_chunks(self, modalities: Sequence[str], found: npt.NDArray[np.uint32]) -> None:
        """Raise where a chunk is not the one that the store, or the new frame's record, names."""
        old = self._store.tables.chunk_crc32c
        new = [[facts.chunk_crc32c[m] for m in modalities] for facts in self._facts]
        count = len(self._store)
        known = np.concatenate([found[:count] if old is None else old, np.array(new, np.uint32)])
        for frame, column in np.argwhere(found != known):
            ids = [*self._store.ids, *(facts.id for facts in self._facts)]
            raise StoreError(
                f"{self._store.path}/{modalities[column]}: frame {ids[frame]!r}: expected the "
                f"image that was stored, found another version's; {MEND}"
            )

    def _fixed(self, new: Sequence[str]) -> dict[str, list[str]]:
        """Return the frames whose split the dataset's authors chose, old and new."""
        ours: dict[str, list[str]] = {}
        for frame_id, split in fixed_splits(self.reader, new).items():
            ours.setdefault(split, []).append(frame_id)
        return joined_fixed([self._store.attributes.get("fixed_splits", {}), ours])

    def _splits(self, new: Sequence[str], groups: Mapping[str, str]) -> list[str]:
        """Return the new frames' splits."""
        store, split = self._store, self._store.attributes["split"]
        everyone = dict(zip(store.ids, store.tables.group, strict=True)) | dict(groups)
        fixed = {i: SPLITS[name] for name, ids in self._fixed(new).items() for i in ids}
        splits = extend_splits(everyone, store.splits, split["rule"], split.get("seed", 0), fixed)
        return [splits[i] for i in new]

    def _tables(self, checksums: npt.NDArray[np.uint32]) -> dict[str, npt.NDArray[Any]]:
        groups = {facts.id: facts.group for facts in self._facts}
        new = tables(self._facts, self._splits(list(groups), groups), self._store.modalities)
        old = {name: getattr(self._store.tables, name) for name in TABLES}
        joined = {
            name: np.concatenate([np.asarray(old[name], dtype=new[name].dtype), new[name]])
            for name in TABLES
        }
        return {**joined, CHUNK_CHECKSUMS: checksums}

    def _attributes(self, percentiles: Mapping[str, float] | None) -> dict[str, Any]:
        """Return the new store's `nimprep` object."""
        old, ids = self._store.attributes, [facts.id for facts in self._facts]
        part = {
            "frames": len(ids),
            "dataset": old["dataset"],
            "calibration": self.reader.info.calibration,
            "tool_version": __version__,
            "digest": source_digest(self._facts),
        }
        made = [*parts(old, len(self._store)), part]
        metadata = joined_metadata(
            [
                (old.get("frame_metadata", {}), len(self._store)),
                (frame_metadata(self.reader, ids), len(ids)),
            ]
        )
        news = {*ids, *(frame.id for frame in self._skipped)}
        skipped = [frame for frame in old.get("skipped", []) if frame["id"] not in news]
        skipped += [asdict(frame) for frame in self._skipped]
        extra = {"fixed_splits": self._fixed(ids), "frame_metadata": metadata, "skipped": skipped}
        return {
            **{name: value for name, value in old.items() if name not in ("complete", *extra)},
            "tool_version": __version__,
            "calibration": {**old["calibration"], "origin": least_certain(made)},
            **{name: value for name, value in extra.items() if value},
            "depth_percentiles_m": percentiles if "depth" in self._store.modalities else None,
            "source": joined_source(made),
        }

    def _appended(self, store: Store) -> Appended:
        return Appended(store, self._ids, len(self._existing), tuple(self._skipped))
