"""Files and folders that are written: whole, on the disk, where nothing is, and as they were."""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from nimprep.errors import LayoutError, SplitError
from nimprep.files import replace_file, whole_file, write_whole
from nimprep.folders import place_of, refuse_inside, whole_folder


def names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


WRITERS: dict[str, Callable[[Path, bytes], None]] = {
    "write_whole": write_whole,
    "its parts": lambda path, data: write_whole(path, [data[:1], data[1:]]),
    "replace_file": replace_file,
}


@pytest.fixture(params=WRITERS)
def write(request: pytest.FixtureRequest) -> Callable[[Path, bytes], None]:
    return WRITERS[request.param]


@pytest.mark.parametrize("folders", [False, True])
@pytest.mark.parametrize("code", ["EINVAL", "ENOSYS", "ENOTSUP", "EOPNOTSUPP", "EIO", "ENOSPC"])
def test_a_file_system_that_syncs_nothing_is_written_to_and_a_failing_one_is_said(
    tmp_path: Path,
    write: Callable[[Path, bytes], None],
    code: str,
    folders: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    number = getattr(errno, code)

    def fsync(descriptor: int) -> None:
        if stat.S_ISDIR(os.fstat(descriptor).st_mode) == folders:
            raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fsync)

    def fill() -> None:
        write(tmp_path / "file", b"data")
        with whole_folder(tmp_path / "folder") as folder:
            (folder / "file").write_bytes(b"data")

    if code in ("EIO", "ENOSPC"):
        with pytest.raises(LayoutError, match=f"expected to write it, found {os.strerror(number)}"):
            fill()
        return
    fill()
    assert names(tmp_path) == ["file", "folder", "folder/file"]


def test_a_file_is_written_with_the_folders_above_it(
    tmp_path: Path, write: Callable[[Path, bytes], None]
) -> None:
    write(tmp_path / "a" / "b" / "file", b"data")
    assert (tmp_path / "a" / "b" / "file").read_bytes() == b"data"
    assert names(tmp_path) == ["a", "a/b", "a/b/file"]
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE((tmp_path / "a/b/file").stat().st_mode) == 0o666 & ~umask


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Note what is put on the disk and what gets its name, in order."""
    found: list[str] = []
    fsync, replace, link, rename = os.fsync, Path.replace, Path.hardlink_to, Path.rename

    def synced(descriptor: int) -> None:
        folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        found.append("sync folder" if folder else "sync file")
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", synced)
    for name, function in (("replace", replace), ("hardlink_to", link), ("rename", rename)):

        def named(self: Path, other: Path, function: Callable[..., object] = function) -> object:
            found.append("name")
            return function(self, other)

        monkeypatch.setattr(Path, name, named)
    return found


def test_a_file_is_on_the_disk_before_it_has_its_name_and_its_name_afterwards(
    tmp_path: Path, steps: list[str], write: Callable[[Path, bytes], None]
) -> None:
    write(tmp_path / "file", b"data")
    assert steps == ["sync file", "name", "sync folder"]


def test_a_folder_is_on_the_disk_before_it_has_its_name_and_its_name_afterwards(
    tmp_path: Path, steps: list[str]
) -> None:
    with whole_folder(tmp_path / "new") as folder:
        (folder / "a").mkdir()
        (folder / "a" / "file").write_bytes(b"data")
        (folder / "link").symlink_to("nowhere")
    assert steps == ["sync folder", "sync file", "sync folder", "name", "sync folder"]
    assert names(tmp_path) == ["new", "new/a", "new/a/file", "new/link"]


def broken(context: AbstractContextManager[Path]) -> None:
    with context as path:
        if path.is_dir():
            path /= "file"
        path.write_bytes(b"half")
        raise KeyboardInterrupt


def test_after_an_error_nothing_is_left(tmp_path: Path) -> None:
    place = tmp_path / "new" / "folder" / "x"
    for context in (whole_file(place), whole_folder(place)):
        with pytest.raises(KeyboardInterrupt):
            broken(context)
        assert names(tmp_path) == []
    (tmp_path / "empty").mkdir()
    with pytest.raises(KeyboardInterrupt):
        broken(whole_folder(tmp_path / "empty"))
    assert names(tmp_path) == ["empty"]


def test_an_empty_folder_stays_the_folder_it_is(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir(mode=0o750)
    before = out.stat().st_ino
    with whole_folder(out) as folder:
        (folder / "file").write_bytes(b"data")
    assert (out.stat().st_ino, stat.S_IMODE(out.stat().st_mode)) == (before, 0o750)
    assert names(tmp_path) == ["out", "out/file"]


@pytest.mark.parametrize("second_names", [True, False])
def test_what_comes_meanwhile_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, second_names: bool
) -> None:
    if not second_names:
        monkeypatch.setattr(Path, "hardlink_to", _cannot)

    def overtaken(context: AbstractContextManager[Path], other: Path) -> None:
        with context as path:
            if path.is_dir():
                other.parent.mkdir()
            else:
                path.write_bytes(b"ours")
            other.write_bytes(b"mine")

    with pytest.raises(LayoutError, match="expected a new file, found one there already"):
        overtaken(whole_file(tmp_path / "file"), tmp_path / "file")
    with pytest.raises(LayoutError, match="found 'mine' in it"):
        overtaken(whole_folder(tmp_path / "f"), tmp_path / "f" / "mine")
    assert (tmp_path / "file").read_bytes() == b"mine"
    assert names(tmp_path) == ["f", "f/mine", "file"]


def _cannot(self: Path, other: Path) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_a_file_system_without_second_names_will_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Path, "hardlink_to", _cannot)
    write_whole(tmp_path / "file", b"data")
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o444])
def test_a_file_that_is_replaced_hands_on_its_mode_and_owner(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "file"
    for write in (replace_file, lambda path, data: write_whole(path, data, overwrite=True)):
        path.unlink(missing_ok=True)
        path.write_bytes(b"old")
        path.chmod(mode)
        if os.geteuid() == 0:
            os.chown(path, 65534, 65534)
        before = path.stat()
        write(path, b"new")
        after = path.stat()
        assert path.read_bytes() == b"new"
        assert after.st_ino != before.st_ino
        kept = ("st_mode", "st_uid", "st_gid")
        assert [getattr(after, name) for name in kept] == [getattr(before, name) for name in kept]


def test_a_pipe_is_written_to_and_stays(tmp_path: Path) -> None:
    pipe, found = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: found.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, b"data" * 100_000)
    reader.join()
    assert found == [b"data" * 100_000]
    assert pipe.is_fifo()


def test_who_writes_says_which_error_it_is(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"mine")
    for out in (tmp_path / "file", tmp_path / "file" / "x", tmp_path / "a\0b", tmp_path):
        with pytest.raises(SplitError, match="expected"):
            write_whole(out, b"", error=SplitError)
        with pytest.raises(SplitError, match="expected"), whole_folder(out, error=SplitError):
            pass
    assert names(tmp_path) == ["file"]


def test_a_place_is_inside_a_source_however_it_is_spelt(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "source"
    (source / "deep").mkdir(parents=True)
    (tmp_path / "link").symlink_to(source)
    (tmp_path / "file").symlink_to(source / "new")
    (source / "out").symlink_to(tmp_path)
    monkeypatch.chdir(source / "deep")
    inside = ["..", ".", "new", "../new", "../../link", "../../link/new", "../../file", "../out"]
    for out in inside:
        with pytest.raises(LayoutError, match="outside the source"):
            refuse_inside(Path(out), source)
        with pytest.raises(LayoutError, match="outside the source"):
            refuse_inside(Path(out).absolute(), Path("..") if out != ".." else source)
    for out in ("../../new", "../../source2", "/"):
        refuse_inside(Path(out), source)


def test_a_place_stays_right_wherever_the_process_goes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = tmp_path / "real"
    real.mkdir()
    (tmp_path / "link").symlink_to(real)
    monkeypatch.chdir(tmp_path / "link")
    assert place_of(Path()) == place_of(Path("../real")) == real
    assert place_of(Path("..")) == tmp_path
    assert place_of(Path("x")) == place_of(Path("../link/x")) == real / "x"
    assert place_of(tmp_path / "link") == tmp_path / "link"
