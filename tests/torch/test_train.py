"""The example that trains: it learns, goes on where it stopped, and scores what it writes."""

from __future__ import annotations

import importlib.util
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import ArrayError, LayoutError
from nimprep.synthetic import write_synthetic
from tests.conftest import PROJECT
from tests.fakes import NYU_LIKE, depth_image, write_png
from tests.thermal import use_reader, write_thermal

torch = pytest.importorskip("torch")


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """Images this small take longer on several threads than on one."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def train():
    """Return scripts/train.py as a module."""
    spec = importlib.util.spec_from_file_location("train", PROJECT / "scripts" / "train.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Return a store of 12 small synthetic frames with every modality."""
    root = tmp_path_factory.mktemp("train")
    write_synthetic(root / "raw", 12, size=(48, 64))
    nimprep.convert(root / "raw", root / "s.zarr")
    return root / "s.zarr"


def run(train, store, out, *more, epochs=3):
    arguments = [store, "--out", out, "--epochs", epochs, "--crop", 32, 48, *more]
    return train.main([str(a) for a in arguments])


def same(one, other):
    """Tell whether two results have the same losses and the same confusion matrices."""
    return one["losses"] == other["losses"] and all(
        np.array_equal(one["scores"][split].confusion, other["scores"][split].confusion)
        for split in ("val", "test")
    )


def test_the_loss_falls_and_the_command_scores_the_predictions_the_same(
    train, store, tmp_path, capsys
):
    (result,) = run(train, store, tmp_path, epochs=5)
    assert result["losses"][-1] < 0.8 * result["losses"][0]
    printed = capsys.readouterr().out
    for split in ("val", "test"):
        folder = tmp_path / "nim-rgb+d" / "predictions" / split
        told = CliRunner().invoke(main, ["evaluate", str(store), str(folder), "--json"])
        assert told.exit_code == 0
        assert json.loads(told.stdout) == result["scores"][split].to_dict()
        assert f"{result['scores'][split].mean['iou']:8.4f}" in printed


def test_a_run_that_was_cut_short_goes_on_to_the_same_result(train, store, tmp_path, monkeypatch):
    (whole,) = run(train, store, tmp_path / "whole")
    epochs = []

    def cut_short(*arguments):
        epochs.append(train_epoch(*arguments))
        if len(epochs) == 2:
            raise KeyboardInterrupt
        return epochs[-1]

    train_epoch = train.train_epoch
    with monkeypatch.context() as patched:
        patched.setattr(train, "train_epoch", cut_short)
        with pytest.raises(KeyboardInterrupt):
            run(train, store, tmp_path / "cut")
    saved = torch.load(tmp_path / "cut" / "nim-rgb+d" / "checkpoint.pt", weights_only=True)
    assert saved["epoch"] == 1
    (resumed,) = run(train, store, tmp_path / "cut", "--resume")
    assert same(resumed, whole)
    (other,) = run(train, store, tmp_path / "other", "--seed", 1)
    assert not same(other, whole)


def contents(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def no_training(*_):
    raise AssertionError("expected the place to be refused before anything is trained")


@pytest.fixture(scope="module")
def finished(train, store, tmp_path_factory):
    """Return a folder with a run of one epoch."""
    out = tmp_path_factory.mktemp("finished")
    run(train, store, out, epochs=1)
    return out


@pytest.mark.parametrize("left", ["checkpoint.pt", "predictions/test", "notes.txt"])
@pytest.mark.parametrize("more", [(), ("--setups", "all")])
def test_a_run_that_is_there_is_not_touched_unasked(
    train, store, finished, tmp_path, monkeypatch, left, more
):
    folder = tmp_path / "nim-rgb+d"
    shutil.copytree(finished / "nim-rgb+d", folder)
    (folder / "notes.txt").write_text("the good one")
    for name in {"checkpoint.pt", "predictions", "notes.txt"} - {left.split("/")[0]}:
        shutil.rmtree(folder / name) if name == "predictions" else (folder / name).unlink()
    before = contents(tmp_path)
    monkeypatch.setattr(train, "train_epoch", no_training)
    with pytest.raises(LayoutError, match=r"found '.*' in it; give --resume or --overwrite$"):
        run(train, store, tmp_path, *more)
    assert contents(tmp_path) == before


def test_a_run_is_replaced_where_that_is_asked_for(train, store, finished, tmp_path):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    before = contents(tmp_path / "nim-rgb+d")
    run(train, store, tmp_path, "--overwrite", "--seed", 1, epochs=1)
    after = contents(tmp_path / "nim-rgb+d")
    assert after.keys() == before.keys()
    assert after != before


def test_only_a_checkpoint_can_be_gone_on_from(train, store, finished, tmp_path, monkeypatch):
    shutil.copytree(finished / "nim-rgb+d" / "predictions", tmp_path / "nim-rgb+d" / "predictions")
    before = contents(tmp_path)
    monkeypatch.setattr(train, "train_epoch", no_training)
    with pytest.raises(LayoutError, match="'predictions' in it; give --overwrite or another --out"):
        run(train, store, tmp_path, "--resume")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("asked", [(), ("--resume",), ("--overwrite",)])
@pytest.mark.parametrize("way", ["itself", "its folder", "a link", "a link below"])
def test_nothing_is_written_into_a_store(train, store, tmp_path, monkeypatch, way, asked):
    ours = shutil.copytree(store, tmp_path / "s.zarr")
    before = contents(ours)
    out = {"itself": ours, "its folder": ours / "rgb"}.get(way, tmp_path / "out")
    if way == "a link":
        out.symlink_to(ours)
    if way == "a link below":
        (out / "nim-rgb+d" / "predictions").mkdir(parents=True)
        (out / "nim-rgb+d" / "predictions" / "test").symlink_to(ours)
    monkeypatch.setattr(train, "train_epoch", no_training)
    with pytest.raises(LayoutError, match="expected a place outside"):
        run(train, store, out, *asked)
    assert contents(ours) == before


def test_a_refusal_is_one_line_and_no_success(store, finished):
    script = [sys.executable, PROJECT / "scripts" / "train.py", store, "--out", finished]
    told = subprocess.run(script, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout) == (1, "")
    assert re.fullmatch(r"error: .*; give --resume or --overwrite\n", told.stderr)


def test_every_setup_and_every_fusion_has_its_row(train, store, tmp_path, capsys):
    seven = run(train, store, tmp_path, "--setups", "all", "--batch", 8, epochs=1)
    assert [result["name"] for result in seven] == list(train.SETUPS)[:7]
    assert capsys.readouterr().out.count(" test ") == 7
    three = run(train, store, tmp_path, "--setups", "all", "--fusion", "--batch", 8, epochs=1)
    assert [r["name"] for r in three] == ["rgb+d-fusion", "rgb+hha-fusion", "nim-rgb+d-fusion"]


@pytest.mark.parametrize("floor", [1, 7])
def test_frames_of_several_sizes_train_together_and_are_predicted_at_their_own(
    train, tmp_path, floor
):
    sizes = {"a": (40, 56), "b": (33, 70), "c": (48, 48), "d": (40, 56), "e": (37, 51)}
    for name, size in sizes.items():
        write_png(tmp_path / "raw" / "color" / f"{name}.png", np.full((*size, 3), 90, np.uint8))
        write_png(tmp_path / "raw" / "depth" / f"{name}.png", depth_image(1, size))
        write_png(tmp_path / "raw" / "label" / f"{name}.png", np.full(size, 40, np.uint16))
    description = {k: v for k, v in NYU_LIKE.items() if k not in ("camera", "group")}
    description["depth"] = {"files": "depth/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]}
    description["label"] = {**NYU_LIKE["label"], "map": {"40": floor}}
    description["classes"] = [NYU_LIKE["classes"][0], {**NYU_LIKE["classes"][1], "id": floor}]
    (tmp_path / "description.json").write_text(json.dumps(description))
    nimprep.convert(
        tmp_path / "raw",
        tmp_path / "s.zarr",
        description=tmp_path / "description.json",
        camera=(50, 50, 25, 20),
    )
    (result,) = run(train, tmp_path / "s.zarr", tmp_path / "out", "--batch", 2, epochs=1)
    for split in ("val", "test"):
        (frame_id,) = result["scores"][split].frames
        counted = result["scores"][split].confusion.sum()
        assert counted == sizes[frame_id][0] * sizes[frame_id][1]
        folder = tmp_path / "out" / "nim-rgb+d" / "predictions" / split
        told = CliRunner().invoke(
            main, ["evaluate", str(tmp_path / "s.zarr"), str(folder), "--json"]
        )
        assert json.loads(told.stdout) == result["scores"][split].to_dict()


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_a_setup_may_have_planes_of_the_datasets_own(train, tmp_path):
    raw = write_thermal(tmp_path / "raw", 10, (48, 64))
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        store = nimprep.convert(raw, tmp_path / "s.zarr").path
    for more in ((), ("--fusion",)):
        (result,) = run(train, store, tmp_path / "runs", "--setup", "rgb+thermal", *more, epochs=1)
        assert np.isfinite(result["losses"]).all()
    with pytest.raises(ArrayError, match=r"setup: expected one of rgb, .*found 'rgb.termal'"):
        run(train, store, tmp_path / "none", "--setup", "rgb+termal", epochs=1)
    assert not (tmp_path / "none").exists()
