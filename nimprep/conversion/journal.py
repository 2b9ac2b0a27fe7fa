"""What a conversion has done so far, kept beside the store it writes, so that it can go on."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep import __version__
from nimprep.conversion.job import Base
from nimprep.conversion.options import ConvertOptions
from nimprep.conversion.records import DEPTHS, UnitRecord
from nimprep.conversion.sources import FileState, changed_files
from nimprep.errors import StoreError
from nimprep.readers.crop import Margins
from nimprep.store.storage import Storage

_PLAN, _UNITS, _FAILED, _PACKED = "plan.json", "units", "failed.json", "packed"

_FREE = ("workers", "overwrite", "restart", "on_error", "scheduler")
"""Options that leave the store's bytes as they are, or what is done of them."""

_FILES = ("camera", "description", "split_file")
"""Options that may name a file, whose contents count."""


def option_values(options: ConvertOptions) -> dict[str, Any]:
    """Return the options that tell in the store, as JSON has them; files by their digest."""
    values = {name: value for name, value in asdict(options).items() if name not in _FREE}
    for name in _FILES:
        if isinstance(values[name], (str, Path)):
            values[name] = _file_digest(Path(values[name]))
    return json.loads(json.dumps(values))  # type: ignore[no-any-return]


def _shown(value: Any) -> str:
    return str(value)[:19] if isinstance(value, str) else json.dumps(value)


def _file_digest(path: Path) -> str:
    try:
        return f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
    except OSError as error:
        raise StoreError(f"{path}: expected a readable file, found {error.strerror}") from error


class Journal:
    """Keep a plan and the records of the units done.

    Parameters
    ----------
    storage : Storage
        A place of its own.
    where : str
        The target, for messages.
    base : Base, optional
        The store that frames are appended to.
    """

    def __init__(self, storage: Storage, where: str, base: Base | None = None) -> None:
        self._storage = storage
        self._where = where
        self._base = None if base is None else asdict(base)

    def begin(
        self,
        options: ConvertOptions,
        margins: Margins | None,
        states: Mapping[str, tuple[FileState, ...]],
    ) -> None:
        """Keep a new conversion's plan."""
        plan = {
            "tool_version": __version__,
            "options": option_values(options),
            "margins": None if margins is None else asdict(margins),
            "files": states,
            "base": self._base,
        }
        self._storage.write(_PLAN, [json.dumps(plan).encode()])

    def plan(self) -> dict[str, Any] | None:
        """Return the plan that is kept; None = none, or one that a fault of the disk spoilt."""
        data = self._storage.read(_PLAN)
        try:
            return None if data is None else json.loads(data)
        except ValueError:
            return None

    def begun_margins(self, plan: Mapping[str, Any]) -> Margins | None:
        """Return the margins that a plan cuts off."""
        return None if plan["margins"] is None else Margins(**plan["margins"])

    def check(
        self,
        plan: Mapping[str, Any],
        options: ConvertOptions,
        states: Mapping[str, tuple[FileState, ...]],
    ) -> None:
        """Make sure that going on gives what one run would have given.

        Files of frames that were found bad may have changed: mending them is what one does.

        Raises
        ------
        StoreError
            The source, the options or the program are others than when the plan was made.
        """
        changes = []
        if plan["tool_version"] != __version__:
            changes.append(f"nimprep {plan['tool_version']} then and {__version__} now")
        now = option_values(options)
        for name in sorted(now.keys() | plan["options"].keys()):
            before, after = plan["options"].get(name), now.get(name)
            if before != after:
                changes.append(f"{name} {_shown(before)} then and {_shown(after)} now")
        if plan.get("base") != self._base:
            changes.append("another store to append to")
        changes += self._changed_frames(plan["files"], states)
        if changes:
            raise StoreError(
                f"{self._where}: expected the source and options that its conversion was begun "
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
            for name in changed_files(map(tuple, before[frame_id]), after[frame_id])
        ]
        if files:
            said.append(f"{len(files)} source files changed, first {min(files)}")
        return said

    def _bad_frames(self) -> set[str]:
        bad = set(json.loads(self._storage.read(_FAILED) or b"[]"))
        return bad | {s.id for record in self.records().values() for s in record.skipped}

    def note_failure(self, frame_id: str) -> None:
        """Remember a frame that ended the conversion."""
        self._storage.write(_FAILED, [json.dumps([frame_id]).encode()])

    def record(self, unit: UnitRecord) -> None:
        """Keep a unit's record; its shards must have been written by now."""
        self._storage.write(f"{_UNITS}/{unit.number}.json", [unit.to_json()])

    def forget(self, number: int) -> None:
        """Let a unit count as not done."""
        self._storage.remove(f"{_UNITS}/{number}.json")

    @property
    def packed(self) -> bool:
        """Whether the gaps of skipped frames are closed."""
        return self._storage.read(_PACKED) is not None

    def note_packed(self) -> None:
        """Remember that the gaps of skipped frames are closed."""
        self._storage.write(_PACKED, [b""])

    def records(self) -> dict[int, UnitRecord]:
        """Return the records kept, by the unit's number; what cannot be read is not done.

        Their histograms are left out: see `depth_counts`.
        """
        return {record.number: record.without_counts() for record in self._read()}

    def depth_counts(self) -> npt.NDArray[np.int64]:
        """Return the sum of the histograms of the units done, (65536,) int64."""
        total = np.zeros(DEPTHS, dtype=np.int64)
        for record in self._read():
            total += record.depth_counts
        return total

    def _read(self) -> Iterator[UnitRecord]:
        for key in self._storage.keys(_UNITS):
            with suppress(ValueError, KeyError, TypeError, zlib.error):
                yield UnitRecord.from_json(self._storage.read(key) or b"")
