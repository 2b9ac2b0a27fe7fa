"""What a conversion has done so far, kept beside the store it writes, so that it can go on."""

from __future__ import annotations

import hashlib
import json
import secrets
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nimprep import __version__
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.records import DEPTHS, Records, UnitRecord, seal, unseal
from nimprep.conversion.sources import FileState, changed_files
from nimprep.errors import StoreError
from nimprep.options import options_of
from nimprep.readers.crop import Margins
from nimprep.readers.given_splits import split_files
from nimprep.store.storage import Storage

PLAN = "plan.json"
"""Where the plan is kept: without it nothing that is kept counts."""

_UNITS, _FAILED = "units", "failed.json"

_LISTS = frozenset((".txt", ".lst", ".csv", ".json", ".mat"))
"""What lists of splits are called at their ends."""

_AT_ONCE = 16
"""Records read at once: over a network each takes its time, and each is of some 100 KB."""


def option_values(options: ConvertOptions) -> dict[str, Any]:
    """Return the options that tell in the store, as JSON has them; files by their digest."""
    values = {}
    for name, option in options_of(ConvertOptions).items():
        if option.counts:
            value = getattr(options, name)
            is_file = Path in option.types and isinstance(value, (str, Path))
            values[name] = _digest(name, Path(value)) if is_file else value
    return json.loads(json.dumps(values))  # type: ignore[no-any-return]


def _shown(value: Any) -> str:
    return str(value)[:19] if isinstance(value, str) else json.dumps(value)


def _digest(name: str, path: Path) -> str:
    files = split_files(path) if name == "split_file" else [path]
    try:
        if name == "lists" and path.is_dir():
            # It may be the dataset's own folder: of images, and of what is below, nothing is read.
            files = sorted(p for p in path.iterdir() if p.suffix.lower() in _LISTS and p.is_file())
        digest = hashlib.sha256()
        for file in files:
            digest.update(file.read_bytes())
        return f"sha256:{digest.hexdigest()}"
    except OSError as error:
        raise StoreError(
            f"{path}: expected a readable file, found {error.strerror}; name one that can be read"
        ) from error


class LostRecordsError(StoreError):
    """What a unit's frames are is not known any more, and so no store can be made of them."""


class Unit(NamedTuple):
    """Say which frames a unit has, and what tells its record from any other's."""

    ids: list[str]
    plan: str


@dataclass(frozen=True)
class Journal:
    """Keep a plan and the records of the units done: see `begin_journal` and `kept_journal`.

    Attributes
    ----------
    storage : Storage
        A place of its own.
    where : str
        The target, for messages.
    plan : mapping
        As JSON has it.
    units : sequence of Unit
        The plan's.
    """

    storage: Storage
    where: str
    plan: Mapping[str, Any]
    units: Sequence[Unit]

    @property
    def margins(self) -> Margins | None:
        """The margins that the plan cuts off."""
        return None if self.plan["margins"] is None else Margins(**self.plan["margins"])

    def check(
        self,
        options: ConvertOptions,
        states: Mapping[str, tuple[FileState, ...]],
        base: Mapping[str, Any] | None,
    ) -> None:
        """Make sure that going on gives what one run would have given.

        Files of frames that were found bad may have changed: mending them is what one does.

        Raises
        ------
        StoreError
            The source, the options or the program are others than when the plan was made.
        """
        plan, changes = self.plan, []
        if plan["tool_version"] != __version__:
            changes.append(f"nimprep {plan['tool_version']} then and {__version__} now")
        now = option_values(options)
        for name in sorted(now.keys() | plan["options"].keys()):
            before, after = plan["options"].get(name), now.get(name)
            if before != after:
                changes.append(f"{name} {_shown(before)} then and {_shown(after)} now")
        if plan.get("base") != base:
            changes.append("another store to append to")
        changes += self._changed_frames(plan["files"], states)
        if changes:
            raise StoreError(
                f"{self.where}: expected the source and options that its conversion was begun "
                f"with, found {'; '.join(changes)}; give those again, or --restart to begin anew"
            )

    def _changed_frames(
        self, before: Mapping[str, Any], after: Mapping[str, tuple[FileState, ...]]
    ) -> list[str]:
        bad = self._bad_frames()
        said = []
        for what, ids in (
            ("gone", before.keys() - after.keys()),
            ("new", after.keys() - before.keys()),
        ):
            if ids:
                said.append(f"{len(ids)} frames {what}, first {min(ids)!r}")
        files = [
            name
            for frame_id in before.keys() & after.keys() - bad
            # One that lacked a file may have it by now.
            if before[frame_id]
            for name in changed_files(map(tuple, before[frame_id]), after[frame_id])
        ]
        if files:
            said.append(f"{len(files)} source files changed, first {min(files)}")
        return said

    def _bad_frames(self) -> set[str]:
        bad: set[str] = set()
        # Spoilt, it names nobody: then a mended file counts as changed, which is said.
        with suppress(ValueError, KeyError, TypeError):
            bad = set(unseal(self.storage.read(_FAILED) or b"")["frames"])
        return bad | {s.id for record in self.records() for s in record.skipped}

    def note_failure(self, frame_id: str) -> None:
        """Remember a frame that ended the conversion."""
        self.storage.write(_FAILED, [seal({"frames": [frame_id]})])

    def record(self, unit: UnitRecord) -> None:
        """Keep a unit's record; its shards must have been written by now."""
        plan = self.units[unit.number].plan
        self.storage.write(_unit_key(unit.number), [unit.to_json(plan)])

    def forget(self, number: int) -> None:
        """Let a unit count as not done."""
        self.storage.remove(_unit_key(number))

    def records(self) -> list[UnitRecord]:
        """Return the records kept, in order; what cannot be read is not done.

        Their histograms are left out: see `whole`.
        """
        return [record.without_counts() for record in self._read()]

    def missing(self) -> list[int]:
        """Return the numbers of the plan's units that are not done."""
        done = {record.number for record in self._read()}
        return [number for number in range(len(self.units)) if number not in done]

    def whole(self) -> Records:
        """Return the records of all of the plan's units.

        Raises
        ------
        LostRecordsError
            One is not there, or not whole: no store may be completed without it.
        """
        records, total = [], np.zeros(DEPTHS, dtype=np.int64)
        for record in self._read():
            records.append(record.without_counts())
            total += record.depth_counts
        lost = sorted(set(range(len(self.units))) - {record.number for record in records})
        if lost or not self.units:
            raise LostRecordsError(
                f"{self.where}: expected a whole record of each of {len(self.units)} units, "
                f"found those of {lost} lost or damaged; the same command makes them again"
            )
        return Records(tuple(records), total)

    def _read(self) -> Iterator[UnitRecord]:
        """Yield the units' records that are whole, asked for by number: no listing is relied on."""
        for first in range(0, len(self.units), _AT_ONCE):
            numbers = range(first, min(first + _AT_ONCE, len(self.units)))
            found = self.storage.read_many([_unit_key(number) for number in numbers])
            for number in numbers:
                with suppress(ValueError, KeyError, TypeError, zlib.error):
                    unit = self.units[number]
                    record = UnitRecord.from_json(found[_unit_key(number)] or b"", unit.plan)
                    if record.number == number and _fits(record, unit.ids):
                        yield record


def begin_journal(
    storage: Storage, where: str, document: Mapping[str, Any], run: str | None = None
) -> Journal:
    """Keep a conversion's plan.

    Parameters
    ----------
    document : mapping
        What is to be kept of it: see `nimprep.conversion.plan.Job.document`.
    run : str, optional
        The plan's that is gone on with; None = nothing that was done before counts, even where it
        could not be removed.
    """
    data = seal({"tool_version": __version__, "run": run or secrets.token_hex(8), **document})
    storage.write(PLAN, [data])
    return _journal(storage, where, data)


def kept_journal(storage: Storage, where: str) -> Journal | None:
    """Return the journal that is kept; None = none, or one that a fault of the disk spoilt."""
    # An answer that was cut short may be whole the second time; all that was done hangs on it.
    for _ in range(2):
        data = storage.read(PLAN)
        if data is None:
            break
        with suppress(ValueError, KeyError, TypeError):
            return _journal(storage, where, data)
    return None


def _journal(storage: Storage, where: str, data: bytes) -> Journal:
    plan = unseal(data)
    return Journal(storage, where, plan, _units(plan))


def units_of(ids: Sequence[str], length: int, before: int) -> list[list[str]]:
    """Return each unit's frame ids: a shard's length, less in the last.

    The first has as many as the last shard of the `before` frames that there are already has room
    for, so that shards fall together.
    """
    first = length - before % length
    return [list(ids[:first]), *(list(ids[i : i + length]) for i in range(first, len(ids), length))]


def _unit_key(number: int) -> str:
    return f"{_UNITS}/{number}.json"


def _units(plan: Mapping[str, Any]) -> list[Unit]:
    """Return the units of a plan; a record counts for just the plan and files it was made by."""
    files, base = plan["files"], plan["base"]
    frames = 0 if base is None else base["frames"]
    every = {name: value for name, value in plan.items() if name != "files"}
    units = []
    for number, ids in enumerate(units_of(list(files), plan["options"]["shard_length"], frames)):
        said = json.dumps([every, number, [[i, files[i]] for i in ids]])
        units.append(Unit(ids, hashlib.sha256(said.encode()).hexdigest()))
    return units


def _fits(record: UnitRecord, ids: Sequence[str]) -> bool:
    """Return whether a record tells of just these frames: each stored, in order, or skipped."""
    skipped = [frame.id for frame in record.skipped]
    stored = [frame.id for frame in record.frames]
    return len(set(skipped)) == len(skipped) and (
        stored == [i for i in ids if i not in set(skipped)] and set(skipped) <= set(ids)
    )
