"""Each network trains in each of its setups."""

from __future__ import annotations

import math
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args

import pytest
import torch

from nimprep.networks import NETWORKS, build_network, read_checkpoint
from nimprep.torch import SETUPS, StoreDataset
from nimprep.training import RECIPES, TrainOptions, train
from nimprep.training.options import NetworkName
from nimprep.training.recipes import RECIPE_OPTIONS, completed
from tests.training.stores import SMALL, log_lines, make_store

PAPER = list(SETUPS)[:7]
PAIRS = [setup for setup in PAPER if len(SETUPS[setup]) == 2]
TWELVE = [*list(RECIPES)[:11], "rtfnet18"]
EVERY = [
    (network, setup)
    for network in TWELVE
    for setup in (PAIRS if NETWORKS[network].fusion else PAPER)
]


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of three frames, one in each split."""
    return make_store(tmp_path_factory.mktemp("two"), 3)


def test_there_are_twelve_networks_and_all_of_the_papers_setups() -> None:
    assert len(EVERY) == 8 * 7 + 4 * 3
    assert [*get_args(NetworkName)] == [*RECIPES] == [*NETWORKS]


@pytest.mark.parametrize(("network", "setup"), EVERY, ids=["-".join(pair) for pair in EVERY])
def test_a_network_trains_two_steps_in_its_setup(
    two: Path, tmp_path: Path, network: Any, setup: str
) -> None:
    options = {**SMALL, "batch": 1, "width": 0.03, "epochs": 2, "lr": 1e-4, "head_lr": 1.0}
    trained = train(two, tmp_path / "run", network=network, setup=setup, **options)
    assert trained.steps == 2
    lines = log_lines(tmp_path / "run")
    assert [line["step"] for line in lines] == [1, 2]
    assert all(math.isfinite(line["loss"]) and line["loss"] > 0 for line in lines)
    checkpoint = read_checkpoint(tmp_path / "run")
    assert (
        checkpoint.groups
        == StoreDataset(two, setup=setup, fusion=NETWORKS[network].fusion).selection.groups
    )
    torch.manual_seed(options.get("seed", 0))
    begun = build_network(network, checkpoint.channels, 3, options["width"]).state_dict()
    learned = {k for k, v in checkpoint.state.items() if not torch.equal(v, begun[k])}
    # Biases before a normalisation get no gradient, and ESPNet's slopes may be alike.
    assert len(learned) > len(begun) / 2
    for name, part in (("dupsampling", "auxiliary_head.0.0"), ("gscnn", "shape.edge")):
        assert network != name or f"{part}.weight" in learned


@pytest.mark.parametrize("network", RECIPES)
def test_a_recipe_says_all_that_is_left_open(network: Any) -> None:
    options = completed(TrainOptions(network=network, setup="rgb"), (375, 1242))
    open_ones = {f.name for f in fields(TrainOptions) if f.default is None} - {
        *("network", "setup", "scale", "weights", "threads", "checkpoint_steps")
    }
    assert open_ones == {*RECIPE_OPTIONS}
    assert all(getattr(options, name) is not None for name in RECIPE_OPTIONS)
    if isinstance(options.crop, tuple):
        assert options.crop[0] <= 375
        assert options.crop[1] <= 1242
    kept = completed(TrainOptions(network=network, lr=0.5, crop=(400, 2000)), (375, 1242))
    assert (kept.lr, kept.crop) == (0.5, (400, 2000))


def test_recipes_are_those_of_the_authors() -> None:
    def said(network: Any, *names: str) -> list[Any]:
        return [getattr(RECIPES[network], name) for name in names]

    plain = ("optimizer", "lr", "momentum", "weight_decay", "schedule", "gamma")
    assert said("rtfnet50", *plain) == ["sgd", 0.01, 0.9, 5e-4, "exponential", 0.95]
    assert said("mfnet", *plain, "batch") == [*said("rtfnet18", *plain), 8]
    assert said("fusenet", "optimizer", "lr", "schedule", "gamma", "period") == [
        *("sgd", 0.005, "step", 0.9, 25)
    ]
    assert said("depthaware", "lr", "weight_decay", "schedule", "power", "batch") == [
        *(2.5e-4, 4e-4, "poly", 0.9, 1)
    ]
    assert said("deeplabv3plus", "lr", "head_lr", "schedule", "batch", "crop") == [
        *(0.007, 10, "poly", 16, (513, 513))
    ]
    assert said("espnet", "optimizer", "lr", "weight_decay", "gamma", "period") == [
        *("adam", 5e-4, 5e-4, 0.5, 100)
    ]
    assert RECIPES["espnet"].class_weights == "espnet"
    assert said("unet", "optimizer", "lr", "schedule", "batch") == ["rmsprop", 1e-5, "plateau", 1]
    assert said("segnet", *plain, "period", "batch", "crop") == [
        *("sgd", 0.001, 0.9, 5e-4, "step", 0.9, 25, 2, (384, 1248))
    ]
