"""Wherever a command is called from, and however its paths are spelt, it works or says why not."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import Result

from nimprep.report.server import ViewServer
from tests.cli.world import EVERY, NEW, Call, make_world, run

each = pytest.mark.parametrize("call", EVERY, ids=str)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_world(tmp_path_factory.mktemp("directory") / "world")


@pytest.fixture
def world(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)  # brought back at the end, from wherever that is
    return Path(shutil.copytree(made, tmp_path / "world"))


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nimprep.cli.synth.DEMO_FRAMES", 1)
    monkeypatch.setattr(ViewServer, "run", lambda self: None)


def works_or_says_why_not(result: Result) -> bool:
    """Return whether it worked; fail for a traceback, or for an error of several lines."""
    assert result.exception is None or isinstance(result.exception, SystemExit), result.output
    if result.exit_code:
        assert result.exit_code == 1
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1
    return result.exit_code == 0


@each
def test_relative_paths_work(world: Path, call: Call) -> None:
    os.chdir(world)
    assert works_or_says_why_not(run(call.at(Path())))


@each
def test_paths_may_end_in_a_slash_and_hold_dots(world: Path, call: Call) -> None:
    os.chdir(world / "raw")
    spelt = [
        f"../raw/./../{a}{'/' if (world / a).is_dir() or call.writes != 'file' else ''}"
        if isinstance(a, Path) and not (world / a).is_file()
        else f"../{a}"
        if isinstance(a, Path)
        else a
        for a in call.arguments
    ]
    assert works_or_says_why_not(run(spelt))


def spelt_from(call: Call, world: Path, here: Path) -> list[str]:
    """Return the arguments as they are spelt by somebody who works in a folder."""
    return [os.path.relpath(world / a, here) if isinstance(a, Path) else a for a in call.arguments]


@each
def test_every_folder_of_a_call_may_be_where_it_is_called_from(world: Path, call: Call) -> None:
    """Call it from each folder that it names, as ".", and from a folder within, as ".."."""
    shutil.copytree(world, world.parent / "again")
    for named in [a for a in call.arguments if isinstance(a, Path)]:
        for deep in (False, True):
            if (world / named).is_file():
                continue
            shutil.rmtree(world)
            shutil.copytree(world.parent / "again", world)
            below = "rgb" if named == Path("s.zarr") else "deep"
            here = world / named / below if deep else world / named
            here.mkdir(parents=True, exist_ok=True)
            os.chdir(here)
            worked = works_or_says_why_not(run(spelt_from(call, world, here)))
            # Whoever called it is still in a folder that is there.
            assert Path.cwd() == here
            assert os.path.samefile(".", here)  # noqa: PTH121
            grows = call.arguments[0] == "append" and named == Path("s.zarr")
            taken = {"file": True, "store": True, "folder": deep}.get(call.writes, False)
            assert worked != (grows or (named == NEW and taken)), (named, deep)
            os.chdir(world.parent)


def test_a_store_is_not_pulled_away_from_under_whoever_works_in_it(world: Path) -> None:
    os.chdir(world / "s.zarr")
    result = run(["append", "../more", ".", "--description", "../raw.json"])
    assert result.exit_code == 1
    assert result.stderr == (
        f"error: .: expected to be called from outside of the folder that is replaced, found the "
        f"working directory {world / 's.zarr'}; change to another first\n"
    )
    os.chdir(world)
    assert run(["append", "more", "s.zarr/.", "--description", "raw.json"]).exit_code == 0
    (world / "link").symlink_to("t.zarr")
    os.chdir(world / "link")
    result = run(["convert", "../raw", "../t.zarr", "--overwrite", "--description", "../raw.json"])
    assert "expected to be called from outside" in result.stderr


@each
def test_a_directory_that_was_deleted_is_told_in_one_line(world: Path, call: Call) -> None:
    here = world / "gone"
    here.mkdir()
    os.chdir(here)
    here.rmdir()
    needed = any(isinstance(argument, Path) for argument in call.arguments)
    works = works_or_says_why_not(run(call.at(Path())))
    # What is compiled already asks for no folder; what is not does, which chance decides here.
    assert works != needed or call.arguments == ("warm-up",)
    works_or_says_why_not(run(call.at(Path(".."))))  # where that leads, only the system knows
    assert works_or_says_why_not(run(call.at(world)))


def test_the_program_starts_where_the_directory_was_deleted(world: Path) -> None:
    here = world / "gone"
    script = f"cd {here} && rmdir {here} && exec {sys.executable} -m nimprep"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    for arguments, code in ((f"info {world / 's.zarr'}", 0), ("info s.zarr", 1), ("demo", 1)):
        here.mkdir(exist_ok=True)
        done = subprocess.run(
            ["sh", "-c", f"{script} {arguments}"],
            capture_output=True,
            text=True,
            check=False,
            env=environment,
        )
        assert done.returncode == code, done.stderr
        assert done.stderr.count("\n") == code
