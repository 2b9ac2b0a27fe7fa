"""Commands that change a store keep each other out, on every kind of file system."""

import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store import lock
from nimprep.store import resplit as resplit_module
from nimprep.store.lock import MARKER, changing, hidden_folder, locked_folder
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.conversion.test_append import write_frames
from tests.fakes import contents, write_gmrp
from tests.processes import Processes, same_code

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

OPTIONS = {"shard_length": 2, "modalities": ("depth",)}

Meanwhile = Callable[[], None]


class Change:
    """Change a store by one command, and let something happen while it is at work."""

    def __init__(self, folder: Path) -> None:
        self.store = folder / "s.zarr"
        self.source = folder / "a"
        self.more = folder / "b"
        self.other = folder / "other.zarr"

    def convert(self, meanwhile: Meanwhile) -> None:
        options = {**OPTIONS, "seed": 1, "overwrite": True}
        nimprep.convert(self.source, self.store, progress=_during(meanwhile), **options)

    def append(self, meanwhile: Meanwhile) -> None:
        nimprep.append_frames(self.more, self.store, progress=_during(meanwhile))

    def merge(self, meanwhile: Meanwhile) -> None:
        nimprep.merge_stores([self.other], self.store, overwrite=True, progress=_during(meanwhile))

    def split(self, meanwhile: Meanwhile) -> None:
        assign = resplit_module.assign_splits

        def assign_splits(*arguments: object) -> object:
            meanwhile()
            return assign(*arguments)  # type: ignore[arg-type]

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(resplit_module, "assign_splits", assign_splits)
            resplit(self.store, seed=3)


COMMANDS = ["convert", "append", "merge", "split"]


def _during(meanwhile: Meanwhile) -> Callable[[str, int], Meanwhile]:
    def progress(step: str, frames: int) -> Meanwhile:
        meanwhile()
        return lambda: None

    return progress


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prepared")
    nimprep.convert(write_gmrp(folder / "a", 3), folder / "s.zarr", **OPTIONS)
    more = write_frames(folder / "b", range(3, 5))
    nimprep.convert(more, folder / "other.zarr", **OPTIONS)
    return folder


@pytest.fixture
def change(prepared: Path, tmp_path: Path) -> Change:
    return Change(shutil.copytree(prepared, tmp_path, dirs_exist_ok=True))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("second", COMMANDS)
@pytest.mark.parametrize("first", COMMANDS)
def test_while_a_command_changes_a_store_every_other_is_refused(
    change: Change, tmp_path: Path, first: str, second: str
) -> None:
    before = names(tmp_path)
    shutil.copytree(change.store, tmp_path / "old.zarr")
    getattr(change, first)(lambda: None)
    undisturbed = contents(change.store)
    shutil.rmtree(change.store)
    (tmp_path / "old.zarr").rename(change.store)
    refused = []

    def meanwhile() -> None:
        with pytest.raises(StoreError, match="expected nobody else to change it") as caught:
            getattr(change, second)(lambda: None)
        refused.append(str(caught.value))

    getattr(change, first)(meanwhile)
    assert refused
    assert contents(change.store) == undisturbed
    assert names(tmp_path) == before


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nimprep", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_refused_split_is_one_line_and_exit_1(change: Change, tmp_path: Path) -> None:
    before = contents(change.store)
    (tmp_path / "link.zarr").symlink_to(change.store)
    with changing(change.store):
        for store in (change.store, tmp_path / "link.zarr"):
            done = run("split", store, "--seed", 1)
            assert done.returncode == 1
            words = "expected nobody else to change it, found one at work; wait for it"
            assert (words in done.stderr, done.stderr.count("\n")) == (True, 1)
    assert contents(change.store) == before
    assert run("split", tmp_path / "link.zarr", "--seed", 1).returncode == 0


def test_what_is_no_store_gets_no_lock(tmp_path: Path) -> None:
    for place in (tmp_path / "nothing" / "s.zarr", tmp_path):
        with pytest.raises(StoreError, match="expected a nimprep store"):
            resplit(place, seed=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["append", "merge"])
def test_a_store_that_somebody_else_changed_meanwhile_is_left_to_him(
    change: Change, tmp_path: Path, command: str
) -> None:
    changed = change.store if command == "append" else change.other
    root = changed / "zarr.json"
    before = contents(change.store)

    def meanwhile() -> None:
        if root.read_bytes().endswith(b"}\n"):
            root.write_bytes(root.read_bytes() + b"\n")  # as by a program that takes no lock

    words = "expected a store that stays as it is meanwhile, found that it was changed; nothing was"
    with pytest.raises(StoreError, match=words):
        getattr(change, command)(meanwhile)
    now = contents(change.store)
    assert now.pop("zarr.json").rstrip() == before.pop("zarr.json").rstrip()
    assert now == before
    getattr(change, command)(lambda: None)
    assert len(nimprep.open_store(change.store)) == (5 if command == "append" else 2)
    assert validate_store(change.store, deep=True).problems == []


@pytest.fixture(params=["ENOLCK", "EOPNOTSUPP", "ENOSYS"])
def lockless(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Let no file be locked, as on file systems that cannot; return what they say."""
    number = getattr(errno, request.param)

    def flock(descriptor: int, operation: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", flock)
    # Nobody here leaves while another waits.
    monkeypatch.setattr(lock, "_MOMENT_S", 0.003)
    return os.strerror(number)


@pytest.mark.parametrize("command", COMMANDS)
def test_without_locks_a_file_stands_for_one_and_that_is_said(
    change: Change, tmp_path: Path, lockless: str, command: str
) -> None:
    before, held = names(tmp_path), hidden_folder(change.store) / MARKER

    def meanwhile() -> None:
        assert held.exists()
        words = f"found one at work, process {os.getpid()} on .*; wait for it, or delete {held} if"
        with (
            pytest.warns(UserWarning, match="its file system has no locks"),
            pytest.raises(StoreError, match=words),
        ):
            change.split(lambda: None)

    words = rf"s.zarr: its file system has no locks \({lockless}\); the file {held} stands for"
    with pytest.warns(UserWarning, match=words):
        getattr(change, command)(meanwhile)
    assert validate_store(change.store, deep=True).problems == []
    assert names(tmp_path) == before


HOLD = """
import fcntl, os, sys, warnings
from pathlib import Path
from nimprep.store.lock import locked_folder

def flock(descriptor, operation):
    raise OSError(37, os.strerror(37))

fcntl.flock = flock
warnings.simplefilter("ignore")
with locked_folder(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.filterwarnings("ignore:.*no locks:UserWarning")
def test_what_a_killed_process_left_instead_of_a_lock_keeps_nobody_out(
    change: Change, tmp_path: Path, processes: Processes
) -> None:
    before = names(tmp_path)
    process = processes.start(
        [sys.executable, "-c", HOLD, change.store],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=same_code(),
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    # Somebody who has locks sees it too.
    with pytest.raises(StoreError, match=f"found one at work, process {process.pid} on"):
        change.split(lambda: None)
    process.kill()
    assert process.wait() == -signal.SIGKILL
    assert (hidden_folder(change.store) / MARKER).exists()
    change.split(lambda: None)
    assert nimprep.open_store(change.store).attributes["split"]["seed"] == 3
    assert names(tmp_path) == before


@pytest.mark.filterwarnings("ignore:.*no locks:UserWarning")
@pytest.mark.parametrize("said", ["17\nanother-machine\n", "", "\0\0", "17\n"])
def test_what_another_machine_left_instead_of_a_lock_is_said_how_to_delete(
    change: Change, lockless: str, said: str
) -> None:
    held = hidden_folder(change.store) / MARKER
    held.parent.mkdir()
    held.write_text(said)
    who = ", process 17 on another-machine" if "another" in said else ""
    with pytest.raises(StoreError, match=f"at work{who}; wait for it, or delete {held} if it has"):
        change.split(lambda: None)
    held.unlink()
    change.split(lambda: None)
    assert not held.parent.exists()


def test_a_lock_of_one_store_is_none_of_its_neighbours(tmp_path: Path) -> None:
    with locked_folder(tmp_path / "a.zarr"), locked_folder(tmp_path / "b.zarr"):
        assert names(tmp_path) == {".a.zarr.partial", ".b.zarr.partial"}
    assert names(tmp_path) == set()
