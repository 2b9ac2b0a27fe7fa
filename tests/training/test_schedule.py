"""Learning rates are what their formulas say."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from nimprep.errors import ArrayError
from nimprep.networks import build_network
from nimprep.training import TrainOptions
from nimprep.training.optimization import optimizer_for, set_rate
from nimprep.training.recipes import completed
from nimprep.training.schedule import Schedule


def options(**changes: Any) -> TrainOptions:
    given = {"network": "fusenet", "setup": "rgb+d", "epochs": 10, **changes}
    return completed(TrainOptions(**given), (64, 64))


STEPS = 5
"""Of an epoch; 50 in all."""


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"schedule": "constant"}, lambda s: 1.0),
        ({"schedule": "exponential", "gamma": 0.95}, lambda s: 0.95 ** (s // STEPS)),
        ({"schedule": "step", "gamma": 0.5, "period": 3}, lambda s: 0.5 ** (s // STEPS // 3)),
        ({"schedule": "poly", "power": 0.9}, lambda s: (1 - s / 50) ** 0.9),
        ({"schedule": "cosine"}, lambda s: 0.5 * (1 + math.cos(math.pi * s / 50))),
        ({"schedule": "constant", "warmup": 2}, lambda s: min(1, (s + 1) / 10)),
        (
            {"schedule": "poly", "power": 2, "warmup": 0.6},
            lambda s: min(1, (s + 1) / 3) * (1 - s / 50) ** 2,
        ),
    ],
)
def test_a_rate_is_that_of_its_formula(given: dict[str, Any], expected: Any) -> None:
    schedule = Schedule(options(**given), STEPS)
    found = [schedule.factor(step) for step in range(50)]
    assert found == pytest.approx([expected(step) for step in range(50)], rel=1e-12)


def test_a_plateau_counts_the_epochs_that_bring_nothing() -> None:
    schedule = Schedule(options(schedule="plateau", gamma=0.5, period=2), STEPS)
    found = []
    for score in (0.1, 0.3, 0.3, 0.2, 0.4, math.nan, 0.1, 0.1, 0.1):
        schedule.end_epoch(score)
        found.append(schedule.factor(0))
    assert found == [1, 1, 1, 0.5, 0.5, 0.5, 0.25, 0.25, 0.125]
    again = Schedule(options(schedule="plateau", gamma=0.5, period=2), STEPS)
    again.load_state_dict(schedule.state_dict())
    again.end_epoch(0.39)
    schedule.end_epoch(0.39)
    assert again.factor(3) == schedule.factor(3)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("sgd", torch.optim.SGD),
        ("adam", torch.optim.Adam),
        ("adamw", torch.optim.AdamW),
        ("rmsprop", torch.optim.RMSprop),
    ],
)
def test_an_optimiser_has_the_options(name: Any, kind: type) -> None:
    network = build_network("fusenet", (3, 1), 3, 0.125)
    given = options(optimizer=name, lr=0.5, momentum=0.25, weight_decay=0.125)
    optimizer = optimizer_for(network, given)
    assert type(optimizer) is kind
    (group,) = optimizer.param_groups
    assert (group["lr"], group["weight_decay"]) == (0.5, 0.125)
    assert group.get("momentum", 0.25) == 0.25
    assert len(group["params"]) == sum(p.requires_grad for p in network.parameters())
    assert set_rate(optimizer, 0.5) == 0.25
    assert set_rate(optimizer, 1) == 0.5


def test_heads_learn_at_their_own_rate() -> None:
    network = build_network("deeplabv3plus", 3, 3, 0.0625)
    given = options(network="deeplabv3plus", lr=0.01)
    inner, outer = optimizer_for(network, given).param_groups
    assert (inner["lr"], outer["lr"]) == pytest.approx((0.01, 0.1))
    assert {id(p) for p in inner["params"]} == {id(p) for p in network.encoder.parameters()}
    every = len([*network.parameters()])
    assert len(inner["params"]) + len(outer["params"]) == every
    with pytest.raises(ArrayError, match="head_lr: expected 1 for mfnet, found 2; it has no enc"):
        optimizer_for(build_network("mfnet", (3, 1), 3), options(network="mfnet", head_lr=2.0))
