"""Records of units that a fault spoils: done again, or said; never a store without their frames."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nimprep
from nimprep.conversion import run
from nimprep.conversion.append import append_frames
from nimprep.conversion.journal import Journal
from nimprep.conversion.records import SkippedFrame, UnitRecord, seal, unseal
from nimprep.errors import StoreError
from nimprep.store.reader import Store
from nimprep.store.storage import LocalStorage
from nimprep.store.validate import validate_store
from nimprep.store.writer import StoreWriter
from tests.conversion.test_append import write_frames
from tests.fakes import contents, write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

FRAMES, LENGTH = 10, 4
UNITS = 3

Damage = Callable[[Path, Path], None]


def cut(record: Path, other: Path) -> None:
    record.write_bytes(record.read_bytes()[:-20])


def flip(record: Path, other: Path) -> None:
    data = bytearray(record.read_bytes())
    data[data.index(b'"image_size"') + 15] ^= 1
    record.write_bytes(data)


def swap(record: Path, other: Path) -> None:
    ours, theirs = record.read_bytes(), other.read_bytes()
    record.write_bytes(theirs)
    other.write_bytes(ours)


DAMAGES: dict[str, Damage] = {
    "cut short": cut,
    "one bit": flip,
    "empty": lambda record, other: record.write_bytes(b"") and None,
    "no JSON": lambda record, other: record.write_bytes(b"\x00" * 100) and None,
    "no record": lambda record, other: record.write_bytes(b'{"number": 1}') and None,
    "a list": lambda record, other: record.write_bytes(b"[]") and None,
    "gone": lambda record, other: record.unlink(),
    "another unit's": lambda record, other: record.write_bytes(other.read_bytes()) and None,
    "exchanged": swap,
}


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_gmrp(tmp_path_factory.mktemp("raw") / "gmrp", FRAMES)


@pytest.fixture(scope="module")
def whole(raw: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the store of an undisturbed conversion."""
    target = tmp_path_factory.mktemp("whole") / "whole.zarr"
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(raw, target, shard_length=LENGTH)
    return target


def spoiling(
    monkeypatch: pytest.MonkeyPatch, units: Path, damage: Damage, number: int, times: int = 1
) -> list[int]:
    """Have a record damaged before the records are read to complete a store; count how often."""
    done: list[int] = []
    read = Journal.whole

    def spoilt(self: Journal) -> Any:
        if len(done) < times:
            done.append(number)
            damage(units / f"{number}.json", units / f"{(number + 1) % UNITS}.json")
        return read(self)

    monkeypatch.setattr(Journal, "whole", spoilt)
    return done


@pytest.mark.parametrize("number", range(UNITS))
@pytest.mark.parametrize("kind", DAMAGES)
def test_a_record_spoilt_before_the_end_is_made_again(
    kind: str, number: int, raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    done = spoiling(monkeypatch, units, DAMAGES[kind], number)
    nimprep.convert(raw, tmp_path / "s.zarr", shard_length=LENGTH)
    assert done
    assert contents(tmp_path / "s.zarr") == contents(whole)


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_record_spoilt_before_an_append_ends_is_made_again(
    kind: str, raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = write_gmrp(tmp_path / "few", 1)
    rest = write_frames(tmp_path / "rest", range(1, FRAMES))
    for name in ("s", "quiet"):
        nimprep.convert(few, tmp_path / f"{name}.zarr", shard_length=LENGTH)
    append_frames(rest, tmp_path / "quiet.zarr")
    units = tmp_path / ".s.zarr.partial" / "append" / "journal" / "units"
    done = spoiling(monkeypatch, units, DAMAGES[kind], 1)
    found = append_frames(rest, tmp_path / "s.zarr")
    assert done
    assert len(found.ids) == FRAMES - 1
    assert contents(tmp_path / "s.zarr") == contents(tmp_path / "quiet.zarr")


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_record_spoilt_while_nothing_runs_is_made_again(
    kind: str, raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(run, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nimprep.convert(raw, target, shard_length=LENGTH)
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    DAMAGES[kind](units / "1.json", units / "2.json")
    nimprep.convert(raw, target, shard_length=LENGTH)
    assert contents(target) == contents(whole)


@pytest.mark.parametrize("number", range(UNITS))
@pytest.mark.parametrize("kind", ["cut short", "empty", "no JSON", "gone", "another unit's"])
def test_a_shard_spoilt_while_nothing_runs_is_made_again(
    kind: str, number: int, raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, rest = write_gmrp(tmp_path / "few", 2), write_frames(tmp_path / "rest", range(2, FRAMES))
    for name in ("grown", "quiet"):
        nimprep.convert(few, tmp_path / f"{name}.zarr", shard_length=LENGTH)
    append_frames(rest, tmp_path / "quiet.zarr")
    tasks: list[tuple[str, Callable[[], object], Path]] = [
        ("s", lambda: nimprep.convert(raw, tmp_path / "s.zarr", shard_length=LENGTH), whole),
        ("grown", lambda: append_frames(rest, tmp_path / "grown.zarr"), tmp_path / "quiet.zarr"),
    ]
    for name, task, expected in tasks:
        with monkeypatch.context() as patch:
            patch.setattr(Journal, "whole", lambda self: (_ for _ in ()).throw(KeyboardInterrupt))
            with pytest.raises(KeyboardInterrupt):
                task()
        place = tmp_path / f".{name}.zarr.partial" / ("append" if name == "grown" else "")
        shards = place / "store" / "label" / "c"
        shard, other = (shards / str(n % UNITS) / "0" / "0" for n in (number, number + 1))
        DAMAGES[kind](shard, other)
        task()
        assert contents(tmp_path / f"{name}.zarr") == contents(expected)


SHARD_DAMAGES = {k: DAMAGES[k] for k in ("cut short", "empty", "gone", "another unit's")} | {
    "one byte of the index": lambda shard, other: change(shard, -9),
    "what its last image ends with": lambda shard, other: change(shard, -16 * LENGTH - 5),
    "exchanged": swap,
}


def change(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("modality", ["rgb", "label"])
@pytest.mark.parametrize("kind", SHARD_DAMAGES)
def test_a_shard_spoilt_before_the_end_is_made_again(
    kind: str, modality: str, raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, rest = write_gmrp(tmp_path / "few", 2), write_frames(tmp_path / "rest", range(2, FRAMES))
    bad = shutil.copytree(raw, tmp_path / "bad")
    (bad / "rgb" / "000001.png").write_bytes(b"no picture")
    small: dict[str, Any] = {"shard_length": LENGTH, "modalities": ("rgb", "label")}
    for name in ("grown", "grown-quiet"):
        nimprep.convert(few, tmp_path / f"{name}.zarr", **small)

    def tasks(suffix: str) -> None:
        nimprep.convert(raw, tmp_path / f"s{suffix}.zarr", **small)
        nimprep.convert(bad, tmp_path / f"gaps{suffix}.zarr", on_error="skip", **small)
        append_frames(rest, tmp_path / f"grown{suffix}.zarr")

    tasks("-quiet")
    damaged: list[Path] = []
    read = Journal.whole

    def spoilt(self: Journal) -> Any:
        journal = self.storage.root
        assert journal is not None
        root = journal.with_name("store")
        if root in damaged:
            return read(self)
        shards = [root / modality / "c" / str(n) / "0" / "0" for n in (0, 1)]
        first, second = ((path / "0" if path.is_dir() else path) for path in shards)
        SHARD_DAMAGES[kind](first, second)
        damaged.append(root)
        return read(self)

    monkeypatch.setattr(Journal, "whole", spoilt)
    tasks("")
    assert len(damaged) == 3
    for name in ("s", "gaps", "grown"):
        assert contents(tmp_path / f"{name}.zarr") == contents(tmp_path / f"{name}-quiet.zarr")


def test_a_shard_that_is_spoilt_again_and_again_ends_it_in_one_line(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, write = tmp_path / "s.zarr", LocalStorage.write

    def cutting(self: LocalStorage, key: str, parts: Any) -> None:
        write(self, key, [parts[0][:-1]] if key.startswith("label/c/1/") else parts)

    with monkeypatch.context() as patch:
        patch.setattr(LocalStorage, "write", cutting)
        with pytest.raises(StoreError, match=r"label/c/1/0/0: expected a shard of the frames that"):
            nimprep.convert(raw, target, shard_length=LENGTH)
    assert not target.exists()
    nimprep.convert(raw, target, shard_length=LENGTH)
    assert validate_store(target).problems == []


def test_a_plan_whose_reading_was_cut_short_is_read_again(
    raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, read, cuts = tmp_path / "s.zarr", LocalStorage.read, []
    with monkeypatch.context() as patch:
        patch.setattr(run, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nimprep.convert(raw, target, shard_length=LENGTH)

    def once(self: LocalStorage, key: str, limit: int | None = None) -> bytes | None:
        data = read(self, key, limit)
        if key == "plan.json" and data and not cuts:
            cuts.append(key)
            return data[:-5]
        return data

    def progress(step: str, frames: int) -> Callable[[], None]:
        assert step == "going on converting"
        return lambda: None

    monkeypatch.setattr(LocalStorage, "read", once)
    nimprep.convert(raw, target, shard_length=LENGTH, progress=progress)
    assert cuts
    assert contents(target) == contents(whole)


def test_records_that_cannot_be_kept_end_it_in_one_line(
    raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = LocalStorage.read

    def unreadable(self: LocalStorage, key: str, limit: int | None = None) -> bytes | None:
        data = read(self, key, limit)
        return data if data is None or not key.endswith("units/1.json") else data[:-1]

    target = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(LocalStorage, "read", unreadable)
        with pytest.raises(StoreError, match=r"of each of 3 units, found those of \[1\] lost"):
            nimprep.convert(raw, target, shard_length=LENGTH)
    assert not target.exists()
    nimprep.convert(raw, target, shard_length=LENGTH)
    assert contents(target) == contents(whole)


@pytest.mark.parametrize("number", range(UNITS))
def test_a_record_spoilt_once_shards_have_moved_up_costs_no_frame(
    number: int, raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = shutil.copytree(raw, tmp_path / "bad")
    picture = bad / "rgb" / "000001.png"
    picture.write_bytes(picture.read_bytes()[:-30])
    options: dict[str, Any] = {"shard_length": LENGTH, "on_error": "skip"}
    nimprep.convert(bad, tmp_path / "quiet.zarr", **options)
    target = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(StoreWriter, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nimprep.convert(bad, target, **options)
    journal = tmp_path / ".s.zarr.partial" / "journal"
    cut(journal / "units" / f"{number}.json", journal)
    nimprep.convert(bad, target, **options)
    assert contents(target) == contents(tmp_path / "quiet.zarr")
    assert validate_store(target, deep=True).valid


def test_a_record_of_an_earlier_run_is_none_of_this_one(
    raw: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "s.zarr"
    with monkeypatch.context() as patch:
        patch.setattr(run, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nimprep.convert(raw, target, shard_length=LENGTH)
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    left = {path.name: path.read_bytes() for path in units.iterdir()}
    begin = StoreWriter.begin

    def begun(self: StoreWriter, attributes: dict[str, Any]) -> None:
        # As where a listing left them out when everything was to be removed.
        units.mkdir(parents=True, exist_ok=True)
        for name, data in left.items():
            (units / name).write_bytes(data)
        begin(self, attributes)

    monkeypatch.setattr(StoreWriter, "begin", begun)
    nimprep.convert(raw, target, shard_length=LENGTH, restart=True)
    assert contents(target) == contents(whole)


@pytest.mark.parametrize("name", ["plan.json", "failed.json"])
@pytest.mark.parametrize("kind", ["cut short", "empty", "no JSON", "a list"])
def test_a_journal_that_is_spoilt_is_begun_anew_or_said(
    kind: str, name: str, raw: Path, whole: Path, tmp_path: Path
) -> None:
    bad = shutil.copytree(raw, tmp_path / "bad")
    picture = bad / "depth_u16" / "000006.png"
    picture.write_bytes(picture.read_bytes()[:-30])
    target = tmp_path / "s.zarr"
    with pytest.raises(nimprep.NimprepError, match="000006"):
        nimprep.convert(bad, target, shard_length=LENGTH)
    journal = tmp_path / ".s.zarr.partial" / "journal"
    DAMAGES[kind](journal / name, journal)
    shutil.copy(raw / "depth_u16" / "000006.png", picture)
    if name == "failed.json":
        # Nobody knows any more that this file was bad: that it was mended counts as a change.
        with pytest.raises(StoreError, match=r"1 source files changed.*--restart"):
            nimprep.convert(bad, target, shard_length=LENGTH)
        nimprep.convert(bad, target, shard_length=LENGTH, restart=True)
    else:
        nimprep.convert(bad, target, shard_length=LENGTH)
    assert len(nimprep.open_store(target)) == FRAMES
    assert validate_store(target, deep=True).valid


def test_an_append_that_was_killed_at_its_last_step_says_what_the_store_has(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, rest = tmp_path / "s.zarr", write_frames(tmp_path / "rest", range(1, FRAMES))
    nimprep.convert(write_gmrp(tmp_path / "few", 1), target, shard_length=LENGTH)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            append_frames(rest, target)
    units = tmp_path / ".s.zarr.partial" / "append" / "journal" / "units"
    assert units.is_dir()
    cut(units / "1.json", units)
    found = append_frames(rest, target)
    assert found.ids == tuple(f"{n:06d}" for n in range(1, FRAMES))
    assert len(found.store) == FRAMES


def test_an_append_says_which_frame_came_to_be_neither_stored_nor_skipped(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, rest = tmp_path / "s.zarr", write_frames(tmp_path / "rest", range(1, 4))
    nimprep.convert(write_gmrp(tmp_path / "few", 1), target, modalities=("rgb",))
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            append_frames(rest, target)

    def lacking(place: Path) -> Store:
        store = Store(place)
        store.ids = store.ids[:-1]
        return store

    with monkeypatch.context() as patch:
        patch.setattr("nimprep.conversion.append.open_store", lacking)
        with pytest.raises(StoreError, match=r"each of 3 appended .* found '000003' .* neither"):
            append_frames(rest, target)
    assert append_frames(rest, target, skip_existing=True).existing == 3


def test_what_is_sealed_is_whole_or_refused() -> None:
    document = {"a": [1.5, float("inf"), "\u00e4"], "b": {"c": None}}
    data = seal(document)
    assert unseal(data) == document
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 1
        for spoilt in (data[:place], bytes(changed)):
            try:
                assert unseal(spoilt) == document
            except ValueError:
                continue


def test_a_record_belongs_to_its_plan_alone() -> None:
    counts = np.arange(1 << 16, dtype=np.int64)
    record = UnitRecord(3, (), (SkippedFrame("a", "bad"),), counts, {"rgb": 7})
    again = UnitRecord.from_json(record.to_json("plan"), "plan")
    assert (again.number, again.skipped, again.indices) == (3, record.skipped, {"rgb": 7})
    assert (again.depth_counts == counts).all()
    with pytest.raises(ValueError, match="expected a record of 'other'"):
        UnitRecord.from_json(record.to_json("plan"), "other")
