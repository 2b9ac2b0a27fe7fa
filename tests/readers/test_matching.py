"""Which files make a frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from nimprep.errors import LayoutError
from nimprep.readers.matching import files_for

CAPTURED = {
    f"{scene}/{name}": {"scene": scene, "name": name} for scene in ("a", "b") for name in ("0", "1")
}


def touched(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


def found(root: Path, pattern: str) -> dict[str, str]:
    places = files_for(root, pattern, CAPTURED)
    return {i: place.path.relative_to(root).as_posix() for i, place in places.items()}


def test_a_file_belongs_to_the_frame_of_its_placeholders(tmp_path: Path) -> None:
    touched(tmp_path, "cam/a/0.txt", "cam/b/1.txt", "cam/c/1.txt")
    assert found(tmp_path, "cam/{scene}/{name}.txt") == {"a/0": "cam/a/0.txt", "b/1": "cam/b/1.txt"}


def test_frames_share_a_file_that_says_less(tmp_path: Path) -> None:
    touched(tmp_path, "a/K.txt", "b/K.txt")
    shared = {i: f"{i[0]}/K.txt" for i in CAPTURED}
    assert found(tmp_path, "{scene}/K.txt") == shared
    assert found(tmp_path, "{scene}/{other}.txt") == shared
    assert found(tmp_path, "a/K.txt") == dict.fromkeys(CAPTURED, "a/K.txt")
    assert found(tmp_path, "a/*.txt") == dict.fromkeys(CAPTURED, "a/K.txt")


def test_two_files_for_one_frame_are_refused(tmp_path: Path) -> None:
    touched(tmp_path, "x/a/0.txt", "y/a/0.txt", "x/c/0.txt", "y/c/0.txt")
    with pytest.raises(LayoutError, match=r"y/a/0.txt: .* per id 'a/0', found .*x/a/0.txt too"):
        found(tmp_path, "{other}/{scene}/{name}.txt")


def test_what_systems_leave_behind_is_passed_over(tmp_path: Path) -> None:
    touched(tmp_path, "a/K.txt", "a/._K.txt", "__MACOSX/K.txt", "a/Thumbs.db", "a/desktop.ini")
    assert found(tmp_path, "**/*") == dict.fromkeys(CAPTURED, "a/K.txt")
