"""The run as a whole: plan, encode unit by unit, finish; cut short, it goes on where it stopped."""

from __future__ import annotations

import secrets
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.conversion.encode import encode_units as encode_units_here
from nimprep.conversion.gaps import forget_packing, is_packed, pack_shards, packing_goes_on
from nimprep.conversion.job import Base, Job
from nimprep.conversion.journal import Journal, LostRecordsError, begin_journal, kept_journal
from nimprep.conversion.object_workspace import workspace_at
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.plan import check_apart, describe, plan_layout, plan_modalities, plan_splits
from nimprep.conversion.records import UnitRecord, depth_percentiles, source_digest, tables
from nimprep.conversion.shard_contents import lost_units
from nimprep.conversion.sources import frame_states, listed_state
from nimprep.conversion.workspace import Workspace
from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.parallel import Progress, available_cores, no_progress
from nimprep.readers import Reader, open_reader
from nimprep.readers.crop import CroppedReader, Margins, find_invalid_sides
from nimprep.store.access import storage_from
from nimprep.store.location import is_url
from nimprep.store.reader import Store, open_store
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreWriter


def convert(
    source: Path | str,
    target: Path | str | Storage,
    options: ConvertOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Any,
) -> Store:
    """Convert a raw dataset into a store.

    Cut short, by a fault or by a kill, it leaves what was done in a hidden folder beside the
    target; the same call then goes on from there and ends with the same bytes.

    Parameters
    ----------
    source : path
        The dataset's folder; nothing in it is written to.
    target : path or URL
        The store's folder, ending in .zarr by custom. It is written in a hidden folder beside its
        place and gets its name when it is complete; until then what is there stays. Of a URL, see
        `nimprep.conversion.object_workspace`.
    options : ConvertOptions, optional
    progress : callable, optional
        Called with a step's name and its number of frames; what it returns is called after each.
    **changes
        Fields of `ConvertOptions`, over those of `options`.

    Returns
    -------
    Store
        The new store, open. Frames that were left out are in its attributes' `skipped`.

    Raises
    ------
    LayoutError, DecodeError, CameraError
        The dataset is not what it should be; the file is named.
    SplitError
        The split rule or file does not fit the frames.
    StoreError
        The target cannot be written, must not be, or holds the beginning of another conversion; or
        a modality could be stored but not read.
    """
    options = replace(options or ConvertOptions(), **changes)
    if is_url(source):
        raise LayoutError(f"{source}: expected a folder to read, local or mounted, found a URL")
    source, storage = Path(source), storage_from(target)
    if storage.root is not None:
        check_apart(source, storage.root)
    start = progress or no_progress
    if options.scheduler is not None:
        from nimprep.conversion.distributed import check_scheduler

        check_scheduler(options.scheduler)
    reader = open_reader(source, options.reader, options.reading)
    # Before anything is written: what is wrong with these must not cost a conversion.
    plan_modalities(reader, options)
    plan_splits(reader, options, reader.ids)
    with workspace_at(storage, overwrite=options.overwrite) as workspace:
        run = Run(source, reader, options, workspace, str(storage))
        run.prepare(start)
        run.encode(start)
        run.finish()
        workspace.publish()
    # Said last, beside the summary: at the start it would scroll away, and bad data gets one line.
    for note in reader.info.notes:
        warnings.warn(f"{source}: {note}", stacklevel=2)
    return open_store(storage)


class Run:
    """One conversion, from its plan to the finished store in the workspace.

    Parameters
    ----------
    base : Base, optional
        The store that the frames are to be appended to: then `finish` is the caller's.
    """

    def __init__(
        self,
        source: Path,
        reader: Reader,
        options: ConvertOptions,
        workspace: Workspace,
        where: str,
        base: Base | None = None,
    ) -> None:
        self._source = source
        self._reader = reader
        self._options = options
        self._workspace = workspace
        self._where = where
        self._base = base
        self._workers = options.workers or available_cores()

    def prepare(self, start: Progress) -> None:
        """Plan anew, or take up the plan of a conversion that was cut short."""
        skip = self._options.on_error == "skip"
        states = frame_states(self._reader, skip_bad=skip)
        storage = self._workspace.journal
        kept = None if self._options.restart else kept_journal(storage, self._where)
        if kept is None:
            self._workspace.clear()
            margins = self._margins(start)
        else:
            kept.check(self._options, states, self._base)
            margins = kept.margins
        if margins is not None:
            self._reader = CroppedReader(self._reader, margins)
        layout = plan_layout(self._reader, self._options, alone=self._base is None)
        if self._base is not None:
            layout = replace(layout, height=self._base.height, width=self._base.width)
        store = self._workspace.store
        self.job = Job(self._source, self._options, margins, layout, states, store, self._base)
        if kept is not None:
            self._keep(kept)
        run = None if kept is None else kept.plan["run"]
        self._journal = begin_journal(storage, self._where, self.job, run)
        self._begin_store()

    def _begin_store(self) -> None:
        """Write a root that is no other's: what a cluster is late with must not come between."""
        run = {"run": secrets.token_hex(8)}
        self._writer().begin({**self._describe(self._reader.ids), **run})

    def _writer(self) -> StoreWriter:
        return StoreWriter(self._workspace.store, self.job.layout)

    def _margins(self, start: Progress) -> Margins | None:
        crop = self._options.crop
        if crop != "auto":
            return None if crop is None else Margins(*crop)
        done = start("looking for sides without depth", len(self._reader.ids))
        skip = self._options.on_error == "skip"
        return find_invalid_sides(self._reader, self._workers, done, skip_bad=skip)

    def _keep(self, kept: Journal) -> None:
        """Forget the units that are to be done again, the others' shards being there."""
        records = [record for _, record in sorted(kept.records().items())]
        again = {record.number for record in records if self._is_mended(record, kept)}
        undone = len(records) < len(self.job.units())
        if again or undone or not packing_goes_on(self._writer(), records):
            forget_packing(self._workspace.store)
            # Such as shards of a store in its place, or moved up already into the gaps.
            again |= lost_units(self._writer(), records)
        for number in again:
            kept.forget(number)

    def _is_mended(self, record: UnitRecord, kept: Journal) -> bool:
        """Return whether bad frames of a unit were mended since, or may no longer be skipped."""
        bad = [frame.id for frame in record.skipped]
        mended = any(kept.plan["files"].get(i) != listed_state(self.job.states[i]) for i in bad)
        return mended or (bool(bad) and self._options.on_error == "stop")

    def _describe(self, ids: Sequence[str]) -> dict[str, Any]:
        return describe(self._reader, self.job.layout, self._options, ids)

    def encode(self, start: Progress) -> None:
        """Encode and write the units that are not done yet."""
        units = self.job.units()
        todo = self._journal.missing()
        total = len(self._reader.ids)
        before = total - sum(len(units[number]) for number in todo)
        done = start("converting" if not before else "going on converting", total)
        for _ in range(before):
            done()
        self._encode(todo, done)

    def _encode(self, todo: Sequence[int], done: Callable[[], None]) -> None:
        total = len(self._reader.ids)
        try:
            encode_units = _encoder(self._options)
            encoding = encode_units(self.job, self._reader, todo, self._workers, done)
            with closing(encoding):
                for record in encoding:
                    self._journal.record(record)
        except (NimprepError, KeyboardInterrupt) as error:
            if isinstance(error, NimprepError) and error.frame_id is not None:
                self._journal.note_failure(error.frame_id)
            self._say_how_to_go_on(error, total)
            raise

    def _say_how_to_go_on(self, error: BaseException, total: int) -> None:
        kept = sum(len(r.frames) for r in self._journal.records().values())
        if kept:
            error.add_note(f"{kept} of {total} frames are kept: the same command goes on from them")

    def whole(self) -> tuple[list[UnitRecord], npt.NDArray[np.int64]]:
        """Return every unit's record, in order, and how many pixels have each depth.

        A unit whose record was spoilt since is done again, once.

        Raises
        ------
        StoreError
            One cannot be kept.
        """
        try:
            return self._journal.whole()
        except LostRecordsError:
            self._encode(self._journal.missing(), lambda: None)
            return self._journal.whole()

    def finish(self) -> None:
        """Close the gaps of skipped frames, write the tables, and complete the store."""
        records, counts = self.whole()
        facts = list(chain.from_iterable(record.frames for record in records))
        skipped = list(chain.from_iterable(record.skipped for record in records))
        if not facts:
            raise DecodeError(
                f"{self._source}: expected at least one good frame, found {len(skipped)} bad ones, "
                f"first {skipped[0].id!r}: {skipped[0].reason}"
            )
        self._pack(records)
        ids = [frame.id for frame in facts]
        attributes = {
            **self._describe(ids),
            **({"skipped": [asdict(frame) for frame in skipped]} if skipped else {}),
            "depth_percentiles_m": depth_percentiles(counts),
            "source": {"digest": source_digest(facts)},
        }
        layout = replace(self.job.layout, frames=len(facts))
        splits = plan_splits(self._reader, self._options, ids)
        StoreWriter(self._workspace.store, layout).finish(
            tables(facts, splits, layout.modalities), attributes
        )

    def _pack(self, records: Sequence[UnitRecord]) -> None:
        lengths = [len(record.frames) for record in records]
        if not is_packed(lengths, self.job.layout.shard_length):
            self._begin_store()
            pack_shards(self._writer(), records)


def _encoder(options: ConvertOptions) -> Callable[..., Generator[UnitRecord]]:
    """Return what encodes units: threads of this process, or a cluster's."""
    if options.scheduler is None:
        return encode_units_here
    from nimprep.conversion.distributed import encode_units

    return encode_units
