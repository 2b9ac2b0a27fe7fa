"""How numbers are computed: on which device, and in how many bits."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

import torch
from torch import Tensor, nn

from nimprep.training.options import TrainOptions


class Precision:
    """Compute in half precision where that is asked for, and scale gradients where that needs it.

    bfloat16, which has float32's range, on CPUs and on GPUs that have it; on others float16, whose
    small gradients would be 0 if the loss were not scaled.

    Parameters
    ----------
    options : TrainOptions
    device : torch.device
    """

    def __init__(self, options: TrainOptions, device: torch.device) -> None:
        self.device = device
        self.half = options.amp == "on" or (options.amp == "auto" and device.type == "cuda")
        narrow = device.type == "cuda" and not torch.cuda.is_bf16_supported()
        self.dtype = torch.float16 if narrow else torch.bfloat16
        self._scaler = torch.amp.GradScaler(device.type, enabled=self.half and narrow)

    def autocast(self) -> AbstractContextManager[Any]:
        """Return the context in which networks are called."""
        if not self.half:
            return nullcontext()
        return torch.autocast(self.device.type, self.dtype)

    def step(
        self, loss: Tensor, optimizer: torch.optim.Optimizer, network: nn.Module, clip: float
    ) -> None:
        """Go one step down; gradients are longer than `clip` only where that is 0."""
        self._scaler.scale(loss).backward()  # type: ignore[no-untyped-call]
        if clip:
            self._scaler.unscale_(optimizer)
            nn.utils.clip_grad_norm_(network.parameters(), clip)
        self._scaler.step(optimizer)
        self._scaler.update()
        optimizer.zero_grad(set_to_none=True)

    def state_dict(self) -> dict[str, Any]:
        """Return the scaler's state; empty where nothing is scaled."""
        return dict(self._scaler.state_dict())

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from such a state."""
        if state and self._scaler.is_enabled():
            self._scaler.load_state_dict(state)
