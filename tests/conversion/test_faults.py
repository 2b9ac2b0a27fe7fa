"""Disks that are full or may not be written to, for real: a small file system is mounted."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store.validate import validate_store
from tests.conversion.test_append import write_frames
from tests.fakes import contents, write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

SIZE = (120, 160)

Remount = Callable[[str], None]


def mount(*arguments: str) -> bool:
    """Mount something; return whether this process may."""
    try:
        done = subprocess.run(["mount", *arguments], capture_output=True, check=False)
    except OSError:
        return False
    return done.returncode == 0


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[tuple[Path, Remount]]:
    """Return a disk of 1 MB, and what mounts it with other options."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if sys.platform != "linux" or os.geteuid() != 0:
        pytest.skip("only root may mount a small disk, and only Linux has tmpfs")
    if not mount("-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)):
        pytest.skip("this machine lets nobody mount a small disk")

    def remount(options: str) -> None:
        assert mount("-o", f"remount,{options}", str(folder))

    yield folder, remount
    subprocess.run(["umount", "-l", str(folder)], check=True)


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nimprep", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def assert_one_line(done: subprocess.CompletedProcess[str], words: str) -> None:
    """Assert that a command failed as bad data does, and said why."""
    assert done.returncode == 1, done.stderr
    errors = [line for line in done.stderr.splitlines() if not line.startswith("warning:")]
    assert len(errors) == 1, done.stderr
    assert errors[0].startswith("error: ")
    assert words in errors[0]
    assert done.stdout == ""


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return two sources of 8 and 12 frames, some 3 MB in a store."""
    folder = tmp_path_factory.mktemp("parts")
    return write_gmrp(folder / "a", 8, SIZE), write_frames(folder / "b", range(8, 20), SIZE)


def until_it_fits(task: Callable[[], object], remount: Remount, kilobytes: int) -> int:
    """Give a disk more room, bit by bit, until a task fits; return how often it did not."""
    for faults in range(100):
        # Another step each time: encoding, joining, tables, the root, the change of names.
        remount(f"size={kilobytes + 80 * faults}k")
        try:
            task()
        except StoreError as error:
            message = str(error)
        else:
            return faults
        assert "No space left on device" in message
        assert "\n" not in message
    raise AssertionError(f"never fitted: {message}")


def test_a_conversion_goes_on_when_a_full_disk_has_room_again(
    disk: tuple[Path, Remount], parts: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, remount = disk
    options = ("--shard-length", "2", "--workers", "2")
    nimprep.convert(parts[0], tmp_path / "whole.zarr", shard_length=2)
    done = run("convert", parts[0], folder / "s.zarr", *options)
    assert_one_line(done, "No space left on device")
    assert "of 8 frames are kept: the same command goes on from them" in done.stderr
    assert not (folder / "s.zarr").exists()

    def convert() -> None:
        nimprep.convert(parts[0], folder / "s.zarr", shard_length=2)

    faults = until_it_fits(convert, remount, 1024)
    assert contents(folder / "s.zarr") == contents(tmp_path / "whole.zarr")
    assert [path.name for path in folder.iterdir()] == ["s.zarr"]
    print(f"full {faults + 1} times, at the end the same bytes")


def test_an_append_goes_on_when_a_full_disk_has_room_again(
    disk: tuple[Path, Remount], parts: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, remount = disk
    nimprep.convert(parts[0], tmp_path / "old.zarr", shard_length=3)
    shutil.copytree(tmp_path / "old.zarr", tmp_path / "whole.zarr")
    nimprep.append_frames(parts[1], tmp_path / "whole.zarr")
    remount("size=2500k")
    shutil.copytree(tmp_path / "old.zarr", folder / "s.zarr")
    before = contents(folder / "s.zarr")
    done = run("append", parts[1], folder / "s.zarr")
    assert_one_line(done, "No space left on device")
    assert contents(folder / "s.zarr") == before

    def append() -> None:
        assert contents(folder / "s.zarr") == before
        nimprep.append_frames(parts[1], folder / "s.zarr")

    faults = until_it_fits(append, remount, 2500)
    assert contents(folder / "s.zarr") == contents(tmp_path / "whole.zarr")
    assert [path.name for path in folder.iterdir()] == ["s.zarr"]
    print(f"full {faults + 1} times, at the end the same bytes")


def test_a_merge_that_fills_the_disk_leaves_nothing(
    disk: tuple[Path, Remount], parts: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, remount = disk
    stores = [tmp_path / "a.zarr", tmp_path / "b.zarr"]
    for source, store in zip(parts, stores, strict=True):
        nimprep.convert(source, store, modalities=("rgb", "depth"), shard_length=4)
    assert_one_line(run("merge", *stores, folder / "m.zarr"), "No space left on device")
    assert list(folder.iterdir()) == []
    remount("size=20m")
    nimprep.merge_stores(stores, folder / "m.zarr")
    assert validate_store(folder / "m.zarr").problems == []


def test_a_folder_that_may_not_be_written_is_one_line(
    disk: tuple[Path, Remount], tmp_path: Path
) -> None:
    folder, remount = disk
    source, more = write_gmrp(tmp_path / "a", 2), write_frames(tmp_path / "b", range(2, 4))
    nimprep.convert(source, folder / "s.zarr", modalities=("rgb", "depth"))
    before = contents(folder)
    remount("ro")
    for command in (
        ("convert", source, folder / "new.zarr"),
        ("convert", source, folder / "s.zarr", "--overwrite"),
        ("append", more, folder / "s.zarr"),
        ("merge", folder / "s.zarr", folder / "s.zarr", folder / "m.zarr", "--prefix", "a,b"),
    ):
        assert_one_line(run(*command), "expected a writable place, found Read-only file system")
    assert contents(folder) == before
    # What is there can still be read.
    assert validate_store(folder / "s.zarr", deep=True).problems == []
    assert nimprep.merge_stores([folder / "s.zarr"], tmp_path / "m.zarr").ids == (
        "000000",
        "000001",
    )
    remount("rw")
    assert len(nimprep.append_frames(more, folder / "s.zarr").store) == 4


def test_a_conversion_cut_short_says_so_where_nothing_may_be_written_any_more(
    disk: tuple[Path, Remount], parts: tuple[Path, Path]
) -> None:
    folder, remount = disk
    with pytest.raises(StoreError, match="No space left on device"):
        nimprep.convert(parts[0], folder / "s.zarr", shard_length=2)
    remount("ro")
    done = run("convert", parts[0], folder / "s.zarr", "--shard-length", "2")
    assert_one_line(done, "Read-only file system")
