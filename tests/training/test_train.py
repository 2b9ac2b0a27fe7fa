"""A training learns, says how it goes, and leaves what was best."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import torch
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.cli.training_watcher import watcher_for
from nimprep.errors import ArrayError, StoreError
from nimprep.networks import build_network, read_checkpoint
from nimprep.options import options_of
from nimprep.store.reader import open_store
from nimprep.synthetic import write_synthetic
from nimprep.torch import StoreDataset
from nimprep.training import TrainOptions, train
from nimprep.training.log import check_tensorboard
from nimprep.training.options import TrainKeywords
from tests.conftest import PROJECT
from tests.fakes import NYU_LIKE, depth_image, write_png
from tests.processes import same_code
from tests.thermal import use_reader, write_thermal
from tests.training.stores import SMALL, log_lines, make_store, same_tensors, weights


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of 12 synthetic frames of 64x80."""
    root = tmp_path_factory.mktemp("scenes")
    write_synthetic(root / "raw", 12, size=(64, 80))
    nimprep.convert(root / "raw", root / "s.zarr")
    return root / "s.zarr"


@pytest.fixture(scope="module")
def learned(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of eight epochs."""
    out = tmp_path_factory.mktemp("learned") / "run"
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "nim-rgb+d", "width": 0.25}
    train(scenes, out, **options, epochs=8, lr=0.1, clip=1.0, log_steps=2, metric="iou")
    return out


def test_the_loss_falls_and_the_best_epoch_is_kept(learned: Path) -> None:
    lines = [line for line in log_lines(learned) if "epoch" in line]
    assert [line["epoch"] for line in lines] == list(range(1, 9))
    assert lines[-1]["loss"] < 0.8 * lines[0]["loss"]
    scores = [line["val"]["iou"] for line in lines]
    checkpoint = read_checkpoint(learned)
    assert checkpoint.figures["epoch"] == 1 + int(np.argmax(scores))
    assert checkpoint.figures["iou"] == max(scores)
    assert [line["best"] for line in lines] == [
        score > max([-1.0, *scores[:i]]) for i, score in enumerate(scores)
    ]
    between = [line for line in log_lines(learned) if "epoch" not in line]
    assert [line["step"] for line in between] == list(range(2, lines[-1]["step"] + 1, 2))


def test_scores_are_those_of_a_plain_loop(scenes: Path, learned: Path) -> None:
    checkpoint = read_checkpoint(learned)
    network = build_network("mfnet", (3, 3), 3, 0.25, learned / "best.pt").eval()
    data = StoreDataset(scenes, "val", "nim-rgb+d", fusion=True)
    hits, either = np.zeros(3), np.zeros(3)
    for sample in data:
        with torch.no_grad():
            guess = network(*(image[None] for image in sample["inputs"])).argmax(1)[0]
        for place in range(3):
            known = sample["label"] != 255
            a, b = (sample["label"] == place) & known, (guess == place) & known
            hits[place] += int((a & b).sum())
            either[place] += int((a | b).sum())
    assert checkpoint.figures["iou"] == pytest.approx((hits / either)[1:].mean(), abs=1e-12)


def test_a_checkpoint_says_all_there_is_to_use_it(scenes: Path, learned: Path) -> None:
    found = read_checkpoint(learned)
    assert (found.network, found.setup, found.width, found.stages) == (
        *("mfnet", "nim-rgb+d", 0.25, 5),
    )
    assert (found.groups, found.channels) == ((("rgb",), ("normal",)), (3, 3))
    assert found.classes == open_store(scenes).classes
    assert found.scale == {"rgb": (1 / 255,) * 3}
    assert (found.recipe["normals"], found.normal_dtype, found.size) == ("nim", "int8", (64, 80))
    assert found.version == nimprep.__version__
    assert found.build()(torch.zeros(1, 3, 64, 64), torch.zeros(1, 3, 64, 64)).shape == (
        *(1, 3, 64, 64),
    )


def test_normals_may_be_computed_as_frames_are_read(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "unet", "setup": "nim-depth", "epochs": 1}
    train(store, tmp_path / "run", **options, normals="nim-edge", normalize="train")
    found = read_checkpoint(tmp_path / "run")
    assert (found.recipe["normals"], found.normal_dtype) == ("nim-edge", None)
    plain = make_store(tmp_path / "plain", modalities=("rgb", "depth", "label"))
    train(plain, tmp_path / "other", **options)
    assert read_checkpoint(tmp_path / "other").recipe["normals"] == "nim"


def test_a_run_begins_with_the_weights_of_another(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "epochs": 1}
    train(store, tmp_path / "a", **options)
    train(store, tmp_path / "b", **options, weights=tmp_path / "a" / "best.pt", lr=0.0)
    learned, kept = (weights(tmp_path / run) for run in "ab")
    names = [name for name in learned if "running" not in name and "tracked" not in name]
    assert same_tensors({n: learned[n] for n in names}, {n: kept[n] for n in names})
    (tmp_path / "a" / "best.pt").unlink()
    # Not needed any more where the run has weights of its own.
    train(store, tmp_path / "b", **options, weights=tmp_path / "a" / "best.pt", lr=0.0)


def test_without_val_the_last_weights_are_kept_and_that_is_said(tmp_path: Path) -> None:
    lists = tmp_path / "lists"
    lists.mkdir()
    for name, ids in (("train", range(3)), ("val", ()), ("test", (3,))):
        (lists / f"{name}.txt").write_text("".join(f"{n:06d}\n" for n in ids))
    store = make_store(tmp_path, 4, split_file=lists)
    call = ["train", str(store), "--network", "mfnet", "--setup", "rgb+d", "--width", "0.125"]
    call += ["--epochs", "2", "--out", str(tmp_path / "run"), "--schedule", "plateau"]
    told = CliRunner().invoke(main, call)
    assert told.exit_code == 0, told.output
    assert "no frames in val; best.pt has the last epoch's weights\n" in told.stderr
    assert "on val" not in told.stdout
    assert read_checkpoint(tmp_path / "run").figures["epoch"] == 2
    assert [line["val"] for line in log_lines(tmp_path / "run")] == [None, None]
    assert same_tensors(weights(tmp_path / "run"), weights(tmp_path / "run", "best.pt"))


def test_a_store_that_cannot_be_trained_on_is_one_line(tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d"}
    small = tmp_path / "small"
    from tests.torch.stores import make_store as make_small

    small.mkdir()
    with pytest.raises(StoreError, match="expected frames of 64x64 pixels or more, found 32x24"):
        train(make_small(small), tmp_path / "run", **options)
    with pytest.raises(StoreError, match="expected labels, found none"):
        train(
            make_store(tmp_path / "none", labels=False, modalities=None),
            tmp_path / "run",
            **options,
        )
    with pytest.raises(nimprep.NimprepError, match="nowhere"):
        train(tmp_path / "nowhere.zarr", tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()


def test_frames_of_several_sizes_and_any_ids_train_together(tmp_path: Path) -> None:
    sizes = {"a": (64, 80), "b": (70, 70), "c": (66, 72), "d": (64, 80), "e": (65, 71)}
    for name, size in sizes.items():
        write_png(tmp_path / "raw" / "color" / f"{name}.png", np.full((*size, 3), 90, np.uint8))
        write_png(tmp_path / "raw" / "depth" / f"{name}.png", depth_image(1, size))
        write_png(tmp_path / "raw" / "label" / f"{name}.png", np.full(size, 40, np.uint16))
    description = {k: v for k, v in NYU_LIKE.items() if k not in ("camera", "group")}
    description["depth"] = {"files": "depth/{id}.png", "scale_m": 0.001, "invalid": [0, 65535]}
    description["label"] = {**NYU_LIKE["label"], "map": {"40": 7}}
    description["classes"] = [NYU_LIKE["classes"][0], {**NYU_LIKE["classes"][1], "id": 7}]
    (tmp_path / "description.json").write_text(json.dumps(description))
    store = nimprep.convert(
        tmp_path / "raw",
        tmp_path / "s.zarr",
        description=tmp_path / "description.json",
        camera=(50, 50, 25, 20),
    )
    train(store, tmp_path / "run", **SMALL, network="mfnet", setup="rgb+d", epochs=1)
    (line,) = log_lines(tmp_path / "run")
    assert line["val"]["classes"].keys() == {"other", "floor"}
    assert read_checkpoint(tmp_path / "run").classes[1].id == 7


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_a_setup_may_have_planes_and_mixes(tmp_path: Path) -> None:
    raw = write_thermal(tmp_path / "raw", 8, (64, 80))
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        store = nimprep.convert(raw, tmp_path / "s.zarr").path
    for number, (network, setup, groups) in enumerate(
        [
            ("mfnet", "rgb+thermal", (("rgb",), ("thermal",))),
            ("unet", ("rgb", "normal", "thermal"), (("rgb", "normal", "thermal"),)),
            ("depthaware", ("rgb", "normal+thermal"), (("rgb",), ("normal", "thermal"))),
        ]
    ):
        out = tmp_path / str(number)
        train(store, out, **SMALL, network=network, setup=setup, epochs=1)
        found = read_checkpoint(out)
        assert (found.groups, found.setup) == (groups, setup)


def test_bfloat16_trains_on_a_cpu_too(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "epochs": 1}
    train(store, tmp_path / "half", **options, amp="on")
    train(store, tmp_path / "whole", **options)
    half, whole = (log_lines(tmp_path / run)[0]["loss"] for run in ("half", "whole"))
    assert half != whole
    assert half == pytest.approx(whole, rel=0.02)
    kinds = {v.dtype for v in weights(tmp_path / "half").values()}
    assert kinds == {torch.float32, torch.int64}


# The command.


def test_the_command_says_epochs_and_the_best(scenes: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    call = ["train", str(scenes), "--out", str(out), "--network", "unet", "--setup", "rgb,normal"]
    call += ["--width", "0.0625", "--epochs", "2", "--batch", "3", "--threads", "1"]
    told = CliRunner().invoke(main, call)
    assert told.exit_code == 0, told.output
    lines = told.stderr.splitlines()
    assert [line.split(":")[0] for line in lines] == ["epoch 1", "epoch 2"]
    assert ", IoU " in lines[0]
    assert lines[0].endswith(" s left")
    steps, best = told.stdout.splitlines()
    assert steps.endswith("run: 4 steps, 2 epochs")
    assert best.startswith("best.pt: epoch ")
    assert best.endswith(" % (mean without background)")
    assert tomllib.loads((out / "config.toml").read_text())["setup"] == ["rgb", "normal"]
    again = CliRunner().invoke(main, [*call, "--quiet"])
    assert again.stderr.startswith("the run is complete")
    assert again.stdout == told.stdout


def test_a_person_sees_a_bar(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    bar = watcher_for(quiet=False)
    bar.begin(2, 4)
    bar.step(3, 0.5)
    bar.epoch({"epoch": 1, "loss": 0.5, "val": {"iou": 0.25, "f_score": None}, "best": True}, 61)
    bar.step(4, 0.25)
    bar.end()
    shown = capsys.readouterr().err
    assert "epoch 1: loss 0.5000, IoU 25.00, best so far, 1 min 01 s left" in shown
    assert "IoU 25.00" in shown.rsplit("\r", 1)[-1]


def test_lines_come_at_most_every_half_minute(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr("nimprep.cli.training_watcher.time.monotonic", lambda: now[0])
    lines = watcher_for(quiet=False)
    lines.begin(10, 110)
    for step in range(11, 61):
        now[0] += 1
        lines.step(step, 0.125)
    assert capsys.readouterr().err == "step 40/110: loss 0.1250, 1 min 10 s left\n"
    quiet = watcher_for(quiet=True)
    quiet.begin(0, 10)
    now[0] += 100
    quiet.step(1, 0.5)
    quiet.epoch({"epoch": 1, "loss": 0.5, "val": None, "best": True}, 5000)
    assert capsys.readouterr().err == ""


def test_a_wrong_call_is_exit_code_2(store: Path, tmp_path: Path) -> None:
    call = ["train", str(store), "--out", str(tmp_path / "run")]
    for more, said in [
        ([], "--network: expected one, found none; give it, or --config with one"),
        (["--network", "unet"], "--setup: expected one, found none"),
        (["--network", "resnet"], "'resnet' is not one of"),
        (["--network", "unet", "--setup", "rgb", "--crop", "a"], "expected H,W, found 'a'"),
        (["--network", "unet", "--setup", "rgb", "--scale", "2,1"], "--scale: expected two"),
        (["--network", "unet", "--setup", "rgb", "--epochs", "0"], "0 is not in the range"),
        (["--network", "unet", "--setup", "rgb", "--width", "0"], "--width: expected a number"),
        # These only the store, the network or the machine shows.
        (["--network", "unet", "--setup", "rgbd"], "--setup: expected one of rgb, depth"),
        (["--network", "mfnet", "--setup", "rgb"], "--setup: expected one of two parts for mfnet"),
        (["--network", "unet", "--setup", "rgb", "--crop", "32,64"], "--crop: expected 64,64"),
        (["--network", "unet", "--setup", "rgb", "--head-lr", "3"], "--head-lr: expected 1 for"),
        (["--network", "unet", "--setup", "rgb", "--stages", "3"], "--stages: expected none"),
        (["--network", "unet", "--setup", "rgb", "--device", "gpu"], "--device: expected auto"),
    ]:
        told = CliRunner().invoke(main, [*call, *more])
        assert told.exit_code == 2
        assert said in told.stderr
    assert not (tmp_path / "run").exists()


def test_the_command_has_just_the_options_that_the_fields_say() -> None:
    found: Any = main.get_command(click.Context(main), "train")
    given = {p.name: p for p in found.params if isinstance(p, click.Option)}
    options = options_of(TrainOptions)
    assert given.keys() - options.keys() == {"out", "config", "quiet"}
    assert options.keys() <= given.keys()
    for name, option in options.items():
        assert given[name].default == option.default, name
        assert (given[name].help or "") == option.help, name
        assert tuple(getattr(given[name].type, "choices", ())) == option.choices, name
        assert f"    {name} : " in TrainOptions.__doc__
    assert TrainKeywords.__annotations__.keys() == options.keys()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"epochs": 0}, "epochs: expected 1 or more"),
        ({"batch": 1.5}, "batch: expected a whole number"),
        ({"lr": "0.1"}, "lr: expected a finite number"),
        ({"setup": 3}, "setup: expected a name"),
        ({"setup": ()}, "setup: expected a name"),
        ({"crop": "all"}, "crop: expected 'none' or two"),
        ({"scale": (1.0,)}, "scale: expected two numbers"),
        ({"momentum": 1.0}, "momentum: expected 0.9999 or less"),
        ({"amp": True}, "amp: expected one of auto"),
    ],
)
def test_wrong_options_are_told(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ArrayError, match=f"^{said}"):
        TrainOptions(**wrong)


WITHOUT_TORCH = """
import sys
sys.modules["torch"] = None
import importlib.util as util
find_spec = util.find_spec
util.find_spec = lambda name, *rest: None if name == "torch" else find_spec(name, *rest)
from nimprep.cli import main
main(sys.argv[1:])
"""


def test_without_torch_help_is_there_and_training_names_the_extra(tmp_path: Path) -> None:
    def run(*call: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", WITHOUT_TORCH, *call]
        return subprocess.run(
            command, capture_output=True, text=True, check=False, env=same_code(), cwd=PROJECT
        )

    for call in (["--help"], ["train", "--help"]):
        told = run(*call)
        assert told.returncode == 0, told.stderr
    assert "--network" in told.stdout
    told = run(
        "train", "s.zarr", "--network", "unet", "--setup", "rgb", "--out", str(tmp_path / "r")
    )
    assert told.returncode == 1
    assert told.stderr.count("\n") == 1
    assert "pip install 'nimprep[torch]'" in told.stderr


def test_tensorboard_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nimprep.training.log.find_spec", lambda name: None)
    check_tensorboard(False)
    with pytest.raises(ArrayError, match=r"pip install 'nimprep\[tensorboard\]'"):
        check_tensorboard(True)


def test_tensorboard_gets_what_the_log_does(store: Path, tmp_path: Path) -> None:
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": "rgb+d", "epochs": 2}
    train(store, tmp_path / "run", **options, tensorboard=True, log_steps=1)
    events = accumulator.EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    lines = [line for line in log_lines(tmp_path / "run") if "epoch" in line]
    for name in ("iou", "f_score"):
        found = events.Scalars(f"val/{name}")
        assert [e.step for e in found] == [line["step"] for line in lines]
        assert [e.value for e in found] == pytest.approx([line["val"][name] for line in lines])
    assert [e.step for e in events.Scalars("loss")] == [1, 2, 3, 4]
    assert [e.step for e in events.Scalars("epoch/loss")] == [2, 4]
