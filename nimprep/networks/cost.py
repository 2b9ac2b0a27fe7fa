"""What a network costs to run."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.func import functional_call
from torch.utils.flop_counter import FlopCounterMode


def count_flops(network: nn.Module, images: Sequence[Tensor]) -> int:
    """Return the floating-point operations of convolutions, two for each multiply-add.

    Nothing is computed: shapes alone go through the network, as it is in evaluation.

    Parameters
    ----------
    network : Module
    images : sequence of Tensor
        What it is called with, on the device "meta".
    """
    numbers = {**dict(network.named_parameters()), **dict(network.named_buffers())}
    shapes = {name: torch.empty_like(t, device="meta") for name, t in numbers.items()}
    training = {module: module.training for module in network.modules()}
    network.eval()
    try:
        with torch.no_grad(), FlopCounterMode(display=False) as counter:
            functional_call(network, shapes, tuple(images))
    finally:
        for module, was in training.items():
            module.training = was
    return int(counter.get_total_flops())
