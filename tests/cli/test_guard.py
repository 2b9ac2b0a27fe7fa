"""Nothing of the user's is destroyed: commands write what they were asked to, and nothing else."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import click
import pytest
from click.testing import Result

from nimprep.report.server import ViewServer
from tests.cli.world import CALLS, EVERY, READ, RUN, Call, commands, make_world, run
from tests.export.test_places import files_of_at_most

Snapshot = dict[str, tuple[int, bytes]]


def calls(*kinds: str) -> pytest.MarkDecorator:
    """Run a test with every call that writes something of these kinds."""
    found = [call for call in EVERY if call.writes in kinds]
    return pytest.mark.parametrize("call", found, ids=str)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_world(tmp_path_factory.mktemp("guard") / "world")


@pytest.fixture
def world(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "world", symlinks=True))


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nimprep.cli.synth.DEMO_FRAMES", 1)
    monkeypatch.setattr(ViewServer, "run", lambda self: None)


def snapshot(folder: Path) -> Snapshot:
    """Return mode and contents of everything below a folder, hidden names included."""
    found = {}
    for path in folder.rglob("*"):
        mode = path.lstat().st_mode
        data = os.fsencode(path.readlink()) if stat.S_ISLNK(mode) else b""
        found[str(path.relative_to(folder))] = (
            mode,
            path.read_bytes() if stat.S_ISREG(mode) else data,
        )
    return found


def refused(result: Result, *words: str) -> None:
    assert result.exit_code == 1, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for word in words:
        assert word in result.stderr


def test_every_command_and_all_that_it_writes_is_tried() -> None:
    """Fail for a new command, or a new parameter for a path, that no test here looks at."""
    assert CALLS.keys() == {name for name, _ in commands()}
    for name, command in commands():
        paths = {
            parameter.name
            for parameter in command.params
            if isinstance(parameter, click.Argument) or isinstance(parameter.type, click.Path)
        }
        written = {call.parameter for call in CALLS[name] if call.writes}
        assert paths - READ == written, name


@pytest.mark.parametrize("call", EVERY, ids=str)
def test_a_command_changes_what_it_was_asked_to_alone(world: Path, call: Call) -> None:
    before = snapshot(world)
    result = run(call.at(world))
    assert result.exit_code == 0, result.output
    after = snapshot(world)
    changed = {p for p in before.keys() | after.keys() if before.get(p) != after.get(p)}
    places = {Path(p).parts[0] for p in changed}
    in_place = {"append": {"s.zarr"}, "split": {"s.zarr"} if "--seed" in call.arguments else set()}
    assert places == ({"new"} if call.writes else in_place.get(str(call.arguments[0]), set()))


def stores_and_sources(world: Path, call: Call) -> list[Path]:
    """Return the stores of a world, and the folders that a call reads, but a run's."""
    read = [world / a for a in call.arguments if isinstance(a, Path) and a != RUN]
    folders = [path for path in read if path.is_dir()]
    return [world / "s.zarr", world / "t.zarr", *folders]


@calls("file", "files", "folder", "store")
def test_nothing_is_written_into_a_store_or_a_source(world: Path, call: Call) -> None:
    folders = stores_and_sources(world, call)
    for number, folder in enumerate(folders):
        (world / f"link{number}").symlink_to(folder)
    before = snapshot(world)
    for number, folder in enumerate(folders):
        for place in (folder, world / f"link{number}"):
            for out in (place / "new", place / "rgb" / "new", place / "a" / ".." / "new"):
                refused(run(call.at(world, out)), "expected")
    assert snapshot(world) == before


OWN = ("zarr.json", "rgb/zarr.json", "rgb/c/0/0/0/0", "split/c/0")


@calls("file")
def test_no_file_of_a_store_is_replaced(world: Path, call: Call) -> None:
    for name in OWN:
        (world / f"link-{name.replace('/', '-')}").symlink_to(world / "t.zarr" / name)
    before = snapshot(world)
    for name in OWN:
        for out in (world / "s.zarr" / name, world / "t.zarr" / name):
            refused(
                run([*call.at(world, out), "--overwrite"]), str(out), "expected a place outside"
            )
        out = world / f"link-{name.replace('/', '-')}"
        refused(run([*call.at(world, out), "--overwrite"]), str(out), "expected a place outside")
    assert snapshot(world) == before


@calls("file")
def test_a_second_name_of_a_shard_leaves_the_shard_as_it_is(world: Path, call: Call) -> None:
    shard = world / "t.zarr" / "rgb" / "c" / "0" / "0" / "0" / "0"
    before = shard.read_bytes()
    (world / "new").hardlink_to(shard)
    refused(run(call.at(world)))
    assert run([*call.at(world), "--overwrite"]).exit_code == 0
    assert shard.read_bytes() == before
    assert (world / "new").read_bytes() != before


@calls("file")
def test_a_file_that_is_there_is_replaced_only_when_asked(world: Path, call: Call) -> None:
    new = world / "new"
    new.write_bytes(b"mine")
    new.chmod(0o640)
    before = snapshot(world)
    refused(run(call.at(world)), f"{new}: expected a new file, found one there", "--overwrite")
    assert snapshot(world) == before
    assert run([*call.at(world), "--overwrite"]).exit_code == 0
    after = snapshot(world)
    assert len(after.pop("new")[1]) > 100
    del before["new"]
    assert after == before
    assert stat.S_IMODE(new.stat().st_mode) == 0o640


@calls("file")
def test_a_link_is_replaced_only_when_asked_and_what_it_leads_to_stays(
    world: Path, call: Call
) -> None:
    new, mine = world / "new", world / "mine"
    new.symlink_to(mine)
    refused(run(call.at(world)), "--overwrite")
    assert not mine.exists()
    mine.write_bytes(b"mine")
    refused(run(call.at(world)), "--overwrite")
    assert new.is_symlink()
    assert run([*call.at(world), "--overwrite"]).exit_code == 0
    assert not new.is_symlink()
    assert mine.read_bytes() == b"mine"


@calls("file")
def test_an_old_file_stays_where_the_new_one_cannot_be_written(world: Path, call: Call) -> None:
    (world / "new").write_bytes(b"mine")
    before = snapshot(world)
    with files_of_at_most(50):
        result = run([*call.at(world), "--overwrite"])
    refused(result, f"{world / 'new'}: expected to write it, found ")
    assert snapshot(world) == before


@calls("file")
def test_a_folder_or_a_device_is_no_file_to_replace(world: Path, call: Call) -> None:
    (world / "new").mkdir()
    for more in ([], ["--overwrite"]):
        refused(run([*call.at(world), *more]), "expected a file to write, found a folder")
    (world / "new").rmdir()
    (world / "new").symlink_to("/proc/self/exe")
    for more in ([], ["--overwrite"]):
        refused(run([*call.at(world), *more]), "found a link to an open one")
    assert (world / "new").is_symlink()
    # What has no contents cannot lose them.
    assert run(call.at(world, Path("/dev/null"))).exit_code == 0
    assert Path("/dev/null").is_char_device()


@calls("files")
def test_files_in_a_folder_are_replaced_only_when_asked(world: Path, call: Call) -> None:
    new, mine = world / "new", world / "mine"
    assert run(call.at(world)).exit_code == 0
    made = {path: path.read_bytes() for path in new.rglob("*") if path.is_file()}
    for path in made:
        shutil.rmtree(new)
        path.parent.mkdir(parents=True)
        (new / "notes").write_bytes(b"mine")
        for there in (
            path.write_bytes,
            lambda data, p=path: (mine.write_bytes(data), p.symlink_to(mine)),
        ):
            path.unlink(missing_ok=True)
            there(b"mine")
            before = snapshot(world)
            refused(run(call.at(world)), f"{path}: expected a new file", "--overwrite")
            assert snapshot(world) == before
        assert run([*call.at(world), "--overwrite"]).exit_code == 0
        found = {p: p.read_bytes() for p in new.rglob("*") if p.is_file() and not p.is_symlink()}
        assert found == {**made, new / "notes": b"mine"}
        assert mine.read_bytes() == b"mine"


@calls("files")
def test_an_old_file_in_a_folder_stays_where_the_new_one_cannot_be_written(
    world: Path, call: Call
) -> None:
    assert run(call.at(world)).exit_code == 0
    before = snapshot(world)
    with files_of_at_most(50):
        refused(run([*call.at(world), "--overwrite"]), "expected to write it, found ")
    assert snapshot(world) == before


@calls("folder", "store")
def test_a_place_that_is_taken_is_left_alone(world: Path, call: Call) -> None:
    new, mine = world / "new", world / "mine"
    asked = ["--overwrite"] if call.writes == "store" else []
    mine.mkdir()
    (mine / "notes").write_bytes(b"mine")
    for take in (
        lambda: new.write_bytes(b"mine"),
        lambda: new.symlink_to(mine),
        lambda: new.symlink_to("nowhere"),
        lambda: mine.rename(new),
    ):
        new.unlink(missing_ok=True)
        take()
        before = snapshot(world)
        for more in ([], asked):
            refused(run([*call.at(world), *more]), ": expected ")
            assert snapshot(world) == before


@calls("folder", "store")
def test_a_folder_that_cannot_be_written_whole_is_not_there(world: Path, call: Call) -> None:
    before = snapshot(world)
    with files_of_at_most(50):
        refused(run(call.at(world)))
    after = snapshot(world)
    # What was begun of a store, hidden beside it, is gone on with.
    assert {path for path in after if not path.startswith(".new.partial")} == before.keys()
