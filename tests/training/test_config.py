"""Options in a file are as good as on the command line; a run writes those that it used."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.errors import ArrayError, LayoutError
from nimprep.training import TrainOptions, train
from nimprep.training.config import KEPT, config_text, plain_options, read_config
from tests.training.stores import SMALL, same_tensors, weights


def test_a_runs_file_gives_the_same_run(store: Path, tmp_path: Path) -> None:
    options: dict[str, Any] = {**SMALL, "network": "mfnet", "setup": ("rgb", "depth"), "epochs": 1}
    train(store, tmp_path / "a", **options, lr=0.02, scale=(0.75, 1.5))
    train(store, tmp_path / "b", config=tmp_path / "a" / "config.toml")
    assert same_tensors(weights(tmp_path / "a"), weights(tmp_path / "b"))
    one, other = ((tmp_path / run / "config.toml").read_text() for run in "ab")
    assert one == other
    found = tomllib.loads(one)
    unsaid = {"weights", "checkpoint_steps"}
    assert found.keys() == {*KEPT} - unsaid
    assert (found["lr"], found["scale"], found["crop"]) == (0.02, [0.75, 1.5], [64, 64])
    assert found["setup"] == ["rgb", "depth"]
    assert (found["momentum"], found["schedule"], found["gamma"]) == (0.9, "exponential", 0.95)


ODD = TrainOptions(
    network="unet",
    setup=("rgb", 'a "b"\\\x7f\té'),
    weights="/w\N{WINE GLASS}.pth",
    lr=1e-12,
    crop=(64, 96),
    scale=(0.5, 2.0),
    clip=1.0,
    checkpoint_steps=3,
    tensorboard=True,
)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    for options in (ODD, TrainOptions(), TrainOptions(setup="rgb", crop="none")):
        (tmp_path / "c.toml").write_text(config_text(options, "of what"), "utf-8")
        assert TrainOptions(**read_config(tmp_path / "c.toml")) == options
        assert {*plain_options(options)} == {*KEPT}


def test_the_command_line_wins_over_the_file(store: Path, tmp_path: Path) -> None:
    config = tmp_path / "c.toml"
    config.write_text(
        'network = "mfnet"\nsetup = "rgb+d"\nwidth = 0.125\nepochs = 3\nseed = 4\n'
        "weight-decay = 0.25\nbatch = 4\nthreads = 1\n"
    )
    call = ["train", str(store), "--out", str(tmp_path / "run"), "--config", str(config)]
    # 0 is the default too, and said all the same.
    told = CliRunner().invoke(main, [*call, "--epochs", "1", "--seed", "0", "--crop", "64,64"])
    assert told.exit_code == 0, told.output
    found = tomllib.loads((tmp_path / "run" / "config.toml").read_text())
    assert [found[n] for n in ("epochs", "seed", "weight_decay", "width")] == [1, 0, 0.25, 0.125]


def test_weights_are_found_from_the_files_folder(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text('weights = "vgg.pth"\n')
    assert read_config(tmp_path / "c.toml")["weights"] == str(tmp_path / "vgg.pth")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lr = ", "expected TOML, found .*see docs/training.md"),
        ("learning_rate = 1", "expected some of network, .*found 'learning_rate'; leave it out"),
        ("overwrite = true", "expected some of network, .*found 'overwrite'"),
        ("config = 'x'", "expected some of network, .*found 'config'"),
        ('lr = "0.1"', "lr: expected a finite number, found '0.1'"),
        ("epochs = 0", "epochs: expected 1 or more, found 0"),
        ("crop = [1]", "crop: expected 'none' or two whole numbers"),
        ("crop = [1.5, 2]", "crop: expected 'none' or two whole numbers"),
        ("scale = [2, 1]", "scale: expected two numbers, 0 < low <= high"),
        ("setup = [1]", "setup: expected a name, or a tuple of names"),
        ('network = "resnet"', "network: expected one of fcn8s"),
        ("width = 0", "width: expected a number above 0"),
        ("[train]\nlr = 1", "expected some of network, .*found 'train'"),
    ],
)
def test_a_file_that_is_wrong_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(LayoutError, match=rf"c\.toml: {said}"):
        read_config(tmp_path / "c.toml")
    told = CliRunner().invoke(
        main, ["train", "none.zarr", "--out", "run", "--config", str(tmp_path / "c.toml")]
    )
    assert told.exit_code == 1
    assert told.stderr.count("\n") == 1


def test_what_is_no_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LayoutError, match="expected a readable TOML file, found"):
        read_config(tmp_path / "nowhere.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(LayoutError, match="expected TOML, found"):
        read_config(tmp_path / "bytes.toml")


def test_options_are_given_whole_or_by_name(store: Path, tmp_path: Path) -> None:
    with pytest.raises(ArrayError, match="options: expected them or others by name, found both"):
        train(store, tmp_path / "run", TrainOptions(), epochs=3)
