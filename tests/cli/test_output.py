"""What goes wrong around a command: where it prints to, and calls that cannot be meant."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.errors import NimprepError
from nimprep.frame import MAX_PIXELS
from nimprep.synthetic import write_synthetic
from tests.fakes import write_gmrp


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("command", [["--help"], ["--version"], ["convert", "--help"]])
def test_a_full_disk_behind_stdout_is_one_line(command: list[str], unbuffered: str) -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        result = subprocess.run(
            [sys.executable, "-m", "nimprep", *command],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            check=False,
        )
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: standard output: expected room for the result, found")


@pytest.mark.parametrize("size", ["100000x100000", "0x10", "-5x5", f"{MAX_PIXELS + 1}x1"])
def test_a_synthetic_size_beyond_reason_is_a_wrong_call(tmp_path: Path, size: str) -> None:
    result = CliRunner().invoke(main, ["synth", str(tmp_path / "out"), "--size", size])
    assert result.exit_code == 2
    assert f"1 to {MAX_PIXELS} pixels" in result.stderr
    assert not (tmp_path / "out").exists()


def test_a_synthetic_size_beyond_reason_is_refused_in_python(tmp_path: Path) -> None:
    with pytest.raises(NimprepError, match="found 100000x100000"):
        write_synthetic(tmp_path / "out", 1, size=(100_000, 100_000))
    assert not (tmp_path / "out").exists()


def test_too_little_memory_for_a_synthetic_frame_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("nimprep.synthetic.writer.render_frame", fail)
    result = CliRunner().invoke(main, ["synth", str(tmp_path / "out"), "--size", "64x48"])
    assert result.exit_code == 1
    assert "expected memory for frames of 64x48 pixels" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "option",
    [
        ("--crop", "-1,0,0,0"),
        ("--crop", "1,2,3,-4"),
        ("--intrinsics", "0,0,0,0"),
        ("--intrinsics", "30,-1,0,0"),
        ("--intrinsics", "30,30,nan,0"),
        ("--intrinsics", "inf,30,0,0"),
    ],
)
def test_numbers_that_cannot_be_meant_are_a_wrong_call(
    tmp_path: Path, option: tuple[str, str]
) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=1)
    command = ["convert", str(root), str(tmp_path / "s.zarr"), f"{option[0]}={option[1]}"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 2
    assert "expected" in result.stderr
    assert not (tmp_path / "s.zarr").exists()
