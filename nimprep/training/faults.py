"""What ends a training, each in a line that says what to change."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import nn

from nimprep.errors import TrainingError
from nimprep.training.options import TrainOptions

_NO_MEMORY = ("can't allocate memory", "not enough memory", "out of memory")
"""What PyTorch says of the machine's own memory, and of a GPU's through other libraries."""


@contextmanager
def memory(options: TrainOptions, device: torch.device, *, training: bool) -> Iterator[None]:
    """Let it be a `TrainingError` where no memory is left.

    Parameters
    ----------
    training : bool
        Whether a step is taken, or whole frames are scored.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise TrainingError(_exhausted(options, device, training)) from error
    except RuntimeError as error:
        if not any(said in str(error).lower() for said in _NO_MEMORY):
            raise
        raise TrainingError(_exhausted(options, device, training)) from error


def _exhausted(options: TrainOptions, device: torch.device, training: bool) -> str:
    if not training:
        return (
            f"{device}: expected memory for a whole frame of val, found none left; give a smaller "
            f"--width (now {options.width:g}), or another --device"
        )
    crop = options.crop
    size = f"{crop[0]}x{crop[1]}" if isinstance(crop, tuple) else "whole frames"
    steps = ["a smaller --crop" if isinstance(crop, tuple) else "a --crop"]
    if options.batch is not None and options.batch > 1:
        steps.insert(0, f"a smaller --batch (now {options.batch})")
    steps.append(f"a smaller --width (now {options.width:g})")
    if options.amp != "on" and not (options.amp == "auto" and device.type == "cuda"):
        steps.append("--amp on")
    return (
        f"{device}: expected memory for {options.network} on a batch of {options.batch}, {size}, "
        f"found none left; give {', '.join(steps[:-1])} or {steps[-1]}, and another --out"
    )


def check_loss(loss: float, step: int, rate: float, options: TrainOptions) -> None:
    """Raise `TrainingError` where a loss is no number; `step` counts from 1."""
    if not math.isfinite(loss):
        raise TrainingError(_ran_away(f"a loss of {loss:g} at step {step}", rate, options))


def check_weights(network: nn.Module, step: int, rate: float, options: TrainOptions) -> None:
    """Raise `TrainingError` where a weight is no number, before a checkpoint would keep it."""
    for name, tensor in network.state_dict().items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            found = f"{name} that are no numbers at step {step}"
            raise TrainingError(_ran_away(found, rate, options))


def _ran_away(found: str, rate: float, options: TrainOptions) -> str:
    steps = [f"a lower --lr (now {options.lr:g})"]
    steps += ["--warmup 1"] if not options.warmup else []
    steps += ["--clip 1"] if not options.clip else [f"a lower --clip (now {options.clip:g})"]
    steps += ["--amp off"] if options.amp != "off" else []
    return (
        f"{options.network}: expected finite numbers, found {found}, at a learning rate of "
        f"{rate:.2g}; give {', '.join(steps[:-1])} or {steps[-1]}, and another --out"
    )
