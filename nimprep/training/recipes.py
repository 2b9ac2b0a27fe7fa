"""How each network is trained where nothing else is said: as its authors did."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from nimprep.training.options import (
    ClassWeights,
    NetworkName,
    Optimizer,
    Rates,
    Size,
    TrainOptions,
)


class TrainRecipe(NamedTuple):
    """Hold what `TrainOptions` has None for; `source` says whose it is."""

    source: str
    optimizer: Optimizer
    lr: float
    momentum: float
    weight_decay: float
    schedule: Rates
    batch: int
    crop: Size
    gamma: float = 0.9
    period: int = 25
    power: float = 0.9
    head_lr: float = 1.0
    class_weights: ClassWeights = "none"


_GROUP = TrainRecipe(
    "SNE-RoadSeg on KITTI road, by the paper's group",
    "sgd",
    lr=0.001,
    momentum=0.9,
    weight_decay=5e-4,
    schedule="step",
    batch=2,
    crop=(384, 1248),
)
_RTFNET = TrainRecipe(
    "RTFNet's authors",
    "sgd",
    lr=0.01,
    momentum=0.9,
    weight_decay=5e-4,
    schedule="exponential",
    gamma=0.95,
    batch=2,
    crop=(480, 640),
)

RECIPES: dict[NetworkName, TrainRecipe] = {
    "fcn8s": _GROUP,
    "segnet": _GROUP,
    "unet": TrainRecipe(
        "the most used implementation",
        "rmsprop",
        lr=1e-5,
        momentum=0.9,
        weight_decay=0.0,
        schedule="plateau",
        gamma=0.1,
        period=10,
        batch=1,
        crop="none",
    ),
    "deeplabv3plus": TrainRecipe(
        "its most used implementation",
        "sgd",
        lr=0.007,
        momentum=0.9,
        weight_decay=5e-4,
        schedule="poly",
        head_lr=10.0,
        batch=16,
        crop=(513, 513),
    ),
    "denseaspp": _GROUP,
    "dupsampling": _GROUP,
    "espnet": TrainRecipe(
        "its authors",
        "adam",
        lr=5e-4,
        momentum=0.9,
        weight_decay=5e-4,
        schedule="step",
        gamma=0.5,
        period=100,
        class_weights="espnet",
        batch=6,
        crop="none",
    ),
    "gscnn": _GROUP,
    "fusenet": TrainRecipe(
        "its authors",
        "sgd",
        lr=0.005,
        momentum=0.9,
        weight_decay=5e-4,
        schedule="step",
        batch=4,
        crop=(240, 320),
    ),
    "depthaware": TrainRecipe(
        "its authors",
        "sgd",
        lr=2.5e-4,
        momentum=0.9,
        weight_decay=4e-4,
        schedule="poly",
        batch=1,
        crop="none",
    ),
    "mfnet": _RTFNET._replace(source="MFNet's authors", batch=8),
    "rtfnet18": _RTFNET._replace(batch=4),
    "rtfnet34": _RTFNET._replace(batch=4),
    "rtfnet50": _RTFNET,
    "rtfnet101": _RTFNET,
    "rtfnet152": _RTFNET,
}
"""What each network's authors did, where their figures are known; else what the paper's group did.

Of figures that are not known (momentum 0.9 where there is none, U-Net's factor and patience, the
batch within the range that RTFNet's authors give), the ones here are ours.
"""

RECIPE_OPTIONS = tuple(name for name in TrainRecipe._fields if name != "source")


def completed(options: TrainOptions, size: tuple[int, int]) -> TrainOptions:
    """Return options with the recipe's where none are given, for frames of this size.

    Windows are no larger than frames, but at least what every network takes.
    """
    assert options.network is not None
    recipe = RECIPES[options.network]
    missing = {n: getattr(recipe, n) for n in RECIPE_OPTIONS if getattr(options, n) is None}
    crop = missing.get("crop")
    if isinstance(crop, tuple):
        missing["crop"] = (min(crop[0], size[0]), min(crop[1], size[1]))
    return replace(options, **missing)
