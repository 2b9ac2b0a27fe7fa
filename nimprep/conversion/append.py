"""Adding frames to a store: encoded as its own are, then put together with its shards."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Unpack

from nimprep.conversion.bad_frames import way_out_said
from nimprep.conversion.compatibility import check_frames, depth_unit, options_like, padded_size
from nimprep.conversion.doubted import warn_of_doubts, warn_of_loss
from nimprep.conversion.growth import grow, grown_splits
from nimprep.conversion.journal import kept_journal
from nimprep.conversion.options import AppendKeywords
from nimprep.conversion.options import AppendOptions as AppendOptions
from nimprep.conversion.plan import Base, Plan
from nimprep.conversion.records import Records, SkippedFrame
from nimprep.conversion.run import encode, make_plan
from nimprep.conversion.sources import frame_states, listed_state
from nimprep.conversion.workspace import (
    LocalWorkspace,
    check_apart,
    check_unchanged,
    local_folder,
    open_workspace,
    root_digest,
)
from nimprep.derive.recipe import recipe_from
from nimprep.errors import StoreError
from nimprep.parallel import Progress, no_progress
from nimprep.readers import Reader
from nimprep.readers.subset import SubsetReader
from nimprep.store.extras import check_growable
from nimprep.store.metadata import read_attributes
from nimprep.store.reader import Store, open_store


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
    **changes: Unpack[AppendKeywords],
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
    with (
        way_out_said(options),
        open_workspace(target, overwrite=True, task="append") as workspace,
    ):
        opened, old = root_digest(target), open_store(target)
        reading = asdict(options)
        del reading["skip_existing"]
        converting = options_like(old, **reading)
        reader = converting.open_reader(source)
        done = _published(old, reader, options, workspace) if workspace.published else None
        known = None if done else old.about
        if done is None:
            new = SubsetReader(reader, _new_ids(old, reader, options))
            done = Appended(old, (), len(reader.ids) - len(new.ids), ())
            if new.ids:
                digest, unit = old.about.source["digest"], depth_unit(old)
                base = Base(len(old), *padded_size(old), digest, unit)
                recipe = recipe_from(old.about.modalities)
                plan = make_plan(source, new, converting, workspace, start, base, recipe)
                records = encode(plan, start)
                ids = tuple(facts.id for facts in records.facts)
                grown = _finish(plan, records, old, opened, workspace, start)
                done = Appended(grown, ids, done.existing, tuple(records.skipped))
    left = [plane.name for plane in reader.info.planes if plane.name not in old.modalities]
    lost = [f"the store has no {', '.join(left)}: these are not appended"] if left else []
    for note in (*reader.info.notes, *lost):
        warnings.warn(f"{source}: {note}", stacklevel=2)
    if done.store.about.depth_lost != old.about.depth_lost:
        warn_of_loss(done.store.path, done.store.about)
    warn_of_doubts(source, done.store.about, known)
    return done


def _folder(store: Path | str) -> Path:
    """Return the folder of a store that is there, or that a kill left nameless for the moment."""
    path = local_folder(store, "append to")
    # What is replaced is the store, and not a link to it.
    path = path.resolve() if path.is_symlink() else path
    if path.exists() or not LocalWorkspace(path, overwrite=True).folder.is_dir():
        read_attributes(path)
    return path


def _published(
    old: Store, reader: Reader, options: AppendOptions, workspace: LocalWorkspace
) -> Appended | None:
    """Return what an append of this very source did that was killed at its last step."""
    kept = kept_journal(workspace.journal, workspace.where)
    ours = {} if kept is None else kept.plan["files"]
    here = SubsetReader(reader, [i for i in reader.ids if i in ours])
    states = frame_states(here, skip_bad=options.on_error == "skip")
    workspace.clear()
    there = frozenset(old.ids)
    if (
        not ours
        or {i: listed_state(state) for i, state in states.items()} != ours
        or not (there | ours.keys()).issuperset(reader.ids)
        or not (options.skip_existing or set(reader.ids) == set(ours))
    ):
        return None
    # The store that has its name says what came of them, and not what is left of a journal.
    ids = tuple(i for i in ours if i in there)
    existing = sum(i in there for i in reader.ids) - len(ids)
    skipped = tuple(SkippedFrame(**f) for f in old.about.skipped if f["id"] in ours)
    if lost := ours.keys() - {*ids, *(frame.id for frame in skipped)}:
        raise StoreError(
            f"{old.path}: expected each of {len(ours)} appended frames in it or skipped, found "
            f"{min(lost)!r} and {len(lost) - 1} others neither; append them again with "
            "--skip-existing"
        )
    return Appended(old, ids, existing, skipped)


def _new_ids(old: Store, reader: Reader, options: AppendOptions) -> Sequence[str]:
    """Return the frames that the store has not; raise where these cannot join it."""
    there = frozenset(old.ids)
    existing = [i for i in reader.ids if i in there]
    if existing and not options.skip_existing:
        raise StoreError(
            f"{old.path}: expected frames that are not in it yet, found "
            f"{min(existing)!r} ({len(existing)} of {len(reader.ids)} are); "
            "--skip-existing leaves those as they are"
        )
    new = [i for i in reader.ids if i not in there]
    check_growable(Path(old.path))
    check_frames(old, reader, new)
    grown_splits(old, reader, {i: reader.group(i) for i in new})
    return new


def _finish(
    plan: Plan,
    records: Records,
    old: Store,
    opened: str,
    workspace: LocalWorkspace,
    start: Progress,
) -> Store:
    """Put the old store and the new frames together, in the old one's place."""
    if not records.facts:
        workspace.clear()
        return old
    grow(old, plan, records, workspace, start)
    check_unchanged(Path(old.path), opened)
    workspace.publish(workspace.joined)
    return open_store(Path(old.path))
