"""Depth-aware CNN: VGG16 in which neighbours of alike depth count more.

Source: Wang & Neumann, "Depth-aware CNN for RGB-D segmentation", ECCV 2018.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.depth_aware_layers import DepthAwareConv, DepthAwarePool
from nimprep.networks.layers import resized, scaled
from nimprep.networks.network import Logits, Network
from nimprep.networks.vgg import VGG16

ALPHA = 1.0
"""How fast unlike depth stops counting, as published in code; the paper's own figure is 8.3."""


class _Tower(nn.Module):
    """Give scores at an eighth of the size."""

    def __init__(
        self, inputs: int, classes: int, width: float, alpha: float, authors_pool: bool
    ) -> None:
        super().__init__()

        def first(a: int, b: int, dilation: int) -> nn.Module:
            return DepthAwareConv(a, b, alpha, dilation)

        self.encoder = VGG16(inputs, width=width, dilations=(1, 1, 1, 1, 2), first=first)
        hidden = scaled(1024, width)
        self.pool = DepthAwarePool(alpha, authors_pool)
        self.fc6 = DepthAwareConv(self.encoder.channels[-1], hidden, alpha, dilation=12)
        self.fc7 = nn.Conv2d(hidden, hidden, 1)
        self.score = nn.Conv2d(2 * hidden, classes, 1)

    def forward(self, x: Tensor, depth: Tensor) -> Tensor:
        drop = functional.dropout
        for stage in range(5):
            x = self.encoder.stage(stage, x, depth)
            x = functional.max_pool2d(x, 3, 2 if stage < 3 else 1, 1)
            if stage < 3:
                depth = functional.avg_pool2d(depth, 3, 2, 1)
        x = self.pool(x, depth)
        x = drop(functional.relu(self.fc6(x, depth)), 0.5, self.training)
        x = drop(functional.relu(self.fc7(x)), 0.5, self.training)
        whole = drop(x.mean(dim=(2, 3), keepdim=True), 0.3, self.training)
        y: Tensor = self.score(torch.cat([x, whole.expand_as(x)], dim=1))
        return y


class DepthAwareCNN(Network):
    """Weight what VGG16 sees by depth.

    Where the second image has one channel it is the depth. Where it has more (normals, HHA), it
    joins as HHA does in the paper, by a tower of its own whose scores are added to the colour
    image's; likeness is still of depth, which `forward` then takes as a third image. Without one,
    it is of the second image itself, the mean over its channels.

    Parameters
    ----------
    alpha : float
        How fast unlike depth stops counting.
    authors_pool : bool
        See `DepthAwarePool`.
    """

    divisor = 8

    def __init__(
        self,
        inputs: tuple[int, int],
        classes: int,
        width: float = 1.0,
        alpha: float = ALPHA,
        authors_pool: bool = True,
    ) -> None:
        super().__init__(inputs, classes)
        self.first = _Tower(inputs[0], classes, width, alpha, authors_pool)
        self.second = (
            None if inputs[1] == 1 else _Tower(inputs[1], classes, width, alpha, authors_pool)
        )

    @property
    def wants_depth(self) -> bool:
        """Whether the second image is not the depth itself."""
        return self.second is not None

    def forward(  # type: ignore[override]
        self, x: Tensor, y: Tensor, depth: Tensor | None = None
    ) -> Tensor:
        """Return logits, (B, C, H, W).

        Parameters
        ----------
        x, y : (B, N, H, W) floating
            Channels as `inputs` says.
        depth : (B, 1, H, W), optional
            What likeness is of; None = `y`.

        Raises
        ------
        ArrayError
            Channels or sizes are others.
        """
        found: Tensor = super().forward(x, y, *(() if depth is None else (depth,)))
        return found

    def scores(self, x: Tensor, y: Tensor, depth: Tensor | None = None) -> Tensor:
        """Return logits at an eighth of the size, before they are resized."""
        near = y if depth is None else depth
        first: Tensor = self.first(x, near)
        return first if self.second is None else first + self.second(y, near)

    def _channels(self, count: int) -> tuple[int, ...]:
        channels = super()._channels(count)
        return (*channels, 1) if count == 3 else channels

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        size = images[0].shape[2:]
        return Logits(resized(self.scores(*images), size, align_corners=False))
