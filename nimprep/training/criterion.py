"""What a training makes small."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.errors import StoreError
from nimprep.frame import IGNORE_LABEL
from nimprep.networks import Network
from nimprep.torch import StoreDataset
from nimprep.training.options import TrainOptions


class Criterion(nn.Module):
    """Take a network's outputs and labels to a loss.

    Raises
    ------
    StoreError
        No pixel of the split has a class.
    """

    weight: Tensor | None

    def __init__(self, network: Network, data: StoreDataset, options: TrainOptions) -> None:
        super().__init__()
        if not int(data.class_pixels().sum()):
            raise StoreError(
                f"{data.store.path}: expected labelled pixels in {data.split}, found none; label "
                "some frames of it"
            )
        method = options.class_weights
        weighed = None if method is None or method == "none" else data.class_weights(method)
        self.register_buffer("weight", weighed)

    def forward(self, outputs: Any, label: Tensor) -> Tensor:
        """Return the loss, () float32; 0 where no pixel has a label.

        Parameters
        ----------
        outputs : (B, C, H, W), or a named tuple of such
            What the network gives in training.
        label : (B, H, W) int64
            255 = none.
        """
        logits = outputs if isinstance(outputs, Tensor) else outputs[0]
        return cross_entropy(logits, label, self.weight)


def cross_entropy(logits: Tensor, label: Tensor, weight: Tensor | None) -> Tensor:
    """Return the mean over labelled pixels, each counted by its class's weight; 0 without any."""
    total = functional.cross_entropy(
        logits.float(), label, weight, ignore_index=IGNORE_LABEL, reduction="sum"
    )
    known = label != IGNORE_LABEL
    counted = known.sum() if weight is None else weight[label.where(known, 0)][known].sum()
    return total / torch.clamp(counted, min=torch.finfo(torch.float32).tiny)
