"""Without a writable home or installation everything works, and one line says what it costs."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import nimprep
from tests.compilation.everything import FUNCTIONS
from tests.compilation.installation import Installation, install, lock, unlock

CLI = ("-m", "nimprep")


@pytest.fixture(scope="module")
def installed() -> Iterator[Installation]:
    # Not in pytest's folder, which its owner alone may enter.
    root = Path(tempfile.mkdtemp(prefix="nimprep-test-"))
    root.chmod(0o755)
    try:
        yield install(root)
    finally:
        unlock(root)
        shutil.rmtree(root)


@pytest.fixture(scope="module")
def warmed(installed: Installation) -> Path:
    """Warm up with nowhere to write but to temporary files; return what was kept."""
    first = installed.run(*CLI, "warm-up", temporary="temporary")
    assert first.returncode == 0, first.stderr
    assert said(first.stderr) == 1
    assert "those missing are kept in" in first.stderr
    (private,) = (installed.root / "temporary").iterdir()
    assert private.stat().st_mode & 0o777 == 0o700
    (kept,) = private.iterdir()
    number = len(list(kept.iterdir()))
    assert number > 40
    assert first.stdout.startswith(f"{kept}: {number} kernels, {number} compiled and 0 there")
    again = installed.run(*CLI, "warm-up", temporary="temporary")
    assert again.stdout.startswith(f"{kept}: {number} kernels, 0 compiled and {number} there")
    return kept


@pytest.fixture
def filled(installed: Installation, warmed: Path) -> Iterator[Installation]:
    """Let the installation hold every compiled kernel, as an image that was warmed up does."""
    compilation = installed.in_tree.parent
    compilation.chmod(0o755)
    shutil.copytree(warmed, installed.in_tree)
    lock(compilation)
    yield installed
    unlock(compilation)
    shutil.rmtree(installed.in_tree)
    compilation.chmod(0o555)


def said(stderr: str) -> int:
    """Count the lines that name the variable; there must be no other."""
    lines = stderr.splitlines()
    assert all("NUMBA_CACHE_DIR" in line for line in lines), stderr
    return len(lines)


def tree(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def converted(out: str) -> tuple[str, ...]:
    return (*CLI, "convert", "raw", out, "--description", "raw.json", "--shard-length", "2")


def test_commands_do_what_they_do_elsewhere_and_say_one_line(
    installed: Installation, warmed: Path
) -> None:
    world = installed.root / "world"
    kept = tree(warmed)
    for arguments, told in (
        (converted("here.zarr"), 1),
        ((*CLI, "validate", "here.zarr", "--deep"), 1),
        ((*CLI, "info", "here.zarr"), 0),  # needs no kernel
        ((*CLI, "report", "here.zarr", "report.html"), 1),  # measures what modalities tell
    ):
        done = installed.run(*arguments, temporary="temporary")
        assert done.returncode == 0, done.stderr
        assert said(done.stderr) == told, (arguments, done.stderr)
    usual = nimprep.convert(
        world / "raw",
        installed.root / "usual.zarr",
        description=world / "raw.json",
        shard_length=2,
    )
    assert tree(world / "here.zarr") == tree(Path(usual.path))
    assert tree(warmed) == kept


def test_an_image_that_was_warmed_up_says_nothing(filled: Installation) -> None:
    done = filled.run(*converted("warm.zarr"), temporary="untouched")
    assert (done.returncode, done.stderr) == (0, "")
    assert not list((filled.root / "untouched").iterdir())


def test_a_named_folder_that_cannot_be_written_to_is_said_and_done_without(
    filled: Installation,
) -> None:
    for name in ("locked", "locked/within", "world/raw.json", "nowhere\x01/\udc80"):
        folder = filled.root / name
        done = filled.run(*CLI, "validate", "s.zarr", "--deep", temporary="other", cache_dir=folder)
        assert done.returncode == 0, done.stderr
        assert said(done.stderr) == 1
        assert ": valid" in done.stdout
    failed = filled.run(*CLI, "warm-up", temporary="other", cache_dir=filled.root / "locked")
    assert failed.returncode == 1
    assert failed.stdout == ""
    assert said(failed.stderr) == 2
    assert "Traceback" not in failed.stderr


def test_with_nowhere_to_write_at_all_a_sound_store_is_valid(filled: Installation) -> None:
    occupied = filled.root / "occupied"
    occupied.mkdir()
    for user in (65534, 0):
        (occupied / f"nimprep-{user}").touch()
    # Some of what it needs: to compile everything takes a minute.
    filled.in_tree.chmod(0o755)
    lost = list(filled.in_tree.glob("nimprep.kernels.quantisation.*"))
    assert lost
    for file in lost:
        file.unlink()
    filled.in_tree.chmod(0o555)
    done = filled.run(*CLI, "validate", "s.zarr", "--deep", temporary="occupied")
    assert done.returncode == 0, done.stderr
    assert "compiled in each run" in done.stderr
    assert said(done.stderr) == 1


SPAWNED = """
import multiprocessing, warnings
from nimprep.kernels import sums

def use(number):
    from nimprep.kernels import sums
    return number

if __name__ == "__main__":
    for way in ("spawn", "fork"):
        with multiprocessing.get_context(way).Pool(2) as pool:
            print(pool.map(use, range(4)))
"""


def test_processes_started_from_one_that_said_it_are_quiet_and_share_its_folder(
    installed: Installation, warmed: Path
) -> None:
    (installed.root / "world" / "spawned.py").write_text(SPAWNED)
    kept = tree(warmed)
    done = installed.run("-W", "ignore::DeprecationWarning", "spawned.py", temporary="temporary")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiled kernels: ") == 1
    assert tree(warmed) == kept


def test_after_a_warm_up_nothing_is_compiled_whatever_is_called(
    installed: Installation, warmed: Path
) -> None:
    public = {
        name
        for name in nimprep.__all__
        if callable(getattr(nimprep, name)) and not isinstance(getattr(nimprep, name), type)
    }
    assert FUNCTIONS.keys() == public
    shutil.copytree(installed.root / "world", installed.root / "another")
    kept = tree(warmed)
    done = installed.run(
        "-m", "tests.compilation.everything", installed.root / "another", temporary="temporary"
    )
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr
    assert tree(warmed) == kept
