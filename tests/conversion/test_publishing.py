"""What a power failure would leave: every name and every file is on the disk before it counts."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion import workspace
from nimprep.store import writer
from tests.conversion.test_append import write_frames
from tests.fakes import write_gmrp

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

OPTIONS = {"shard_length": 2, "modalities": ("depth", "label")}


class Disk:
    """Know what was put on the disk, and of what was moved what was not."""

    def __init__(self) -> None:
        self.synced: dict[tuple[int, int], int] = {}
        self.moved: list[str] = []
        self.lost: list[str] = []

    def sync(self, descriptor: int) -> None:
        """Take the place of `os.fsync`."""
        state = os.fstat(descriptor)
        self.synced[state.st_dev, state.st_ino] = state.st_mtime_ns

    def look(self, folder: Path) -> None:
        """Note what of a folder changed, names in it too, since it was put on the disk."""
        self.moved.append(folder.name)
        for path in (folder, *folder.rglob("*")):
            state = path.stat()
            if self.synced.get((state.st_dev, state.st_ino)) != state.st_mtime_ns:
                self.lost.append(path.relative_to(folder).as_posix())


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    """Return what watches the disk from here on, until stores get their names."""
    found = Disk()
    move = writer.move_into_place

    def moving(partial: Path, *arguments: object, **named: object) -> None:
        found.look(partial)
        move(partial, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "fsync", found.sync)
    monkeypatch.setattr(workspace, "move_into_place", moving)
    return found


def converted(folder: Path, **options: object) -> None:
    nimprep.convert(folder / "a", folder / "s.zarr", **OPTIONS, **options)


def with_gaps(folder: Path) -> None:
    (folder / "a" / "label" / "000001.png").write_bytes(b"")
    converted(folder, on_error="skip")


def appended(folder: Path) -> None:
    converted(folder)
    nimprep.append_frames(write_frames(folder / "b", range(5, 8)), folder / "s.zarr")


def merged(folder: Path) -> None:
    converted(folder)
    nimprep.merge_stores([folder / "s.zarr"], folder / "m.zarr")


@pytest.mark.parametrize("make", [converted, with_gaps, appended, merged])
def test_all_of_a_store_is_on_the_disk_before_it_gets_its_name(
    make: Callable[[Path], None], tmp_path: Path, disk: Disk
) -> None:
    write_gmrp(tmp_path / "a", 5)
    make(tmp_path)
    assert len(disk.moved) == (1 if make in (converted, with_gaps) else 2)
    assert disk.lost == []
