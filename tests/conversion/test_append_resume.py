"""Appends that are cut short, for real, at any moment: the store is whole, and they go on."""

import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import DecodeError, StoreError
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.conversion.test_append import damage, write_frames
from tests.fakes import contents, write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

KILLS = int(os.environ.get("NIMPREP_KILLS", "6"))

SERVER = multiprocessing.get_context("forkserver")
"""Processes that can be killed, without the second that starting Python anew would take."""
SERVER.set_forkserver_preload(["nimprep.conversion.append", "nimprep.conversion.run", "zarr"])


def append_quietly(source: Path, store: Path) -> None:
    warnings.simplefilter("ignore")
    nimprep.append_frames(source, store, workers=2, skip_existing=True, on_error="skip")


def die_at(step: int, atomic: bool) -> None:
    """Kill this process at the so-manieth change of names or removal once a store is published."""
    import nimprep.store.writer as writer
    from nimprep.conversion.workspace import LocalWorkspace

    steps = iter(range(step, -1, -1))

    def dying(function: Callable[..., object]) -> Callable[..., object]:
        def run(*arguments: object, **named: object) -> object:
            if next(steps) == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **named)

        return run

    publish = LocalWorkspace.publish

    def publish_and_die(self: LocalWorkspace, *arguments: object) -> None:
        exchange = writer.exchange if atomic else lambda a, b: False
        writer.exchange = dying(exchange) if atomic else exchange  # type: ignore[assignment]
        for name in ("replace", "unlink"):
            setattr(Path, name, dying(getattr(Path, name)))
        writer.sync_folder = dying(writer.sync_folder)  # type: ignore[assignment]
        shutil.rmtree = dying(shutil.rmtree)  # type: ignore[assignment]
        publish(self, *arguments)  # type: ignore[arg-type]

    LocalWorkspace.publish = publish_and_die  # type: ignore[method-assign, assignment]


def append_and_die(source: Path, store: Path, step: int, atomic: bool) -> None:
    die_at(step, atomic)
    append_quietly(source, store)


def convert_and_die(source: Path, store: Path, step: int, atomic: bool) -> None:
    die_at(step, atomic)
    warnings.simplefilter("ignore")
    nimprep.convert(source, store, shard_length=2, seed=1, overwrite=True)


def start(target: Callable[..., None], *arguments: object) -> ForkServerProcess:
    process = SERVER.Process(target=target, args=arguments)
    process.start()
    return process


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
    """Return a source of 43 frames, one of them bad, a store of 17, and both together's files."""
    folder = tmp_path_factory.mktemp("larger")
    size = (120, 160)
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(write_gmrp(folder / "a", 17, size), folder / "old.zarr", shard_length=2)
    source = write_frames(folder / "b", range(17, 60), size)
    damage(source / "label" / "000031.png")
    shutil.copytree(folder / "old.zarr", folder / "whole.zarr")
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.append_frames(source, folder / "whole.zarr", on_error="skip")
    assert validate_store(folder / "whole.zarr", deep=True).problems == []
    return source, folder / "old.zarr", contents(folder / "whole.zarr")


def test_killed_at_random_moments_the_store_is_whole_and_ends_with_the_same_bytes(
    larger: tuple[Path, Path, dict[str, bytes]], tmp_path: Path
) -> None:
    source, old, whole = larger
    before, rng, target = contents(old), random.Random(0), tmp_path / "s.zarr"
    shutil.copytree(old, target)
    units = tmp_path / ".s.zarr.partial" / "append" / "journal" / "units"
    killed = halfway = runs = 0
    while killed < KILLS:
        process = start(append_quietly, source, target)
        runs += 1
        known = len(list(units.glob("*.json")))
        while len(list(units.glob("*.json"))) <= known and process.is_alive():
            time.sleep(0.001)
        # From the first shard to after the end: encoding, joining, finishing, changing names.
        process.join(rng.uniform(0, 0.8))
        if process.is_alive():
            process.kill()
            process.join()
            killed += 1
        else:
            assert process.exitcode == 0
        now = contents(target)
        assert now in (before, whole)
        halfway += now == before
        if now == whole:
            append_quietly(source, target)
            assert contents(target) == whole
            assert {p.name for p in tmp_path.iterdir()} == {"s.zarr"}
            shutil.rmtree(target)
            shutil.copytree(old, target)
    append_quietly(source, target)
    assert contents(target) == whole
    print(f"killed {killed} times, {halfway} of them halfway, in {runs} runs; all bytes the same")


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_killed_at_each_step_of_changing_names_no_store_is_lost(
    store: Path, more: Path, appended: dict[str, bytes], tmp_path: Path, atomic: bool
) -> None:
    before = contents(store)
    shutil.copytree(store, tmp_path / "old.zarr")
    found = []
    for step in range(20):
        process = start(append_and_die, more, store, step, atomic)
        process.join()
        if process.exitcode == 0:
            break
        assert process.exitcode == -signal.SIGKILL
        now = contents(store) if store.exists() else None
        assert now in (before, appended, None)
        found.append("none" if now is None else "old" if now == before else "new")
        nimprep.append_frames(more, store, skip_existing=now == appended)
        assert contents(store) == appended
        assert {p.name for p in tmp_path.iterdir()} == {"a", "b", "old.zarr", "s.zarr"}
        shutil.rmtree(store)
        shutil.copytree(tmp_path / "old.zarr", store)
    # Where names change at once there is no moment without a store.
    assert list(dict.fromkeys(found)) == ["old", "new"] if atomic else ["old", "none", "new"]
    assert contents(store) == appended


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_killed_while_it_replaces_a_store_a_conversion_loses_neither(
    store: Path, tmp_path: Path, atomic: bool
) -> None:
    before = contents(store)
    shutil.copytree(store, tmp_path / "old.zarr")
    source = write_gmrp(tmp_path / "again", 7)
    nimprep.convert(source, tmp_path / "new.zarr", shard_length=2, seed=1)
    after = contents(tmp_path / "new.zarr")
    for step in range(20):
        process = start(convert_and_die, source, store, step, atomic)
        process.join()
        if process.exitcode == 0:
            break
        if not store.exists():
            # Nobody may take the place for free: what was there comes back first.
            with pytest.raises(StoreError, match="--overwrite"):
                nimprep.convert(source, store, shard_length=2, seed=1)
            assert contents(store) == before
        assert contents(store) in (before, after)
        nimprep.convert(source, store, shard_length=2, seed=1, overwrite=True)
        assert contents(store) == after
        shutil.rmtree(store)
        shutil.copytree(tmp_path / "old.zarr", store)
    assert contents(store) == after


def test_what_a_kill_at_the_last_step_left_is_done_and_said_so(
    store: Path, more: Path, appended: dict[str, bytes], tmp_path: Path
) -> None:
    # The third step follows the change of names: note, names, the folder's own.
    process = start(append_and_die, more, store, 2, True)
    process.join()
    assert contents(store) == appended
    assert (tmp_path / ".s.zarr.partial" / "append").is_dir()
    done = nimprep.append_frames(more, store)
    assert (len(done.ids), done.existing, len(done.store)) == (6, 0, 11)
    assert contents(store) == appended
    assert not (tmp_path / ".s.zarr.partial").exists()
    with pytest.raises(StoreError, match="not in it yet"):
        nimprep.append_frames(more, store)


def test_a_kill_at_the_last_step_excuses_no_other_source(
    store: Path, more: Path, appended: dict[str, bytes], tmp_path: Path
) -> None:
    process = start(append_and_die, more, store, 2, True)
    process.join()
    with pytest.raises(StoreError, match="found '000000'"):
        nimprep.append_frames(tmp_path / "a", store)
    assert contents(store) == appended
    later = write_frames(tmp_path / "c", range(11, 13))
    assert nimprep.append_frames(later, store).ids == ("000011", "000012")


def test_of_an_append_and_a_conversion_at_once_the_second_is_refused(
    larger: tuple[Path, Path, dict[str, bytes]], tmp_path: Path
) -> None:
    source, old, whole = larger
    shutil.copytree(old, tmp_path / "s.zarr")
    first = start(append_quietly, source, tmp_path / "s.zarr")
    lock = tmp_path / ".s.zarr.partial" / "append" / "journal" / "units"
    while not lock.exists() and first.is_alive():
        time.sleep(0.001)
    with pytest.raises(StoreError, match="found one at work"):
        nimprep.append_frames(source, tmp_path / "s.zarr")
    with pytest.raises(StoreError, match="found one at work"):
        nimprep.convert(source, tmp_path / "s.zarr", overwrite=True)
    first.join()
    assert contents(tmp_path / "s.zarr") == whole


def test_ctrl_c_says_how_to_go_on_and_exits_130(
    larger: tuple[Path, Path, dict[str, bytes]], tmp_path: Path
) -> None:
    source, old, _ = larger
    shutil.copytree(old, tmp_path / "s.zarr")
    command = [sys.executable, "-m", "nimprep", "append", "--workers", "1", "--on-error", "skip"]
    process = subprocess.Popen(
        [*command, str(source), str(tmp_path / "s.zarr")], stderr=subprocess.PIPE, text=True
    )
    units = tmp_path / ".s.zarr.partial" / "append" / "journal" / "units"
    while not list(units.glob("*.json")) and process.poll() is None:
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted; " in errors
    assert "of 43 frames are kept: the same command goes on from them" in errors
    assert contents(tmp_path / "s.zarr") == contents(old)
