import json
import os
import pty
import subprocess
import sys
import termios
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import nimprep
from nimprep.cli import main
from nimprep.store.info import store_info
from tests.fakes import SIZE, write_gmrp, write_nyu_like, write_png
from tests.processes import Processes


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp")


@pytest.fixture
def store(gmrp: Path, tmp_path: Path) -> Path:
    assert run("convert", gmrp, tmp_path / "s.zarr").exit_code == 0
    return tmp_path / "s.zarr"


def test_convert_prints_what_the_store_holds_and_warns_of_the_nominal_camera(
    gmrp: Path, tmp_path: Path
) -> None:
    result = run("convert", gmrp, tmp_path / "s.zarr")
    assert result.exit_code == 0
    assert "5 frames of 32x24 pixels" in result.stdout
    assert "median" in result.stdout
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("warning: ")
    assert "nominal RealSense D415" in result.stderr


def test_convert_takes_a_camera_as_numbers_or_file(gmrp: Path, tmp_path: Path) -> None:
    (tmp_path / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    for name, option, value, origin in (
        ("a", "--intrinsics", "30,31,15,11", "user"),
        ("b", "--camera", tmp_path / "camera.json", "file"),
    ):
        result = run("convert", gmrp, tmp_path / name, option, value)
        assert result.exit_code == 0
        assert result.stderr == ""
        calibration = store_info(tmp_path / name)["calibration"]
        assert calibration["origin"] == origin
        assert calibration["intrinsics"] == [[30, 0, 15], [0, 31, 11], [0, 0, 1]]


def test_convert_crops_and_says_so(gmrp: Path, tmp_path: Path) -> None:
    result = run("convert", gmrp, tmp_path / "s.zarr", "--crop", "1,2,3,4")
    assert "5 frames of 25x21 pixels" in result.stdout
    assert "top 1, bottom 2, left 3, right 4" in result.stdout


def test_convert_reads_a_described_folder(tmp_path: Path) -> None:
    root, description = write_nyu_like(tmp_path / "nyu")
    result = run(
        "convert", root, tmp_path / "s.zarr", "--description", description, "--split-by", "frame"
    )
    assert result.exit_code == 0
    assert "2 scenes" in result.stdout


def test_convert_without_labels_or_with_some_modalities(gmrp: Path, tmp_path: Path) -> None:
    assert run("convert", gmrp, tmp_path / "a", "--no-labels").exit_code == 0
    assert run("convert", gmrp, tmp_path / "b", "--modalities", "rgb,depth").exit_code == 0
    assert "label" not in nimprep.open_store(tmp_path / "a").modalities
    assert nimprep.open_store(tmp_path / "b").modalities == ("rgb", "depth")


@pytest.mark.parametrize(
    "arguments",
    [
        ("--crop", "1,2,3"),
        ("--crop", "all"),
        ("--intrinsics", "1,2,3"),
        ("--intrinsics", "1,2,3,4", "--camera", "c.json"),
        ("--modalities", "rgb,heat"),
        ("--depth-scale", "0"),
        ("--codec", "tiny"),
        ("--split-by", "frame", "--split-file", "s.json"),
        ("--workers", "0"),
        ("--unknown",),
    ],
)
def test_a_wrong_call_exits_2(gmrp: Path, tmp_path: Path, arguments: tuple[str, ...]) -> None:
    assert run("convert", gmrp, tmp_path / "s.zarr", *arguments).exit_code == 2
    assert not (tmp_path / "s.zarr").exists()


def test_a_scale_that_counts_units_per_metre_is_told(gmrp: Path, tmp_path: Path) -> None:
    done = run("convert", gmrp, tmp_path / "s.zarr", "--depth-scale", "5000")
    assert done.exit_code == 2
    assert done.stderr.endswith("<=1000; give metres per unit: 0.0002, not 5000\n")


def damaged(root: Path, folder: str, data: bytes) -> None:
    (root / folder / "000002.png").write_bytes(data)


BAD = {
    "truncated": lambda r: damaged(r, "rgb", (r / "rgb" / "000002.png").read_bytes()[:-20]),
    "empty": lambda r: damaged(r, "label", b""),
    "no image": lambda r: damaged(r, "depth_u16", b"hello"),
    "8-bit depth": lambda r: write_png(r / "depth_u16" / "000002.png", np.full(SIZE, 80, np.uint8)),
    "all-zero depth": lambda r: write_png(
        r / "depth_u16" / "000002.png", np.zeros(SIZE, np.uint16)
    ),
    "another unit": lambda r: write_png(
        r / "depth_u16" / "000002.png", np.full(SIZE, 4, np.uint16)
    ),
    "label out of range": lambda r: write_png(
        r / "label" / "000002.png", np.full(SIZE, 3, np.uint8)
    ),
    "another size": lambda r: write_png(r / "label" / "000002.png", np.full((9, 9), 1, np.uint8)),
    "a missing label": lambda r: (r / "label" / "000002.png").unlink(),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_data_exits_1_with_one_line_that_names_the_file(
    gmrp: Path, tmp_path: Path, case: str
) -> None:
    BAD[case](gmrp)
    (gmrp / "camera.json").write_text('{"fx": 30, "fy": 31, "cx": 15, "cy": 11}')
    result = run("convert", gmrp, tmp_path / "s.zarr")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ")
    assert "000002" in result.stderr
    assert "expected" in result.stderr
    assert "found" in result.stderr
    assert not (tmp_path / "s.zarr").exists()


@pytest.mark.parametrize("command", ["info", "validate", "split"])
def test_a_store_that_is_not_there_exits_1(tmp_path: Path, command: str) -> None:
    result = run(command, tmp_path / "none.zarr")
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert "none.zarr: expected a nimprep store, found nothing" in result.stderr


@pytest.mark.parametrize("what", ["missing", "empty"])
def test_a_folder_that_is_missing_or_empty_exits_1(tmp_path: Path, what: str) -> None:
    if what == "empty":
        (tmp_path / "empty").mkdir()
    result = run("convert", tmp_path / what, tmp_path / "s.zarr")
    assert result.exit_code == 1
    assert what in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_bug_keeps_its_traceback(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("nimprep.store.info.store_info", broken)
    assert isinstance(run("info", store).exception, ZeroDivisionError)


def test_info_prints_one_object_in_two_ways(store: Path) -> None:
    found = json.loads(run("info", store, "--json").stdout)
    assert found == store_info(store)
    assert run("info", store).stdout.startswith("store ")


def test_validate_exits_0_on_a_valid_store_and_1_on_another(store: Path) -> None:
    good = run("validate", store, "--deep")
    assert good.exit_code == 0
    assert "valid, 5 frames" in good.stdout
    shard = store / "rgb" / "c" / "0" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(data)
    assert run("validate", store).exit_code == 0
    bad = run("validate", store, "--deep", "--json")
    assert bad.exit_code == 1
    report = json.loads(bad.stdout)
    assert report["valid"] is False
    assert "wrong checksum" in report["problems"][0]


def test_split_shows_exports_imports_and_splits_anew(store: Path, tmp_path: Path) -> None:
    shown = run("split", store)
    assert [line.split()[:2] for line in shown.stdout.splitlines()] == [
        ["train", "3"],
        ["val", "1"],
        ["test", "1"],
    ]
    before = nimprep.open_store(store).splits
    assert run("split", store, "--export", tmp_path / "split.json").exit_code == 0
    assert run("split", store, "--seed", "7").exit_code == 0
    assert nimprep.open_store(store).splits != before
    assert run("split", store, "--import", tmp_path / "split.json").exit_code == 0
    assert nimprep.open_store(store).splits == before
    assert run("split", store, "--split-by", "group").exit_code == 1
    assert nimprep.open_store(store).splits == before
    assert run("split", store, "--import", "x.json", "--seed", "1").exit_code == 2
    assert run("split", store, "--export", store / "zarr.json" / "x.json").exit_code == 1


def test_synth_makes_what_convert_reads(tmp_path: Path) -> None:
    result = run("synth", tmp_path / "raw", "--frames", "3", "--size", "64x48", "--normals")
    assert result.exit_code == 0
    assert result.stdout.endswith("3 frames of 64x48 pixels\n")
    assert (tmp_path / "raw" / "normal").is_dir()
    converted = run("convert", tmp_path / "raw", tmp_path / "s.zarr")
    assert converted.exit_code == 0
    assert converted.stderr == ""
    assert run("synth", tmp_path / "raw").exit_code == 1
    assert run("synth", tmp_path / "other", "--size", "64").exit_code == 2


def test_demo_runs_from_nothing_to_a_valid_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nimprep.cli.synth.DEMO_FRAMES", 4)
    result = run("demo")
    assert result.exit_code == 0, result.stderr
    assert "checked: valid" in result.stdout
    assert "What to do next" in result.stdout
    assert len(nimprep.open_store("nimprep-demo/demo.zarr")) == 4
    assert run("demo", "nimprep-demo").exit_code == 1


def test_help_and_version_come_without_heavy_imports() -> None:
    code = (
        "import sys; from nimprep.cli import main; main(['--help'], standalone_mode=False);"
        "import nimprep; heavy = {'numpy', 'numba', 'cv2', 'zarr', 'torch', 'scipy', 'jsonschema'};"
        "sys.exit(str(heavy & set(sys.modules)) if heavy & set(sys.modules) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for name in ("convert", "info", "validate", "split", "evaluate", "synth", "demo", "kitti"):
        assert f"  {name} " in done.stdout


def read_terminal(processes: Processes, command: list[str]) -> tuple[str, str]:
    """Run a command with stderr on a terminal; return what it wrote there and to stdout."""
    ours, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 120))
    process = processes.start(command, stdout=subprocess.PIPE, stderr=theirs, text=True)
    os.close(theirs)
    # First the terminal, which holds a few kilobytes: the slower a command, the more it draws.
    written = b""
    while True:
        try:
            piece = os.read(ours, 4096)
        except OSError:
            break
        if not piece:
            break
        written += piece
    os.close(ours)
    out, _ = process.communicate()
    return written.decode(), out


def test_progress_shows_rate_and_time_left_to_a_person_alone(
    gmrp: Path, tmp_path: Path, processes: Processes
) -> None:
    command = [sys.executable, "-m", "nimprep", "convert", str(gmrp)]
    drawn, out = read_terminal(processes, [*command, str(tmp_path / "a.zarr")])
    assert "converting" in drawn
    assert "5/5" in drawn
    assert "frame/s" in drawn
    assert out.startswith("store ")
    quiet, _ = read_terminal(processes, [*command, str(tmp_path / "b.zarr"), "--quiet"])
    assert "converting" not in quiet
