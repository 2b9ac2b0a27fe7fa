import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import (
    ArrayError,
    CameraError,
    DecodeError,
    LayoutError,
    OptionError,
    SplitError,
    StoreError,
)
from nimprep.splits import count_splits, write_split_file
from nimprep.store.validate import validate_store
from tests.fakes import contents, write_gmrp, write_png

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp", frames=5)


def test_the_same_input_gives_the_same_bytes_on_any_number_of_workers(
    gmrp: Path, tmp_path: Path
) -> None:
    nimprep.convert(gmrp, tmp_path / "one.zarr", workers=1, shard_length=2)
    nimprep.convert(gmrp, tmp_path / "four.zarr", workers=4, shard_length=2)
    assert contents(tmp_path / "one.zarr") == contents(tmp_path / "four.zarr")


def test_the_source_is_left_as_it_was(gmrp: Path, tmp_path: Path) -> None:
    before = contents(gmrp)
    nimprep.convert(gmrp, tmp_path / "s.zarr", crop="auto")
    assert contents(gmrp) == before


def test_the_digest_changes_with_any_source_file(gmrp: Path, tmp_path: Path) -> None:
    def digest(name: str) -> str:
        store = nimprep.convert(gmrp, tmp_path / name)
        found: str = store.attributes["source"]["digest"]
        return found

    first = digest("a.zarr")
    assert digest("b.zarr") == first
    write_png(gmrp / "rgb" / "000002.png", np.zeros((24, 32, 3), np.uint8))
    assert digest("c.zarr") != first


def test_3896_tiny_frames_split_as_the_paper_did(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=1, size=(2, 3))
    for folder in ("rgb", "depth_u16", "label"):
        for number in range(1, 3896):
            os.link(root / folder / "000000.png", root / folder / f"{number:06d}.png")
    store = nimprep.convert(root, tmp_path / "s.zarr", shard_length=512)
    assert count_splits(store.splits.values()) == {"train": 2726, "val": 585, "test": 585}


def test_a_crop_moves_the_camera_and_is_recorded(gmrp: Path, tmp_path: Path) -> None:
    whole = nimprep.convert(gmrp, tmp_path / "a.zarr")
    cropped = nimprep.convert(gmrp, tmp_path / "b.zarr", crop=(4, 1, 3, 2))
    assert cropped.attributes["crop"] == {"top": 4, "bottom": 1, "left": 3, "right": 2}
    assert cropped[0].camera.cx == whole[0].camera.cx - 3
    assert cropped[0].camera.cy == whole[0].camera.cy - 4
    assert whole[0].rgb is not None
    assert np.array_equal(cropped[0].rgb, whole[0].rgb[4:-1, 3:-2])


def test_normals_can_be_kept_finer(gmrp: Path, tmp_path: Path) -> None:
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", normal_dtype="int16", sign_filter=True)
    frame = store[0]
    assert frame.depth_m is not None
    assert frame.normal is not None
    exact = nimprep.estimate_normals(frame.depth_m, frame.camera, sign_filter=True)
    assert np.abs(exact - frame.normal).max() < 1e-4
    assert store.attributes["modalities"]["normal"] == {
        "method": "nim",
        "parameters": {"sign_filter": True, "lone": "none", "fill": "none"},
        "dtype": "int16",
    }
    assert validate_store(store.path, deep=True).problems == []


def test_small_stores_hold_the_same_pixels_in_fewer_bytes(gmrp: Path, tmp_path: Path) -> None:
    fast = nimprep.convert(gmrp, tmp_path / "fast.zarr")
    small = nimprep.convert(gmrp, tmp_path / "small.zarr", codec="small")
    for a, b in zip(fast, small, strict=True):
        for name in ("rgb", "depth_m", "normal", "hha", "label"):
            assert np.array_equal(getattr(a, name), getattr(b, name))


def test_only_the_modalities_asked_for_are_stored(gmrp: Path, tmp_path: Path) -> None:
    (gmrp / "rgb" / "000000.png").write_bytes(b"never opened")
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", modalities=("normal",))
    assert store.modalities == ("normal",)
    assert store.classes == ()


def test_hha_is_stored_with_the_gravity_it_was_made_with(gmrp: Path, tmp_path: Path) -> None:
    store = nimprep.convert(gmrp, tmp_path / "s.zarr")
    frame = store[2]
    assert frame.depth_m is not None
    gravity = nimprep.estimate_gravity(frame.depth_m, frame.camera)
    assert np.allclose(store.tables.gravity[2], gravity)
    expected = nimprep.encode_hha(frame.depth_m, frame.camera, ground="floor")
    assert np.array_equal(frame.hha, expected)
    without = nimprep.convert(gmrp, tmp_path / "n.zarr", modalities=("rgb", "depth"))
    assert np.isnan(without.tables.gravity).all()


@pytest.mark.parametrize("method", ["nearest", "linear", "colorization"])
def test_filling_serves_normals_and_hha_and_leaves_depth_raw(
    gmrp: Path, tmp_path: Path, method: str
) -> None:
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", fill=method)
    frame = store[1]
    assert frame.depth_m is not None
    assert frame.normal is not None
    filled, mask = nimprep.fill_depth(frame.depth_m, method, frame.rgb)
    assert mask.any()
    assert (frame.depth_m[mask] == 0).all()
    assert np.array_equal(frame.normal.any(axis=2), filled > 0)
    assert np.array_equal(
        frame.hha, nimprep.encode_hha(filled, frame.camera, missing=mask, ground="floor")
    )
    for name in ("normal", "hha"):
        assert store.attributes["modalities"][name]["parameters"]["fill"] == method
    assert validate_store(store.path, deep=True).problems == []


def test_filled_depth_is_stored_only_when_told_and_recorded(gmrp: Path, tmp_path: Path) -> None:
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", fill="nearest", store_filled=True)
    frame = store[1]
    assert frame.depth_m is not None
    assert (frame.depth_m > 0).all()
    assert store.attributes["modalities"]["depth"]["parameters"] == {"fill": "nearest"}
    assert validate_store(store.path, deep=True).problems == []
    with pytest.raises(ArrayError, match="a way to fill"):
        nimprep.convert(gmrp, tmp_path / "t.zarr", store_filled=True)


def test_a_split_file_splits(gmrp: Path, tmp_path: Path) -> None:
    write_split_file(tmp_path / "split.json", {"000000": "val", "000004": "test"})
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", split_file=tmp_path / "split.json")
    assert list(store.splits.values()) == ["val", "none", "none", "none", "test"]
    assert store.attributes["split"] == {"rule": "file"}


def test_depth_beyond_what_a_store_can_say_is_none(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=1)
    depth = np.full((24, 32), 3000, np.uint16)
    depth[0, 0] = 40000
    write_png(root / "depth_u16" / "000000.png", depth)
    options = {"depth_scale": 0.002, "depth_unit": "mm"}
    frame = nimprep.convert(root, tmp_path / "s.zarr", **options)[0]
    assert frame.depth_m is not None
    assert frame.depth_m[0, 0] == 0
    assert frame.depth_m[0, 1] == 6


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"codec": "tiny"}, ArrayError, "codec"),
        ({"modalities": ("rgb", "heat")}, OptionError, "heat"),
        ({"workers": 0}, ArrayError, "workers"),
        ({"depth_scale": -1.0}, ArrayError, "depth_scale"),
        ({"camera": "no.json"}, CameraError, r"no\.json"),
        ({"crop": (24, 0, 0, 0)}, LayoutError, "leave something"),
        ({"split_by": "group"}, SplitError, "expected a group"),
        ({"split_file": "no.json"}, SplitError, r"no\.json"),
        ({"labels": False, "modalities": ("label",)}, LayoutError, "no labels"),
        ({"normals": "nimble"}, ArrayError, "nimble"),
    ],
)
def test_a_wrong_option_leaves_nothing_behind(
    gmrp: Path, tmp_path: Path, options: dict[str, object], error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        nimprep.convert(gmrp, tmp_path / "s.zarr", **options)
    assert not (tmp_path / "s.zarr").exists()


def test_a_bad_frame_in_the_middle_leaves_nothing_behind(gmrp: Path, tmp_path: Path) -> None:
    path = gmrp / "depth_u16" / "000003.png"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(DecodeError, match=r"depth_u16/000003\.png"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=1)
    assert not (tmp_path / "s.zarr").exists()


def test_a_complete_store_is_replaced_only_when_told(gmrp: Path, tmp_path: Path) -> None:
    nimprep.convert(gmrp, tmp_path / "s.zarr")
    before = contents(tmp_path / "s.zarr")
    with pytest.raises(StoreError, match="--overwrite"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", seed=1)
    assert contents(tmp_path / "s.zarr") == before
    nimprep.convert(gmrp, tmp_path / "s.zarr", seed=1, overwrite=True)
    assert contents(tmp_path / "s.zarr") != before


def test_another_folder_is_never_replaced(gmrp: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(StoreError, match="no nimprep store"):
        nimprep.convert(gmrp, tmp_path / "mine", overwrite=True)
    with pytest.raises(StoreError, match="found a file"):
        nimprep.convert(gmrp, tmp_path / "mine" / "thesis.txt", overwrite=True)
    assert (tmp_path / "mine" / "thesis.txt").read_text() == "years of work"


@pytest.mark.parametrize("place", [".", "out.zarr", "rgb", ".."])
def test_a_target_within_the_source_is_refused(gmrp: Path, place: str) -> None:
    before = contents(gmrp)
    with pytest.raises(StoreError, match="apart from the source"):
        nimprep.convert(gmrp, gmrp / place, overwrite=True)
    assert contents(gmrp) == before


def test_a_link_to_the_source_is_the_source(gmrp: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(gmrp)
    with pytest.raises(StoreError, match="apart from the source"):
        nimprep.convert(gmrp, tmp_path / "link" / "s.zarr")


def test_a_target_that_cannot_be_written_is_refused_by_name(gmrp: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="expected a writable place"):
        nimprep.convert(gmrp, tmp_path / "file" / "s.zarr")


COMMAND = [sys.executable, "-m", "nimprep", "convert"]


def test_a_disk_that_runs_full_is_one_line_and_nothing_is_left(gmrp: Path, tmp_path: Path) -> None:
    # A limit on file size fails a write for real, as a full disk does, without a disk to fill.
    write_png(
        gmrp / "rgb" / "000004.png",
        np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8),
    )

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))

    target = tmp_path / "s.zarr"
    done = subprocess.run(
        [*COMMAND, str(gmrp), str(target)],
        capture_output=True,
        text=True,
        preexec_fn=limit,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=False,
    )
    assert done.returncode == 1, done.stderr
    errors = [line for line in done.stderr.splitlines() if not line.startswith("warning:")]
    assert len(errors) == 1
    assert "expected to write it, found File too large" in errors[0]
    assert not target.exists()


def test_a_bad_source_leaves_the_store_it_was_to_replace(gmrp: Path, tmp_path: Path) -> None:
    nimprep.convert(gmrp, tmp_path / "s.zarr")
    before = contents(tmp_path / "s.zarr")
    (gmrp / "rgb" / "000003.png").write_bytes(b"")
    with pytest.raises(DecodeError):
        nimprep.convert(gmrp, tmp_path / "s.zarr", overwrite=True)
    assert contents(tmp_path / "s.zarr") == before
    assert {path.name for path in tmp_path.iterdir()} == {"gmrp", "s.zarr"}


def test_depth_that_no_store_can_say_is_refused(gmrp: Path, tmp_path: Path) -> None:
    with pytest.raises(DecodeError, match="check --depth-scale"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", depth_scale=9.0)
    said = "give metres per unit: 0.002, not 500, with --depth-scale"
    with pytest.raises(DecodeError, match=said):
        nimprep.convert(gmrp, tmp_path / "s.zarr", depth_scale=500.0)
