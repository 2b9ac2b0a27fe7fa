"""R2D: depth in the bytes of three channels, and a camera that nobody published."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError, OptionError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import CX, CY, FX, FY, scene

# The official split has frames of one town in several splits.
TOWNS = {
    "training": ["Town02", "Town05"],
    "validation": ["Town01", "Town05"],
    "testing": ["Town10HD"],
}
SPLITS = {"training": "train", "validation": "val", "testing": "test"}
CAMERA = (FX, FY, CX, CY)
GIVEN = ReaderOptions(camera=CAMERA)
LARGEST = (1 << 24) - 1


def depth_bytes(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return depth as CARLA writes it, R the lowest byte; none is the largest value."""
    raw = np.round(depth_m.astype(np.float64) / 1000 * LARGEST).astype(np.int64)
    raw[depth_m == 0] = LARGEST
    return np.dstack([raw & 255, raw >> 8 & 255, raw >> 16]).astype(np.uint8)


def write_r2d(root: Path) -> dict[str, int]:
    """Write two frames per town; return each frame's seed by its id."""
    seeds: dict[str, int] = {}
    for split, town in ((split, town) for split, towns in TOWNS.items() for town in towns):
        for _ in range(2):
            seed, folder = len(seeds), root / split / town
            name = f"{40 * seed:06d}"
            seeds[f"{split}/{town}/{name}"] = seed
            made = scene(seed)
            depth = made.depth_m.copy()
            # Far, but not none.
            depth[4, :5] = 700.25
            write_png(folder / "rgb" / f"{name}.png", made.rgb)
            write_png(folder / "depth" / f"{name}.png", depth_bytes(depth))
            label = np.zeros((*made.label.shape, 3), np.uint8)
            label[..., 0] = np.where(made.label == 7, 7, made.label % 7)
            # Other channels say nothing.
            label[..., 1], label[..., 2] = 7, seed
            write_png(folder / "label" / f"{name}.png", label)
    return seeds


@pytest.fixture
def r2d(tmp_path: Path) -> Path:
    write_r2d(tmp_path / "R2D")
    return tmp_path / "R2D"


def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path) -> None:
    seeds = write_r2d(tmp_path / "R2D")
    reader = open_reader(tmp_path / "R2D", GIVEN)
    assert (reader.info.name, reader.info.calibration) == ("r2d", "user")
    assert reader.ids == tuple(sorted(seeds))
    assert [(c.id, c.name) for c in reader.info.classes] == [(0, "other"), (1, "road")]
    for frame_id, seed in seeds.items():
        split, town, _ = frame_id.split("/")
        frame, made = reader.read(frame_id), scene(seed)
        assert (reader.group(frame_id), reader.fixed_split(frame_id)) == (town, SPLITS[split])
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == CAMERA
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        np.testing.assert_array_equal(frame.label, made.label == 7)
        expected = made.depth_m.copy()
        expected[4, :5] = 700.25
        assert frame.depth_m is not None
        np.testing.assert_array_equal(frame.depth_m > 0, expected > 0)
        # Half a step of 1000 m in 24 bits, and what float32 keeps of 700 m.
        np.testing.assert_allclose(frame.depth_m, expected, atol=500 / LARGEST + 3e-5)


def test_without_a_camera_it_is_refused_as_a_wrong_call(r2d: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"expected --camera FILE or --intrinsics .* neither"):
        open_reader(r2d)
    out = tmp_path / "r.zarr"
    done = CliRunner().invoke(main, ["convert", str(r2d), str(out)])
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert not out.exists()
    given = ["--intrinsics", ",".join(map(str, CAMERA))]
    done = CliRunner().invoke(main, ["convert", str(r2d), str(out), *given])
    assert done.exit_code == 0
    # That a store of millimetres loses what is at 700 m is said.
    assert "65.5" in done.stderr
    store = nimprep.open_store(out)
    assert store.about.dataset == "r2d"
    assert "ECCV 2020" in store.about.references[0]["citation"]
    counts = {name: list(store.splits.values()).count(name) for name in ("train", "val", "test")}
    assert counts == {"train": 4, "val": 4, "test": 2}


@pytest.mark.parametrize(
    ("folder", "said"),
    [
        ("depth", "expected depth files .*depth.*unpack the folders depth"),
        ("label", "expected label files .*label.*--no-labels"),
        ("rgb", r"for r2d it lacks '.*rgb.*unpack the folders rgb there"),
    ],
)
def test_a_part_that_is_not_there_is_named(r2d: Path, folder: str, said: str) -> None:
    for path in sorted(r2d.glob(f"*/*/{folder}")):
        shutil.rmtree(path)
    with pytest.raises(LayoutError, match=said):
        open_reader(r2d, GIVEN)


def test_a_folder_too_deep_or_too_high_is_answered_with_the_right_one(
    r2d: Path, tmp_path: Path
) -> None:
    for wrong in (
        tmp_path,
        r2d / "training",
        r2d / "training/Town02",
        r2d / "testing/Town10HD/rgb",
    ):
        with pytest.raises(LayoutError, match=rf"did you mean {r2d}\?"):
            open_reader(wrong, GIVEN)


def test_a_frame_that_lacks_a_file_is_bad_and_a_split_may_be_missing(r2d: Path) -> None:
    shutil.rmtree(r2d / "validation")
    lost = r2d / "testing/Town10HD/depth" / sorted(p.name for p in r2d.glob("testing/*/rgb/*"))[0]
    lost.unlink()
    reader = open_reader(r2d, GIVEN)
    assert {reader.fixed_split(i) for i in reader.ids} == {"train", "test"}
    with pytest.raises(DecodeError, match="expected depth of frame 'testing/Town10HD/"):
        reader.read(f"testing/Town10HD/{lost.stem}")


def test_inspect_names_it_and_says_that_it_needs_a_camera(r2d: Path, tmp_path: Path) -> None:
    found = inspect_source(r2d)
    assert (found.kind, found.reader) == ("reader", "r2d")
    assert found.next_steps == [f"nimprep convert {r2d} OUT.zarr --intrinsics fx,fy,cx,cy"]
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    with pytest.raises(OptionError, match="expected --camera FILE or --intrinsics"):
        open_reader(r2d, ReaderOptions(description=tmp_path / "d.json"))
    described = open_reader(r2d, ReaderOptions(description=tmp_path / "d.json", camera=CAMERA))
    named = open_reader(r2d, GIVEN)
    assert (described.ids, described.info) == (named.ids, named.info)
