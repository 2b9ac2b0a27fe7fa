"""What a training makes small."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from nimprep.errors import StoreError
from nimprep.networks import Network
from nimprep.torch import StoreDataset
from nimprep.training.options import TrainOptions


class Criterion:
    """Take a network's outputs and labels to its loss, classes weighed as the options say.

    Raises
    ------
    StoreError
        No pixel of the split has a class.
    """

    def __init__(
        self, network: Network, data: StoreDataset, options: TrainOptions, device: torch.device
    ) -> None:
        if not int(data.class_pixels().sum()):
            raise StoreError(
                f"{data.store.path}: expected labelled pixels in {data.split}, found none; label "
                "some frames of it"
            )
        method = options.class_weights
        plain = method is None or method == "none"
        self._weights = None if plain else data.class_weights(method).to(device)  # type: ignore[arg-type]
        self._network = network

    def loss(self, outputs: Any, label: Tensor) -> Tensor:
        """Return the loss, () float32; 0 where no pixel has a label.

        Parameters
        ----------
        outputs : (B, C, H, W), or a named tuple of such
            What the network gives in training.
        label : (B, H, W) int64
            255 = none.
        """
        return self._network.loss(outputs, label, self._weights)
