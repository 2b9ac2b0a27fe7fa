"""Where compiled kernels are kept: chosen once, said in one line where the user has a choice."""

from __future__ import annotations

import os
import shutil
import warnings
from pathlib import Path

import numba
import pytest

from nimprep.compilation import folders
from nimprep.compilation.folders import SAID, CacheFolders, Place


@pytest.fixture(autouse=True)
def quiet_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    # Set first, so that it is taken back whatever the test does.
    monkeypatch.setenv(SAID, "1")
    monkeypatch.delenv(SAID)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user's folders: the package's own, a home, one for temporary files."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(folders, "IN_TREE", tmp_path / "nimprep" / "compilation" / "__pycache__")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "nimprep" / "compilation").mkdir(parents=True)
    (tmp_path / "temporary").mkdir()
    return tmp_path


def block(folder: Path) -> None:
    """Let nothing be written below a folder: root could, were it only a matter of modes."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.touch()


def relative(found: CacheFolders, home: Path) -> str:
    return "" if found.to_write is None else found.to_write.relative_to(home).parts[0]


def test_each_folder_is_the_next_where_those_before_cannot_be_written_to(home: Path) -> None:
    steps: list[tuple[Path, str, bool]] = [
        (home / "nothing", "nimprep", False),
        (home / "nimprep" / "compilation", "home", False),
        (home / "home", "temporary", True),
        (home / "temporary", "", True),
    ]
    for blocked, expected, told in steps:
        block(blocked)
        os.environ.pop(SAID, None)
        found = CacheFolders(folders._places)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            for _ in range(3):
                assert relative(found, home) == expected
        assert len(said) == told, expected
        for warning in said:
            assert "NUMBA_CACHE_DIR" in str(warning.message)
            assert "\n" not in str(warning.message)
            assert str(home / "home") in str(warning.message)


def test_the_folder_that_the_user_names_comes_first_and_is_missed_in_one_line(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(home / "mine"))
    assert relative(CacheFolders(folders._places), home) == "mine"
    block(home / "no folder")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(home / "no folder"))
    with pytest.warns(UserWarning, match=r"no folder.*NUMBA_CACHE_DIR") as said:
        assert relative(CacheFolders(folders._places), home) == "nimprep"
    assert len(said) == 1


def test_where_nothing_can_be_written_what_is_there_is_read(home: Path) -> None:
    looked = []

    class Watched(Place):
        def hindrance(self) -> str:
            looked.append(self.folder)
            return super().hindrance()

    places = [Watched(home / "a" / "file"), Watched(home / "b"), Watched(home / "c")]
    block(home / "a")
    found = CacheFolders(lambda: places)
    reading = found.to_read()
    assert next(reading) == home / "a" / "file"
    # What is found there is enough: no folder was made, nothing was said.
    assert not looked
    assert list(reading) == [home / "b"]
    assert list(found.to_read()) == [home / "a" / "file", home / "b"]
    assert not (home / "c").exists()


def private(home: Path) -> Path:
    return home / "temporary" / f"nimprep-{os.geteuid()}"


def test_the_temporary_folder_is_the_users_alone_and_found_again(home: Path) -> None:
    block(home / "home")
    block(home / "nimprep" / "compilation")
    for _ in range(2):
        os.environ.pop(SAID, None)
        with pytest.warns(UserWarning, match="those missing are kept in"):
            found = CacheFolders(folders._places).to_write
        assert found is not None
        assert found.parent == private(home)
        assert private(home).stat().st_mode & 0o777 == 0o700
        assert [p.name for p in (home / "temporary").iterdir()] == [private(home).name]


@pytest.mark.parametrize("trap", ["link", "open", "file", "dangling"])
def test_a_temporary_folder_that_another_could_have_made_is_neither_read_nor_written(
    trap: str, home: Path
) -> None:
    block(home / "home")
    block(home / "nimprep" / "compilation")
    other = home / "other"
    other.mkdir(mode=0o700)
    if trap == "open":
        private(home).mkdir()
        private(home).chmod(0o770)
    elif trap == "file":
        private(home).touch()
    else:
        private(home).symlink_to(other if trap == "link" else home / "nowhere")
    found = CacheFolders(folders._places)
    with pytest.warns(UserWarning, match="compiled in each run"):
        assert found.to_write is None
    assert not any(path.is_relative_to(home / "temporary") for path in found.to_read())
    assert not list(other.iterdir())
    assert not (home / "nowhere").exists()


def test_a_temporary_folder_of_another_user_is_neither_read_nor_written(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    block(home / "home")
    block(home / "nimprep" / "compilation")
    private(home).mkdir(mode=0o700)
    mine = os.geteuid()
    monkeypatch.setattr(folders, "_user", lambda: mine + 1)
    private(home).rename(home / "temporary" / f"nimprep-{mine + 1}")
    found = CacheFolders(folders._places)
    with pytest.warns(UserWarning, match="not a folder of this user"):
        assert found.to_write is None
    assert not any(path.is_relative_to(home / "temporary") for path in found.to_read())


def test_root_with_anothers_home_leaves_nothing_there(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    block(home / "nimprep" / "compilation")
    (home / "home").mkdir()
    theirs = (home / "home").stat()
    monkeypatch.setattr(folders, "_user", lambda: 0)
    monkeypatch.setattr(
        Path, "stat", lambda path, **named: os.stat_result((*theirs[:4], 1234, *theirs[5:]))
    )
    assert folders._doubt_at_home(home / "home" / "numba" / "x") == "of another user"


def test_the_working_folder_is_none_for_temporary_files(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What Python's tempfile says where neither /tmp nor its like can be written to.
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(home)
    monkeypatch.setattr("tempfile.tempdir", str(home))
    assert folders._temporary() is None
    monkeypatch.setenv("TMPDIR", str(home))
    assert folders._temporary() is not None
