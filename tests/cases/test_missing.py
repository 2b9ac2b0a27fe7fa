"""Cases 12, 13 and 29: frames that lack files, labels or all of their depth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import DecodeError
from tests.cases.cases import nimprep_run


def test_frames_that_lack_a_file_are_left_out_on_request(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("12-")
    done = nimprep_run("convert", root, tmp_path / "s.zarr")
    assert done.exit_code == 1
    assert done.stderr == (
        f"error: {root}/depth_u16/000002.png: expected depth of frame '000002', found none; 2 of "
        "6 frames lack a file; --on-error skip leaves such frames out\n"
    )
    assert not (tmp_path / "s.zarr").exists()
    arguments = ("--on-error", "skip", "--allow-skipped", "2")
    done = nimprep_run("convert", root, tmp_path / "s.zarr", *arguments)
    assert done.exit_code == 0
    assert done.stderr.splitlines()[:2] == [
        "skipped 000002: depth_u16/000002.png: expected depth of frame '000002', found none",
        "skipped 000004: label/000004.png: expected label of frame '000004', found none",
    ]
    store = nimprep.open_store(tmp_path / "s.zarr")
    assert store.ids == ("000000", "000001", "000003", "000005")


def test_a_bad_frame_is_named_with_the_way_out(case: Callable[[str], Path], tmp_path: Path) -> None:
    root = case("29-")
    done = nimprep_run("convert", root, tmp_path / "s.zarr", "--workers", "1")
    assert done.exit_code == 1
    assert "000003.png: expected depth, found no pixel that has any" in done.stderr
    assert done.stderr.endswith("; --on-error skip leaves such frames out\n")
    with pytest.raises(DecodeError) as caught:
        nimprep.convert(root, tmp_path / "s.zarr")
    assert caught.value.__notes__[-1] == "--on-error skip leaves such frames out"
    store = nimprep.convert(root, tmp_path / "s.zarr", on_error="skip")
    assert [frame["id"] for frame in store.about.skipped] == ["000003", "000004"]
