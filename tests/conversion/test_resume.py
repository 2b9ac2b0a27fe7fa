"""Conversions that are cut short, for real, and go on."""

import os
import random
import shutil
import signal
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, StoreError
from nimprep.store.metadata import read_attributes
from nimprep.store.validate import validate_store
from tests.conversion.mortal import Mortals
from tests.fakes import contents, write_gmrp, write_png
from tests.held import RECORD, held
from tests.processes import PATIENCE_S, Processes

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

COMMAND = [sys.executable, "-m", "nimprep", "convert"]
KILLS = int(os.environ.get("NIMPREP_KILLS", "6"))


@pytest.fixture
def gmrp(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp", frames=7)


def damage(path: Path) -> bytes:
    """Cut a file short; return what it was."""
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    return whole


def cut_short(source: Path, target: Path, bad: str = "000004", **options: object) -> bytes:
    """Convert until a bad frame ends it; return the frame's depth as it should be."""
    whole = damage(source / "depth_u16" / f"{bad}.png")
    with pytest.raises(DecodeError, match=bad):
        nimprep.convert(source, target, shard_length=2, workers=1, **options)
    return whole


def run(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload, no-any-return]


def begun(
    processes: Processes, source: Path, target: Path, *arguments: str
) -> AbstractContextManager[subprocess.Popen[str]]:
    """Start a conversion as a user does; it stands still once its first shards are written."""
    options = ("--shard-length", "2", "--workers", "1", *arguments)
    return held(processes, RECORD, "convert", *options, source, target)


def test_the_same_command_goes_on_after_a_bad_frame_was_mended(gmrp: Path, tmp_path: Path) -> None:
    nimprep.convert(gmrp, tmp_path / "whole.zarr", shard_length=2)
    whole = cut_short(gmrp, tmp_path / "s.zarr")
    assert not (tmp_path / "s.zarr").exists()
    units = tmp_path / ".s.zarr.partial" / "journal" / "units"
    assert sorted(p.name for p in units.iterdir()) == ["0.json", "1.json"]
    before = {p: p.stat().st_mtime_ns for p in units.iterdir()}
    (gmrp / "depth_u16" / "000004.png").write_bytes(whole)
    steps = []

    def progress(step: str, frames: int):  # type: ignore[no-untyped-def]
        steps.append((step, frames, after := {p: p.stat().st_mtime_ns for p in units.iterdir()}))
        assert after == before  # what was done is not done again
        return lambda: None

    nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, progress=progress)
    assert [step[:2] for step in steps] == [("going on converting", 7)]
    assert contents(tmp_path / "s.zarr") == contents(tmp_path / "whole.zarr")
    assert {p.name for p in tmp_path.iterdir()} == {"gmrp", "s.zarr", "whole.zarr"}


def test_a_bad_frame_that_stays_bad_ends_it_again_and_loses_nothing(
    gmrp: Path, tmp_path: Path
) -> None:
    cut_short(gmrp, tmp_path / "s.zarr")
    with pytest.raises(DecodeError, match="000004") as caught:
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2)
    assert caught.value.__notes__ == [
        "4 of 7 frames are kept: the same command goes on from them",
        "--on-error skip leaves such frames out",
    ]


def test_a_fault_before_the_first_shard_leaves_nothing_at_all(gmrp: Path, tmp_path: Path) -> None:
    cut_short(gmrp, tmp_path / "s.zarr", bad="000001")
    assert {p.name for p in tmp_path.iterdir()} == {"gmrp"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fill": "nearest"}, 'fill "?none"? then and "?nearest"? now'),
        ({"seed": 3}, "seed 0 then and 3 now"),
        ({"intrinsics": (30.0, 30.0, 16.0, 12.0)}, "camera null then"),
        ({"modalities": ("rgb", "depth")}, "modalities null then"),
    ],
)
def test_other_options_are_refused_and_said(
    gmrp: Path, tmp_path: Path, options: dict[str, object], words: str
) -> None:
    whole = cut_short(gmrp, tmp_path / "s.zarr")
    (gmrp / "depth_u16" / "000004.png").write_bytes(whole)
    if "intrinsics" in options:
        options = {"camera": options["intrinsics"]}
    with pytest.raises(StoreError, match=words) as caught:
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, **options)
    assert "--restart" in str(caught.value)
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, restart=True, **options)
    assert validate_store(store.path, deep=True).problems == []


@pytest.mark.parametrize("number", ["000000", "000006"])
def test_a_source_file_that_changed_is_refused_by_name(
    gmrp: Path, tmp_path: Path, number: str
) -> None:
    cut_short(gmrp, tmp_path / "s.zarr")
    write_png(gmrp / "rgb" / f"{number}.png", np.zeros((24, 32, 3), np.uint8))
    words = f"1 source files changed, first rgb/{number}.png"
    with pytest.raises(StoreError, match=words):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2)


def test_frames_that_came_or_went_are_refused_by_name(gmrp: Path, tmp_path: Path) -> None:
    cut_short(gmrp, tmp_path / "s.zarr")
    for folder in ("rgb", "depth_u16", "label"):
        (gmrp / folder / "000006.png").rename(gmrp / folder / "000009.png")
    with pytest.raises(StoreError, match="1 frames gone, first '000006'; 1 frames new"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2)


def test_a_camera_file_that_changed_is_noticed(gmrp: Path, tmp_path: Path) -> None:
    camera = tmp_path / "camera.json"
    camera.write_text('{"fx": 30, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}')
    cut_short(gmrp, tmp_path / "s.zarr", camera=camera)
    camera.write_text('{"fx": 31, "fy": 30, "cx": 16, "cy": 12, "width": 32, "height": 24}')
    with pytest.raises(StoreError, match="camera sha256:"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, camera=camera)


def test_the_crop_that_was_found_is_not_looked_for_again(gmrp: Path, tmp_path: Path) -> None:
    nimprep.convert(gmrp, tmp_path / "whole.zarr", shard_length=2, crop="auto")
    whole = (gmrp / "label" / "000004.png").read_bytes()
    (gmrp / "label" / "000004.png").write_bytes(whole[:-30])
    with pytest.raises(DecodeError, match="label/000004"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, crop="auto", workers=1)
    (gmrp / "label" / "000004.png").write_bytes(whole)
    steps: list[str] = []

    def progress(step: str, frames: int):  # type: ignore[no-untyped-def]
        steps.append(step)
        return lambda: None

    nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, crop="auto", progress=progress)
    assert steps == ["going on converting"]
    assert contents(tmp_path / "s.zarr") == contents(tmp_path / "whole.zarr")


def test_bad_frames_are_left_out_and_listed(gmrp: Path, tmp_path: Path) -> None:
    damage(gmrp / "depth_u16" / "000001.png")
    (gmrp / "rgb" / "000003.png").write_bytes(b"")
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, on_error="skip")
    assert store.ids == ("000000", "000002", "000004", "000005", "000006")
    skipped = store.attributes["skipped"]
    assert [frame["id"] for frame in skipped] == ["000001", "000003"]
    assert skipped[1]["reason"].startswith("rgb/000003.png: expected")
    assert validate_store(store.path, deep=True).problems == []
    for folder in ("rgb", "depth_u16", "label"):
        for number in ("000001", "000003"):
            (gmrp / folder / f"{number}.png").unlink()
    without = nimprep.convert(gmrp, tmp_path / "without.zarr", shard_length=2)
    assert without.attributes["source"] == store.attributes["source"]
    ours, theirs = contents(store.path), contents(without.path)
    assert {k: v for k, v in ours.items() if k != "zarr.json"} == {
        k: v for k, v in theirs.items() if k != "zarr.json"
    }


def test_a_whole_unit_of_bad_frames_leaves_no_gap(gmrp: Path, tmp_path: Path) -> None:
    for number in ("000002", "000003", "000006"):
        damage(gmrp / "label" / f"{number}.png")
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, on_error="skip")
    assert store.ids == ("000000", "000001", "000004", "000005")
    assert validate_store(store.path, deep=True).problems == []
    assert sorted(p.name for p in (store.path / "rgb" / "c").iterdir()) == ["0", "1"]


def test_no_good_frame_is_an_error(gmrp: Path, tmp_path: Path) -> None:
    for path in (gmrp / "label").iterdir():
        path.write_bytes(b"")
    with pytest.raises(DecodeError, match="at least one good frame, found 7 bad ones"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", on_error="skip")


def test_skipped_frames_exit_1_unless_so_many_are_allowed(gmrp: Path, tmp_path: Path) -> None:
    damage(gmrp / "depth_u16" / "000001.png")
    done = run(gmrp, tmp_path / "s.zarr", "--on-error", "skip")
    assert done.returncode == 1
    assert "skipped 000001: depth_u16/000001.png: expected" in done.stderr
    assert "--allow-skipped 1" in done.stderr
    assert "skipped  1 bad frames" in done.stdout
    arguments = ("--on-error", "skip", "--allow-skipped", "1", "--overwrite")
    assert run(gmrp, tmp_path / "s.zarr", *arguments).returncode == 0
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []


def test_mended_frames_are_taken_in_when_it_goes_on(
    gmrp: Path, tmp_path: Path, processes: Processes
) -> None:
    nimprep.convert(gmrp, tmp_path / "whole.zarr", shard_length=2)
    first = damage(gmrp / "depth_u16" / "000001.png")
    later = (gmrp / "label" / "000006.png").read_bytes()
    (gmrp / "label" / "000006.png").write_bytes(later[:-30])
    target = tmp_path / "s.zarr"
    with pytest.raises(DecodeError, match="000001"):
        nimprep.convert(gmrp, target, shard_length=2, workers=1)
    with begun(processes, gmrp, target, "--on-error", "skip") as process:
        process.kill()
        process.wait()
    (gmrp / "depth_u16" / "000001.png").write_bytes(first)
    (gmrp / "label" / "000006.png").write_bytes(later)
    nimprep.convert(gmrp, target, shard_length=2, restart=True)
    assert contents(target) == contents(tmp_path / "whole.zarr")


def test_killed_at_random_calls_it_ends_with_the_same_bytes(
    mortals: Mortals, tmp_path: Path
) -> None:
    source, target, rng = tmp_path / "gmrp", tmp_path / "s.zarr", random.Random(0)
    damage(write_gmrp(source, frames=31) / "label" / "000015.png")
    options = {"shard_length": 2, "on_error": "skip"}
    assert mortals.run("convert", source, target, **options) == 0
    calls, whole = mortals.calls, contents(target)
    assert calls is not None
    shutil.rmtree(target)
    killed = halfway = runs = 0
    while killed < KILLS:
        # From the start to after the end: reading, encoding, packing, finishing, renaming.
        call = rng.randrange(calls)
        status = mortals.run("convert", source, target, call=call, **options)
        assert status in (0, -signal.SIGKILL)
        runs += 1
        assert runs <= 3 * KILLS, "expected most runs to be killed"
        killed += status != 0
        halfway += status != 0 and not target.exists()
        if target.exists():
            assert contents(target) == whole, f"killed at call {call} of {calls}"
            shutil.rmtree(target)
    nimprep.convert(source, target, **options)
    assert contents(target) == whole
    assert {path.name for path in tmp_path.iterdir()} == {"gmrp", "s.zarr"}
    assert halfway > KILLS // 2
    print(f"killed {killed} times, {halfway} of them halfway, in {runs} runs; all bytes the same")


def test_what_a_kill_leaves_does_not_look_like_a_store(
    gmrp: Path, tmp_path: Path, processes: Processes
) -> None:
    with begun(processes, gmrp, tmp_path / "s.zarr") as process:
        process.kill()
        process.wait()
    assert not (tmp_path / "s.zarr").exists()
    partial = tmp_path / ".s.zarr.partial" / "store"
    assert not read_attributes(partial, complete=False)["complete"]
    with pytest.raises(StoreError, match="cut short"):
        nimprep.open_store(partial)
    # No array has its metadata yet, so that no other library takes it for whole either.
    assert list(partial.glob("*/zarr.json")) == []


def test_ctrl_c_says_how_to_go_on_and_exits_130(
    gmrp: Path, tmp_path: Path, processes: Processes
) -> None:
    with begun(processes, gmrp, tmp_path / "s.zarr") as process:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, errors
    lines = [line for line in errors.splitlines() if not line.startswith("warning")]
    assert len(lines) == 1, errors
    assert lines[0].startswith("interrupted; ")
    assert "the same command goes on from them" in lines[0]
    assert not (tmp_path / "s.zarr").exists()
    assert run(gmrp, tmp_path / "s.zarr", "--shard-length", "2").returncode == 0


def test_of_two_conversions_into_one_target_the_second_is_refused(
    gmrp: Path, tmp_path: Path, processes: Processes
) -> None:
    with begun(processes, gmrp, tmp_path / "s.zarr") as first:
        second = run(gmrp, tmp_path / "s.zarr", "--shard-length", "2")
        assert first.poll() is None
    assert second.returncode == 1
    assert "expected nobody else to change it, found one at work" in second.stderr
    _, errors = first.communicate(timeout=PATIENCE_S)
    assert first.returncode == 0, errors
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []
    assert {path.name for path in tmp_path.iterdir()} == {"gmrp", "s.zarr"}


def test_a_file_that_changes_while_it_is_read_is_refused(
    gmrp: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import nimprep.conversion.encode as encode

    digest = encode.frame_digest

    def meanwhile(reader: object, frame_id: str) -> str:
        found = digest(reader, frame_id)  # type: ignore[arg-type]
        if frame_id == "000005":
            write_png(gmrp / "rgb" / "000005.png", np.zeros((24, 32, 3), np.uint8))
        return found

    monkeypatch.setattr(encode, "frame_digest", meanwhile)
    with pytest.raises(DecodeError, match=r"rgb/000005\.png: expected a file that stays as it is"):
        nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2)
    assert not (tmp_path / "s.zarr").exists()


def test_a_record_that_a_fault_spoilt_is_made_again(gmrp: Path, tmp_path: Path) -> None:
    nimprep.convert(gmrp, tmp_path / "whole.zarr", shard_length=2)
    whole = cut_short(gmrp, tmp_path / "s.zarr")
    (tmp_path / ".s.zarr.partial" / "journal" / "units" / "0.json").write_bytes(b"\0\0\0")
    (gmrp / "depth_u16" / "000004.png").write_bytes(whole)
    nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2)
    assert contents(tmp_path / "s.zarr") == contents(tmp_path / "whole.zarr")


def test_what_replaces_a_store_leaves_it_until_the_new_one_is_whole(
    gmrp: Path, tmp_path: Path
) -> None:
    nimprep.convert(gmrp, tmp_path / "s.zarr", seed=1)
    before = contents(tmp_path / "s.zarr")
    whole = cut_short(gmrp, tmp_path / "s.zarr", overwrite=True)
    assert contents(tmp_path / "s.zarr") == before
    (gmrp / "depth_u16" / "000004.png").write_bytes(whole)
    store = nimprep.convert(gmrp, tmp_path / "s.zarr", shard_length=2, overwrite=True)
    assert store.attributes["split"]["seed"] == 0
