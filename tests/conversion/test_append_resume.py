"""Appends that are cut short, for real, at any moment: the store is whole, and they go on."""

import os
import random
import shutil
import signal
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import DecodeError, StoreError
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.conversion.mortal import Mortals
from tests.conversion.test_append import damage, write_frames
from tests.fakes import contents, write_gmrp
from tests.held import RECORD, held
from tests.processes import PATIENCE_S, Processes

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

KILLS = int(os.environ.get("NIMPREP_KILLS", "6"))

SMALL = {"shard_length": 4, "modalities": ("depth",)}


@pytest.fixture
def store(tmp_path: Path) -> Path:
    nimprep.convert(write_gmrp(tmp_path / "a", 5), tmp_path / "s.zarr", shard_length=2)
    return tmp_path / "s.zarr"


@pytest.fixture
def more(tmp_path: Path) -> Path:
    return write_frames(tmp_path / "b", range(5, 11))


@pytest.fixture
def appended(store: Path, more: Path, tmp_path: Path) -> dict[str, bytes]:
    """Return the files of a store whose append nothing disturbed."""
    shutil.copytree(store, tmp_path / "undisturbed.zarr")
    nimprep.append_frames(more, tmp_path / "undisturbed.zarr")
    found = contents(tmp_path / "undisturbed.zarr")
    shutil.rmtree(tmp_path / "undisturbed.zarr")
    return found


def cut_short(source: Path, store: Path, bad: str = "000009") -> bytes:
    """Append until a bad frame ends it; return what its depth should be."""
    whole = damage(source / "depth_u16" / f"{bad}.png")
    with pytest.raises(DecodeError, match=bad) as caught:
        nimprep.append_frames(source, store, workers=1)
    assert "the same command goes on from them" in caught.value.__notes__[0]
    return whole


def test_the_same_command_goes_on(
    store: Path, more: Path, appended: dict[str, bytes], tmp_path: Path
) -> None:
    before = contents(store)
    whole = cut_short(more, store)
    assert contents(store) == before
    (more / "depth_u16" / "000009.png").write_bytes(whole)
    steps = []

    def progress(step: str, frames: int):  # type: ignore[no-untyped-def]
        steps.append((step, frames))
        return lambda: None

    nimprep.append_frames(more, store, progress=progress)
    assert steps[0] == ("going on converting", 6)
    assert contents(store) == appended
    assert {p.name for p in tmp_path.iterdir()} == {"a", "b", "s.zarr"}


def test_what_changed_meanwhile_is_refused(store: Path, more: Path) -> None:
    whole = cut_short(more, store)
    (more / "depth_u16" / "000009.png").write_bytes(whole)
    with pytest.raises(StoreError, match="camera null then"):
        nimprep.append_frames(more, store, camera=(30.0, 30.0, 16.0, 12.0))
    other = write_gmrp(store.parent / "c", 7)
    nimprep.convert(other, store.parent / "c.zarr", shard_length=2)
    shutil.rmtree(store)
    (store.parent / "c.zarr").rename(store)
    for name in ("000005", "000006"):
        for path in more.rglob(f"{name}.png"):
            path.unlink()
    words = "another store to append to; 2 frames gone, .* --restart"
    with pytest.raises(StoreError, match=words):
        nimprep.append_frames(more, store)
    done = nimprep.append_frames(more, store, restart=True)
    assert len(done.store) == 11
    assert validate_store(store, deep=True).problems == []


def test_an_append_cut_short_stays_what_it_is_when_the_store_is_split_anew(
    store: Path, more: Path
) -> None:
    whole = cut_short(more, store)
    resplit(store, seed=5)
    (more / "depth_u16" / "000009.png").write_bytes(whole)
    before = nimprep.open_store(store).splits
    done = nimprep.append_frames(more, store)
    assert {i: done.store.splits[i] for i in before} == before
    assert done.store.attributes["split"]["seed"] == 5


def test_a_conversion_does_not_take_an_append_for_its_own(
    store: Path, more: Path, tmp_path: Path
) -> None:
    cut_short(more, store)
    again = write_gmrp(tmp_path / "again", 3)
    nimprep.convert(again, store, overwrite=True, shard_length=2)
    assert nimprep.open_store(store).ids == ("000000", "000001", "000002")
    assert {p.name for p in tmp_path.iterdir()} == {"a", "again", "b", "s.zarr"}


def test_an_append_leaves_a_conversion_that_was_cut_short(
    store: Path, more: Path, appended: dict[str, bytes], tmp_path: Path
) -> None:
    again = write_gmrp(tmp_path / "again", 9)
    whole = damage(again / "label" / "000008.png")
    options = {"overwrite": True, "shard_length": 2, "workers": 1}
    with pytest.raises(DecodeError, match="000008"):
        nimprep.convert(again, store, **options)
    nimprep.append_frames(more, store)
    assert contents(store) == appended
    (again / "label" / "000008.png").write_bytes(whole)
    steps = []

    def progress(step: str, frames: int):  # type: ignore[no-untyped-def]
        steps.append(step)
        return lambda: None

    nimprep.convert(again, store, progress=progress, **options)
    assert steps == ["going on converting"]
    assert {p.name for p in tmp_path.iterdir()} == {"a", "again", "b", "s.zarr"}


@pytest.fixture(scope="module")
def larger(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, bytes]]:
    """Return a source of 22 frames, one of them bad, a store of 9, and both together's files."""
    folder = tmp_path_factory.mktemp("larger")
    size = (120, 160)
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(write_gmrp(folder / "a", 9, size), folder / "old.zarr", shard_length=4)
    source = write_frames(folder / "b", range(9, 31), size)
    damage(source / "label" / "000018.png")
    shutil.copytree(folder / "old.zarr", folder / "whole.zarr")
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.append_frames(source, folder / "whole.zarr", on_error="skip")
    assert validate_store(folder / "whole.zarr", deep=True).problems == []
    return source, folder / "old.zarr", contents(folder / "whole.zarr")


def test_killed_at_random_calls_the_store_is_whole_and_ends_with_the_same_bytes(
    larger: tuple[Path, Path, dict[str, bytes]], mortals: Mortals, tmp_path: Path
) -> None:
    source, old, whole = larger
    before, rng, target = contents(old), random.Random(0), tmp_path / "s.zarr"
    shutil.copytree(old, target)
    assert mortals.run("append", source, target) == 0
    calls = mortals.calls
    assert calls is not None
    killed = halfway = runs = 0
    while killed < KILLS:
        if contents(target) == whole:
            shutil.rmtree(target)
            shutil.copytree(old, target)
        # From the start to after the end: encoding, joining, finishing, changing names.
        call = rng.randrange(calls)
        status = mortals.run("append", source, target, call=call)
        assert status in (0, -signal.SIGKILL)
        runs += 1
        assert runs <= 3 * KILLS, "expected most runs to be killed"
        killed += status != 0
        now = contents(target)
        assert now in (before, whole), f"killed at call {call} of {calls}"
        halfway += status != 0 and now == before
        if now == whole:
            assert mortals.run("append", source, target) == 0
            assert contents(target) == whole
            assert {p.name for p in tmp_path.iterdir()} == {"s.zarr"}
    assert mortals.run("append", source, target) == 0
    assert contents(target) == whole
    assert halfway >= KILLS // 3
    print(f"killed {killed} times, {halfway} of them halfway, in {runs} runs; all bytes the same")


@pytest.fixture
def tiny(tmp_path: Path) -> tuple[Path, Path]:
    """Return a source of 2 frames and a store of 3, of few files."""
    source = write_gmrp(tmp_path / "a", 3)
    nimprep.convert(source, tmp_path / "s.zarr", **SMALL)
    shutil.copytree(tmp_path / "s.zarr", tmp_path / "old.zarr")
    return write_frames(tmp_path / "b", range(3, 5)), tmp_path / "s.zarr"


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_killed_at_each_step_of_changing_names_no_store_is_lost(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path, atomic: bool
) -> None:
    source, store = tiny
    before, there = contents(store), {p.name for p in tmp_path.iterdir()}
    nimprep.append_frames(source, store)
    after = contents(store)
    found = []
    for step in range(20):
        shutil.rmtree(store)
        shutil.copytree(tmp_path / "old.zarr", store)
        status = mortals.run("append", source, store, step=step, atomic=atomic)
        if status == 0:
            break
        assert status == -signal.SIGKILL
        now = contents(store) if store.exists() else None
        assert now in (before, after, None)
        found.append("none" if now is None else "old" if now == before else "new")
        nimprep.append_frames(source, store, skip_existing=now == after)
        assert contents(store) == after
        assert {p.name for p in tmp_path.iterdir()} == there
    # Where names change at once there is no moment without a store.
    assert list(dict.fromkeys(found)) == (["old", "new"] if atomic else ["old", "none", "new"])
    assert contents(store) == after
    print(f"killed at each of {len(found)} steps")


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_killed_while_it_replaces_a_store_a_conversion_loses_neither(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path, atomic: bool
) -> None:
    _, store = tiny
    before, source = contents(store), write_gmrp(tmp_path / "again", 5)
    options = {**SMALL, "seed": 1}
    nimprep.convert(source, store, overwrite=True, **options)
    after = contents(store)
    found = []
    for step in range(20):
        shutil.rmtree(store)
        shutil.copytree(tmp_path / "old.zarr", store)
        fault = {"step": step, "atomic": atomic}
        status = mortals.run("convert", source, store, overwrite=True, **fault, **options)
        if status == 0:
            break
        assert status == -signal.SIGKILL
        found.append("new" if store.exists() else "none")
        if not store.exists():
            # Nobody may take the place for free: what was there comes back first.
            with pytest.raises(StoreError, match="--overwrite"):
                nimprep.convert(source, store, **options)
            assert contents(store) == before
        elif contents(store) == before:
            found[-1] = "old"
        assert contents(store) in (before, after)
        nimprep.convert(source, store, overwrite=True, **options)
        assert contents(store) == after
    assert list(dict.fromkeys(found)) == (["old", "new"] if atomic else ["old", "none", "new"])
    assert contents(store) == after


def killed_when_it_is_there(mortals: Mortals, source: Path, store: Path) -> dict[str, bytes]:
    """Append, and kill it at the first step after the new store has its name; return its files."""
    before, old = contents(store), store.with_name("old.zarr")
    for step in range(20):
        assert mortals.run("append", source, store, step=step) == -signal.SIGKILL
        if (now := contents(store)) != before:
            return now
        shutil.rmtree(store)
        shutil.rmtree(store.with_name(f".{store.name}.partial"))
        shutil.copytree(old, store)
    raise AssertionError("expected a change of names within so many steps")


@pytest.mark.parametrize("spoilt", [b"", b"joined 12", b"../a " + b"0" * 64, b"\xff\0\0"])
@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_a_note_of_changing_names_that_a_fault_spoilt_costs_no_store(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path, atomic: bool, spoilt: bytes
) -> None:
    source, store = tiny
    there = {p.name for p in tmp_path.iterdir()}
    nimprep.append_frames(source, store)
    after = contents(store)
    note, spoils = tmp_path / ".s.zarr.partial" / "append" / "publishing", 0
    for step in range(20):
        shutil.rmtree(store)
        shutil.copytree(tmp_path / "old.zarr", store)
        if mortals.run("append", source, store, step=step, atomic=atomic) == 0:
            break
        if note.exists():
            note.write_bytes(spoilt)
            spoils += 1
        nimprep.append_frames(source, store, skip_existing=True)
        assert contents(store) == after
        assert {p.name for p in tmp_path.iterdir()} == there
    assert spoils >= 3, "before, at and after the change of names"


def test_what_a_kill_at_the_last_step_left_is_done_and_said_so(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path
) -> None:
    source, store = tiny
    after = killed_when_it_is_there(mortals, source, store)
    assert (tmp_path / ".s.zarr.partial" / "append").is_dir()
    done = nimprep.append_frames(source, store)
    assert (len(done.ids), done.existing, len(done.store)) == (2, 0, 5)
    assert contents(store) == after
    assert not (tmp_path / ".s.zarr.partial").exists()
    with pytest.raises(StoreError, match="not in it yet"):
        nimprep.append_frames(source, store)


def test_a_kill_at_the_last_step_excuses_no_other_source(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path
) -> None:
    source, store = tiny
    after = killed_when_it_is_there(mortals, source, store)
    assert len(nimprep.open_store(store)) == 5
    with pytest.raises(StoreError, match="found '000000'"):
        nimprep.append_frames(tmp_path / "a", store)
    assert contents(store) == after
    assert mortals.run("append", source, store) == 0


def test_a_kill_at_the_last_step_excuses_no_source_that_changed(
    tiny: tuple[Path, Path], mortals: Mortals, tmp_path: Path
) -> None:
    source, store = tiny
    after = killed_when_it_is_there(mortals, source, store)
    shutil.copy(source / "rgb" / "000003.png", source / "rgb" / "000004.png")
    with pytest.raises(StoreError, match="found '000003'"):
        nimprep.append_frames(source, store)
    assert contents(store) == after
    later = write_frames(tmp_path / "c", range(5, 7))
    assert nimprep.append_frames(later, store).ids == ("000005", "000006")


def test_of_an_append_and_a_conversion_at_once_the_second_is_refused(
    larger: tuple[Path, Path, dict[str, bytes]], mortals: Mortals, tmp_path: Path
) -> None:
    source, old, whole = larger
    shutil.copytree(old, tmp_path / "s.zarr")
    mortals.start("append", source, tmp_path / "s.zarr", hold=True)
    with pytest.raises(StoreError, match="found one at work"):
        nimprep.append_frames(source, tmp_path / "s.zarr")
    with pytest.raises(StoreError, match="found one at work"):
        nimprep.convert(source, tmp_path / "s.zarr", overwrite=True)
    assert mortals.wait() == 0
    assert contents(tmp_path / "s.zarr") == whole


def test_ctrl_c_says_how_to_go_on_and_exits_130(
    larger: tuple[Path, Path, dict[str, bytes]], tmp_path: Path, processes: Processes
) -> None:
    source, old, _ = larger
    shutil.copytree(old, tmp_path / "s.zarr")
    options = ("--workers", "1", "--on-error", "skip")
    with held(processes, RECORD, "append", *options, source, tmp_path / "s.zarr") as process:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    assert "interrupted; " in errors
    assert "of 22 frames are kept: the same command goes on from them" in errors
    assert contents(tmp_path / "s.zarr") == contents(old)
