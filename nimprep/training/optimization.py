"""Optimisers of a network's parameters."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from nimprep.errors import ArrayError
from nimprep.networks import Network
from nimprep.networks.densenet import DenseNet121
from nimprep.networks.resnet import ResNet
from nimprep.networks.vgg import VGG16
from nimprep.networks.wide_resnet import WideResNet38
from nimprep.training.options import TrainOptions

_ENCODERS = (VGG16, ResNet, DenseNet121, WideResNet38)


def optimizer_for(network: Network, options: TrainOptions) -> torch.optim.Optimizer:
    """Return the optimiser that the options, completed by a recipe, say.

    Each group of parameters has, beside the optimiser's own, "base": its learning rate before the
    schedule.

    Raises
    ------
    ArrayError
        Heads are to learn at a rate of their own, and the network has no encoder apart from them.
    """
    assert options.lr is not None
    assert options.head_lr is not None
    rate, head = options.lr, options.lr * options.head_lr
    groups: list[dict[str, Any]]
    if options.head_lr == 1:
        groups = [_group(network.parameters(), rate)]
    else:
        inner, outer = _apart(network)
        if not inner:
            raise ArrayError(
                f"head_lr: expected 1 for {options.network}, found {options.head_lr:g}; it has no "
                "encoder apart"
            )
        groups = [_group(inner, rate), _group(outer, head)]
    decay, momentum = options.weight_decay or 0.0, options.momentum or 0.0
    match options.optimizer:
        case "adam":
            return torch.optim.Adam(groups, rate, weight_decay=decay)
        case "adamw":
            return torch.optim.AdamW(groups, rate, weight_decay=decay)
        case "rmsprop":
            return torch.optim.RMSprop(groups, rate, momentum=momentum, weight_decay=decay)
    return torch.optim.SGD(groups, rate, momentum=momentum, weight_decay=decay)


def _group(parameters: Any, rate: float) -> dict[str, Any]:
    learned = [parameter for parameter in parameters if parameter.requires_grad]
    return {"params": learned, "lr": rate, "base": rate}


def _apart(network: Network) -> tuple[list[nn.Parameter], list[nn.Parameter]]:
    """Return the encoders' parameters, and all others."""
    encoders = [module for module in network.modules() if isinstance(module, _ENCODERS)]
    inner = {id(p) for module in encoders for p in module.parameters()}
    both: tuple[list[nn.Parameter], list[nn.Parameter]] = ([], [])
    for parameter in network.parameters():
        both[id(parameter) not in inner].append(parameter)
    return both


def set_rate(optimizer: torch.optim.Optimizer, factor: float) -> float:
    """Set the learning rates to their base times a factor, and return the first."""
    for group in optimizer.param_groups:
        group["lr"] = group["base"] * factor
    return float(optimizer.param_groups[0]["lr"])
