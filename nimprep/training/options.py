"""How a network is trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, TypedDict

from nimprep.errors import ArrayError
from nimprep.options import Options, documented, option

NetworkName = Literal[
    "fcn8s",
    "segnet",
    "unet",
    "deeplabv3plus",
    "denseaspp",
    "dupsampling",
    "espnet",
    "gscnn",
    "fusenet",
    "depthaware",
    "mfnet",
    "rtfnet18",
    "rtfnet34",
    "rtfnet50",
    "rtfnet101",
    "rtfnet152",
]
Optimizer = Literal["sgd", "adam", "adamw", "rmsprop"]
Rates = Literal["constant", "exponential", "step", "poly", "cosine", "plateau"]
ClassWeights = Literal["none", "inverse", "median", "effective", "enet", "espnet"]
Metric = Literal["f_score", "iou"]
Size = Literal["none"] | tuple[int, int]


@documented
@dataclass(frozen=True, kw_only=True)
class TrainOptions(Options):
    """Say how a network is trained on a store.

    What is None comes from the network's recipe (`nimprep.training.RECIPES`) where it is one of
    the recipe's. In Python `setup` may be a tuple, as `StoreDataset` takes it, `crop` is (height,
    width) and `scale` (low, high).
    """

    network: NetworkName | None = option(None, "Which; it must be said here or in --config.")
    setup: str | tuple[str, ...] | None = option(
        None,
        "What it is given: rgb, depth, hha, rgb+d, rgb+hha, nim-depth, nim-rgb+d, or another that "
        "StoreDataset takes, a comma between what two encoders get. Said here or in --config.",
        metavar="SETUP",
    )
    epochs: int = option(100, least=1)
    batch: int | None = option(
        None, "Frames a step, in each process; default: the recipe's.", least=1
    )
    crop: Size | None = option(
        None,
        "Train on windows of this many pixels, or on whole frames; default: the recipe's size, as "
        "far as frames have it.",
        metavar="H,W|none",
    )
    optimizer: Optimizer | None = option(None, "default: the recipe's.")
    lr: float | None = option(None, "Learning rate; default: the recipe's.", least=0)
    momentum: float | None = option(
        None, "Of sgd and rmsprop; default: the recipe's.", least=0, most=0.9999
    )
    weight_decay: float | None = option(None, "default: the recipe's.", least=0)
    head_lr: float | None = option(
        None, "Times lr for all but the encoders; default: the recipe's.", least=0
    )
    schedule: Rates | None = option(
        None,
        "How the learning rate falls: by gamma each epoch, by gamma each PERIOD epochs, as (1 - "
        "done) ** power, as half a cosine, by gamma where PERIOD epochs bring nothing better; "
        "default: the recipe's.",
    )
    gamma: float | None = option(
        None,
        "Factor of exponential, step and plateau; default: the recipe's.",
        least=0,
        most=1,
    )
    period: int | None = option(None, "Epochs of step and plateau; default: the recipe's.", least=1)
    power: float | None = option(None, "Of poly; default: the recipe's.", least=0)
    warmup: float = option(0.0, "Epochs in which the learning rate rises from 0.", least=0)
    class_weights: ClassWeights | None = option(
        None, "Weigh rare classes more, by the store's counts; default: the recipe's."
    )
    clip: float = option(0.0, "Most that the gradient's norm may be; 0 = any.", least=0)
    flip: float = option(0.5, "How likely a frame is mirrored.", least=0, most=1)
    color: float = option(
        0.3,
        "How far brightness, contrast and saturation change, hue a sixth.",
        least=0,
        most=1,
    )
    scale: tuple[float, float] | None = option(
        None, "Scale frames by a factor between these; default: as they are.", metavar="LOW,HIGH"
    )
    width: float = option(1.0, "Of the network's channels: less for small machines.", most=1)
    stages: int = option(5, "Of fusenet: how many are fused.", least=1, most=5)
    weights: Path | str | None = option(
        None, "File of weights to begin with: torchvision's for the encoders, or a best.pt."
    )
    normalize: Literal["constants", "train", "imagenet", "none"] = option(
        "constants", "How numbers become the network's, as StoreDataset says."
    )
    normals: Literal["auto", "cached", "nim", "nim-edge"] = option(
        "auto", "The store's, or computed of its depth by this method; auto: the store's if any."
    )
    metric: Metric = option(
        "f_score",
        "Keep the weights for which this is best on val: the mean over classes but background.",
    )
    amp: Literal["auto", "on", "off"] = option(
        "auto", "Compute in bfloat16, or float16 with scaled gradients; auto: on a GPU."
    )
    seed: int = option(0, "Of weights, order and augmentation.", least=0, most=2**31 - 1)
    device: str = option("auto", "auto, cpu, cuda or cuda:1.", counts=False)
    threads: int | None = option(
        None, "That decode frames; default: all cores.", least=1, counts=False
    )
    checkpoint_minutes: float = option(
        5.0,
        "Minutes between checkpoints; there is one at each epoch's end too.",
        least=0,
        counts=False,
    )
    checkpoint_steps: int | None = option(
        None, "Steps between checkpoints, beside that.", least=1, counts=False
    )
    log_steps: int = option(50, "Steps between lines of the log.", least=1, counts=False)
    tensorboard: bool = option(
        False, "Write OUT/tensorboard too; needs the extra tensorboard.", counts=False
    )
    overwrite: bool = option(False, "Replace a run that is there.", counts=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "setup", _checked_setup(self.setup))
        object.__setattr__(self, "crop", _checked_crop(self.crop))
        object.__setattr__(self, "scale", _checked_scale(self.scale))
        if not self.width > 0:
            raise ArrayError(f"width: expected a number above 0, found {self.width!r}")


def _checked_setup(setup: Any) -> Any:
    if setup is None or isinstance(setup, str):
        return setup
    parts = tuple(setup) if isinstance(setup, Sequence) else ()
    if not parts or not all(isinstance(part, str) for part in parts):
        raise ArrayError(
            f"setup: expected a name, or a tuple of names, found {setup!r}; rgb+d, say"
        )
    return parts if len(parts) > 1 else parts[0]


def _checked_crop(crop: Any) -> Any:
    if crop is None or (isinstance(crop, str) and crop == "none"):
        return crop
    numbers = _numbers(crop, Integral)
    if len(numbers) != 2 or min(numbers) < 1:
        raise ArrayError(
            f"crop: expected 'none' or two whole numbers from 1, found {crop!r}; give height and "
            "width, pixels"
        )
    return tuple(int(n) for n in numbers)


def _checked_scale(scale: Any) -> Any:
    if scale is None:
        return None
    numbers = _numbers(scale, Real)
    if len(numbers) != 2 or not 0 < numbers[0] <= numbers[1] < float("inf"):
        raise ArrayError(
            f"scale: expected two numbers, 0 < low <= high, found {scale!r}; 0.75,1.5, say"
        )
    return tuple(float(n) for n in numbers)


def _numbers(values: Any, kind: type) -> tuple[Any, ...]:
    """Return the numbers of a sequence; none where one of them is no such number."""
    given = tuple(values) if isinstance(values, Sequence) and not isinstance(values, str) else ()
    fits = all(isinstance(n, kind) and not isinstance(n, bool) for n in given)
    return given if fits else ()


# Keyword arguments by the names of the fields, for type checkers; a test compares them.
class TrainKeywords(TypedDict, total=False):
    network: NetworkName | None
    setup: str | tuple[str, ...] | None
    epochs: int
    batch: int | None
    crop: Size | None
    optimizer: Optimizer | None
    lr: float | None
    momentum: float | None
    weight_decay: float | None
    head_lr: float | None
    schedule: Rates | None
    gamma: float | None
    period: int | None
    power: float | None
    warmup: float
    class_weights: ClassWeights | None
    clip: float
    flip: float
    color: float
    scale: tuple[float, float] | None
    width: float
    stages: int
    weights: Path | str | None
    normalize: Literal["constants", "train", "imagenet", "none"]
    normals: Literal["auto", "cached", "nim", "nim-edge"]
    metric: Metric
    amp: Literal["auto", "on", "off"]
    seed: int
    device: str
    threads: int | None
    checkpoint_minutes: float
    checkpoint_steps: int | None
    log_steps: int
    tensorboard: bool
    overwrite: bool
