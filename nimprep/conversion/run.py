"""The run as a whole: plan, encode unit by unit, finish; cut short, it goes on where it stopped."""

from __future__ import annotations

import secrets
import warnings
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Unpack

from nimprep.conversion.bad_frames import way_out_said
from nimprep.conversion.doubted import warn_of_doubts, warn_of_loss
from nimprep.conversion.encode import encode_units
from nimprep.conversion.gaps import (
    foreign,
    forget_packing,
    is_packed,
    pack_shards,
    packing_goes_on,
)
from nimprep.conversion.journal import Journal, LostRecordsError, begin_journal, kept_journal
from nimprep.conversion.normals_choice import asks_for_choice, choose_normals, with_choice
from nimprep.conversion.options import ConvertKeywords, ConvertOptions
from nimprep.conversion.plan import (
    Base,
    Job,
    Plan,
    describe,
    described,
    plan_layout,
    plan_modalities,
    plan_splits,
)
from nimprep.conversion.records import Records, UnitRecord, tables
from nimprep.conversion.shard_contents import changed_shards, lost_units
from nimprep.conversion.sources import frame_states, listed_state
from nimprep.conversion.workspace import Workspace, check_apart, workspace_at
from nimprep.derive.recipe import Recipe
from nimprep.errors import DecodeError, LayoutError, NimprepError, StoreError
from nimprep.parallel import Progress, available_cores, no_progress
from nimprep.readers import Reader
from nimprep.readers.crop import CroppedReader, Margins, find_invalid_sides
from nimprep.store.access import storage_from
from nimprep.store.location import is_url
from nimprep.store.reader import Store, open_store
from nimprep.store.storage import Storage
from nimprep.store.writer import StoreWriter


def convert(
    source: Path | str,
    out: Path | str | Storage,
    options: ConvertOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Unpack[ConvertKeywords],
) -> Store:
    """Convert a raw dataset into a store.

    Cut short, by a fault or by a kill, it leaves what was done in a hidden folder beside the
    place of `out`; the same call then goes on from there and ends with the same bytes.

    Parameters
    ----------
    source : path
        The dataset's folder; nothing in it is written to.
    out : path or URL
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
        raise LayoutError(
            f"{source}: expected a folder to read, local or mounted, found a URL; "
            "copy it here first"
        )
    source, storage = Path(source), storage_from(out)
    if storage.root is not None:
        check_apart(source, storage.root)
    start = progress or no_progress
    if options.scheduler is not None:
        from nimprep.conversion.distributed import check_scheduler

        check_scheduler(options.scheduler)
    reader = options.open_reader(source)
    options = options.resolved(reader)
    # Before anything is written: what is wrong with these must not cost a conversion.
    plan_modalities(reader, options)
    plan_splits(reader, options, reader.ids)
    with (
        way_out_said(options),
        workspace_at(storage, overwrite=options.overwrite) as workspace,
    ):
        plan = make_plan(source, reader, options, workspace, start)
        records = encode(plan, start)
        finish(plan, records)
        workspace.publish()
    # Said last, beside the summary: at the start it would scroll away, and bad data gets one line.
    for note in reader.info.notes:
        warnings.warn(f"{source}: {note}", stacklevel=2)
    store = open_store(storage)
    warn_of_loss(source, store.about)
    warn_of_doubts(source, store.about)
    return store


def make_plan(
    source: Path,
    reader: Reader,
    options: ConvertOptions,
    workspace: Workspace,
    start: Progress,
    base: Base | None = None,
    recipe: Recipe | None = None,
) -> Plan:
    """Plan a conversion, or take up the plan of one that was cut short; begin its store.

    Parameters
    ----------
    base : Base, optional
        The store that the frames are to be appended to.
    recipe : Recipe, optional
        Its own; None = the options say how what is derived is made.
    """
    states = frame_states(reader, skip_bad=options.on_error == "skip")
    kept = None if options.restart else kept_journal(workspace.journal, workspace.where)
    if kept is None:
        workspace.clear()
        margins = _margins(reader, options, start)
    else:
        kept.check(options, states, None if base is None else asdict(base))
        margins = kept.margins
    if margins is not None:
        reader = CroppedReader(reader, margins)
    layout = plan_layout(reader, options, alone=base is None)
    if base is not None:
        held = replace(layout, depth_unit=base.depth_unit)
        layout = replace(held, height=base.height, width=base.width)
    chosen = None if kept is None else kept.plan.get("normals_chosen")
    if chosen is None and recipe is None and asks_for_choice(layout, options):
        chosen = choose_normals(reader, layout, options, start)
    recipe = recipe or with_choice(options.recipe, chosen)
    job = Job(source, options, recipe, margins, layout, states, workspace.store, base, chosen)
    if kept is not None:
        _forget_undone(kept, job)
    run = None if kept is None else kept.plan["run"]
    journal = begin_journal(workspace.journal, workspace.where, job.document(), run)
    plan = Plan(job, reader, journal)
    _begin_store(plan)
    return plan


def _margins(reader: Reader, options: ConvertOptions, start: Progress) -> Margins | None:
    if options.crop != "auto":
        return None if options.crop is None else Margins(*options.crop)
    done = start("looking for sides without depth", len(reader.ids))
    workers, skip = options.workers or available_cores(), options.on_error == "skip"
    return find_invalid_sides(reader, workers, done, skip_bad=skip)


def _forget_undone(kept: Journal, job: Job) -> None:
    """Forget the units that are to be done again, the others' shards being there."""
    writer = StoreWriter(job.storage, job.layout)
    records = kept.records()
    again = {record.number for record in records if _is_mended(record, kept, job)}
    undone = len(records) < len(job.units())
    if again or undone or not packing_goes_on(writer, records):
        forget_packing(job.storage)
        # Such as shards of a store in its place, or moved up already into the gaps.
        again |= lost_units(writer, records)
    for number in again:
        kept.forget(number)


def _is_mended(record: UnitRecord, kept: Journal, job: Job) -> bool:
    """Return whether bad frames of a unit were mended since, or may no longer be skipped."""
    bad = [frame.id for frame in record.skipped]
    mended = any(kept.plan["files"].get(i) != listed_state(job.states[i]) for i in bad)
    return mended or (bool(bad) and job.options.on_error == "stop")


def _begin_store(plan: Plan) -> None:
    """Write a root that is no other's: what a cluster is late with must not come between."""
    plan.writer().begin({**describe(plan, plan.reader.ids), "run": secrets.token_hex(8)})


def encode(plan: Plan, start: Progress) -> Records:
    """Encode and write the units that are not done yet; return the records of all.

    A unit whose record or shard was spoilt since is done again, once.

    Raises
    ------
    NimprepError
        A frame is bad, the disk full, or a record or a shard cannot be kept.
    """
    units, todo = plan.job.units(), plan.journal.missing()
    total = len(plan.reader.ids)
    before = total - sum(len(units[number]) for number in todo)
    done = start("converting" if not before else "going on converting", total)
    for _ in range(before):
        done()
    _encode(plan, todo, done)
    try:
        records = plan.journal.whole()
    except LostRecordsError:
        records = _again(plan)
    if changed := _changed_shards(plan, records):
        for number in set(changed.values()):
            plan.journal.forget(number)
        records = _again(plan)
        if changed := _changed_shards(plan, records):
            raise StoreError(foreign(plan.job.storage, min(changed)))
    return records


def _again(plan: Plan) -> Records:
    _encode(plan, plan.journal.missing(), lambda: None)
    return plan.journal.whole()


def _changed_shards(plan: Plan, records: Records) -> dict[str, int]:
    found = changed_shards(plan.writer(), records.units)
    # Those that were moved up into the gaps already are looked at when that goes on.
    return {} if found and packing_goes_on(plan.writer(), records.units) else found


def _encode(plan: Plan, todo: Sequence[int], done: Callable[[], None]) -> None:
    job, journal = plan.job, plan.journal
    try:
        if job.options.scheduler is None:
            encoding = encode_units(job, plan.reader, todo, done)
        else:
            from nimprep.conversion import distributed

            encoding = distributed.encode_units(job, todo, done)
        with closing(encoding):
            for record in encoding:
                journal.record(record)
    except (NimprepError, KeyboardInterrupt) as error:
        if isinstance(error, NimprepError) and error.frame_id is not None:
            journal.note_failure(error.frame_id)
        if kept := sum(len(record.frames) for record in journal.records()):
            total = len(plan.reader.ids)
            error.add_note(f"{kept} of {total} frames are kept: the same command goes on from them")
        raise


def finish(plan: Plan, records: Records) -> None:
    """Close the gaps of skipped frames, write the tables, and complete the store."""
    facts, skipped = records.facts, records.skipped
    if not facts:
        raise DecodeError(
            f"{plan.job.source}: expected at least one good frame, found {len(skipped)} bad ones, "
            f"first {skipped[0].id!r}: {skipped[0].reason}; mend one, and give the same command "
            "again"
        )
    _close_gaps(plan, records)
    ids = [frame.id for frame in facts]
    splits = plan_splits(plan.reader, plan.job.options, ids)
    layout = replace(plan.job.layout, frames=len(facts))
    writer = StoreWriter(plan.job.storage, layout)
    writer.finish(tables(facts, splits, layout.modalities), described(plan, records))


def _close_gaps(plan: Plan, records: Records) -> None:
    lengths = [len(unit.frames) for unit in records.units]
    if not is_packed(lengths, plan.job.layout.shard_length):
        _begin_store(plan)
        pack_shards(plan.writer(), records.units)
