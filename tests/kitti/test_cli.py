"""`nimprep kitti`: what it prints, where, and with which exit code."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from nimprep.cli import main
from nimprep.schema import schema_problems

from .scenes import HEIGHT, WIDTH, ground_truth, noise, road_folder, write_calibration, write_png


def _run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["kitti", *map(str, arguments)])


@pytest.fixture
def road(tmp_path: Path) -> Path:
    """A road folder of one frame, and predictions/um_road_000000.png beside it."""
    write_png(tmp_path / "predictions" / "um_road_000000.png", noise(0, HEIGHT, WIDTH))
    return road_folder(tmp_path / "road") / "training"


def test_scores_are_printed_as_the_json_of_the_schema(reference_data: Path) -> None:
    golden = reference_data / "kitti_road_golden"
    training = reference_data / "kitti_road" / "training"
    expected = json.loads((golden / "scores.json").read_text())
    for view in ("bev", "perspective"):
        result = _run(
            "evaluate",
            golden / "perspective",
            training / "gt_image_2",
            "--calib",
            training / "calib",
            "--view",
            view,
            "--json",
        )
        assert (result.exit_code, result.stderr) == (0, "")
        scores = json.loads(result.stdout)
        assert scores["urban"]["AP"] == pytest.approx(expected[view]["urban"]["AP"], abs=1e-5)


def test_scores_are_a_table_for_people(road: Path) -> None:
    result = _run(
        "evaluate", road.parents[1] / "predictions", road / "gt_image_2", "--view", "perspective"
    )
    assert result.exit_code == 0
    header, first, second = result.stdout.splitlines()
    assert header.split() == [
        "in",
        "%",
        "MaxF",
        "AP",
        "PRE",
        "REC",
        "FPR",
        "FNR",
        "threshold",
        "frames",
    ]
    assert (first.split()[0], second.split()[0]) == ("um_road", "urban")
    assert len(first.split()) == 9
    assert first.split()[-1] == "1"


def test_scores_and_threshold_are_of_one_unit_that_is_said(road: Path) -> None:
    folders = (road.parents[1] / "predictions", road / "gt_image_2")
    table = _run("evaluate", *folders, "--view", "perspective").stdout.splitlines()[1].split()
    scores = json.loads(_run("evaluate", *folders, "--view", "perspective", "--json").stdout)
    row = scores["um_road"]
    assert row["unit"] == "percent"
    assert row["best_threshold_percent"] == 100 * row["best_threshold"]
    shown = [f"{row[n]:.2f}" for n in ("MaxF", "AP", "PRE", "REC", "FPR", "FNR")]
    assert table[1:-1] == [*shown, f"{row['best_threshold_percent']:.2f}"]
    assert schema_problems(scores, "kitti-scores") == []
    for name in ("unit", "best_threshold_percent", "frames"):
        del row[name]
    # What format 1.0 said of a table.
    assert schema_problems({"um_road": row}, "kitti-scores") == []


def test_a_threshold_is_taken_as_it_is_printed(road: Path, tmp_path: Path) -> None:
    folders = (road.parents[1] / "predictions", road / "gt_image_2", road / "image_2")
    pictures = []
    for i, said in enumerate(("0.25", "25%", "25.00%")):
        result = _run("overlay", *folders, tmp_path / str(i), "--threshold", said)
        assert result.exit_code == 0, result.output
        pictures.append((tmp_path / str(i) / "um_road_000000.png").read_bytes())
    assert len(set(pictures)) == 1


def test_all_five_steps_run(road: Path, tmp_path: Path) -> None:
    predictions, calib = tmp_path / "predictions", road / "calib"
    steps = {
        "depth": ("depth", road.parent, tmp_path / "depth"),
        "bev": ("bev", predictions, tmp_path / "bev", "--calib", calib),
        "evaluate": ("evaluate", predictions, road / "gt_image_2", "--calib", calib),
        "pack": ("pack", predictions, tmp_path / "o.zip", "--calib", calib, "--partial"),
        "overlay": (
            "overlay",
            predictions,
            road / "gt_image_2",
            road / "image_2",
            tmp_path / "overlay",
        ),
    }
    for name, arguments in steps.items():
        result = _run(*arguments)
        assert result.exit_code == 0, (name, result.output)
        assert result.stderr == ""
        assert result.stdout
    assert zipfile.ZipFile(tmp_path / "o.zip").namelist() == ["um_road_000000.png"]
    for written in ("depth/training/depth_u16/um_000000", "bev/um_road_000000"):
        assert (tmp_path / f"{written}.png").is_file()
    assert (tmp_path / "overlay" / "um_road_000000.png").is_file()


def _no_p2(road: Path, tmp_path: Path) -> tuple[object, ...]:
    write_calibration(road / "calib" / "um_000000.txt", P2=None)
    return "bev", tmp_path / "predictions", tmp_path / "out", "--calib", road / "calib"


def _nan(road: Path, tmp_path: Path) -> tuple[object, ...]:
    write_calibration(road / "calib" / "um_000000.txt", Tr_cam_to_road="nan " * 12)
    return "bev", tmp_path / "predictions", tmp_path / "out", "--calib", road / "calib"


def _wrong_size(road: Path, tmp_path: Path) -> tuple[object, ...]:
    write_png(tmp_path / "predictions" / "um_road_000000.png", noise(0, 9, 9))
    return "bev", tmp_path / "predictions", tmp_path / "out", "--calib", road / "calib"


def _truncated_scan(road: Path, tmp_path: Path) -> tuple[object, ...]:
    (road / "velodyne").mkdir()
    (road / "velodyne" / "um_000000.bin").write_bytes(b"\0" * 50)
    return "depth", road.parent, tmp_path / "out", "--from", "lidar"


def _colour(road: Path, tmp_path: Path) -> tuple[object, ...]:
    write_png(tmp_path / "predictions" / "um_road_000000.png", noise(0, HEIGHT, WIDTH, 3))
    return "bev", tmp_path / "predictions", tmp_path / "out", "--calib", road / "calib"


def _sixteen_bit(road: Path, tmp_path: Path) -> tuple[object, ...]:
    image = noise(0, HEIGHT, WIDTH).astype(np.uint16)
    write_png(tmp_path / "predictions" / "um_road_000000.png", image)
    return "evaluate", tmp_path / "predictions", road / "gt_image_2", "--view", "perspective"


def _nothing_evaluated(road: Path, tmp_path: Path) -> tuple[object, ...]:
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    write_png(road / "gt_image_2" / "um_road_000000.png", ground_truth(nothing, nothing))
    return "evaluate", tmp_path / "predictions", road / "gt_image_2", "--view", "perspective"


def _zip_exists(road: Path, tmp_path: Path) -> tuple[object, ...]:
    (tmp_path / "o.zip").write_bytes(b"")
    return "pack", tmp_path / "predictions", tmp_path / "o.zip", "--partial"


def _incomplete(road: Path, tmp_path: Path) -> tuple[object, ...]:
    return "pack", tmp_path / "predictions", tmp_path / "o.zip", "--calib", road / "calib"


def _no_folder(road: Path, tmp_path: Path) -> tuple[object, ...]:
    return "overlay", tmp_path / "nowhere", road / "gt_image_2", road / "image_2", tmp_path / "out"


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (_no_p2, "um_000000.txt: expected the matrix P2"),
        (_nan, "um_000000.txt: expected finite numbers for Tr_cam_to_road"),
        (_wrong_size, "um_road_000000.png: expected 120x60 pixels"),
        (_truncated_scan, "um_000000.bin: expected whole points"),
        (
            _colour,
            "um_road_000000.png: expected a confidence map, 8-bit or 16-bit grey, found 8-bit RGB",
        ),
        (_sixteen_bit, "expected 16-bit confidences up to 65535, found at most 255"),
        (_nothing_evaluated, "um_road_000000.png: expected evaluated pixels"),
        (
            _zip_exists,
            "o.zip: expected a new file, found one there already; --overwrite replaces it",
        ),
        (_incomplete, "289 missing: um_road_000001.png"),
        (_no_folder, "nowhere: expected a folder"),
    ],
)
def test_bad_input_is_one_line_and_exit_1(road: Path, tmp_path: Path, make, named: str) -> None:
    result = _run(*make(road, tmp_path))
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert named in result.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("depth", "a"),
        ("depth", "a", "b", "--from", "radar"),
        ("evaluate", "a", "b", "--view", "side"),
        ("pack", "a", "b", "--type", "kerb"),
        ("overlay", "a", "b", "c", "d", "--threshold", "2"),
        ("overlay", "a", "b", "c", "d", "--threshold", "101%"),
        ("overlay", "a", "b", "c", "d", "--threshold", "half"),
        ("overlay", "a", "b", "c", "d", "--threshold", "nan"),
        ("fly",),
    ],
)
def test_a_wrong_call_is_exit_2(arguments: tuple[str, ...]) -> None:
    assert _run(*arguments).exit_code == 2


def test_warnings_are_one_line_on_stderr(tmp_path: Path) -> None:
    flat = np.full((800, 400), 5, np.uint8)
    write_png(tmp_path / "predictions" / "um_road_000000.png", flat)
    result = _run("pack", tmp_path / "predictions", tmp_path / "o.zip", "--partial")
    assert result.exit_code == 0
    assert result.stderr.startswith("warning: ")
    assert result.stderr.count("\n") == 1
