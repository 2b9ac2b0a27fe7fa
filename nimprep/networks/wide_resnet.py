"""A wide residual network of 38 layers, variant A2 at output stride 8, as GSCNN uses it.

Source: Wu, Shen & van den Hengel, "Wider or deeper: Revisiting the ResNet model for visual
recognition", Pattern Recognition 90, 2019.
"""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, scaled


class Stage(NamedTuple):
    """Say what one stage is made of."""

    blocks: int
    channels: tuple[int, ...]
    stride: int = 1
    dilation: int = 1
    dropout: float = 0.0


STAGES = (
    Stage(3, (128, 128)),
    Stage(3, (256, 256)),
    Stage(6, (512, 512), stride=2),
    Stage(3, (512, 1024), dilation=2),
    Stage(1, (512, 1024, 2048), dilation=4, dropout=0.3),
    Stage(1, (1024, 2048, 4096), dilation=4, dropout=0.5),
)
"""The stages after the first convolution; the first two follow a max pool each."""


class _Block(nn.Module):
    """Normalise and rectify, then convolve twice or (1x1, 3x3, 1x1), beside a shortcut."""

    def __init__(
        self, inputs: int, channels: tuple[int, ...], stride: int, dilation: int, dropout: float
    ) -> None:
        super().__init__()
        outputs = channels[-1]
        sizes = (3, 3) if len(channels) == 2 else (1, 3, 1)
        self.bn1 = nn.BatchNorm2d(inputs)
        layers: list[nn.Module] = []
        before = inputs
        for place, (size, after) in enumerate(zip(sizes, channels, strict=True)):
            if place:
                layers += [nn.BatchNorm2d(before), nn.ReLU()]
            if dropout and place == len(sizes) - 1:
                layers.append(nn.Dropout2d(dropout))
            layers.append(conv(before, after, size, stride if place == 0 else 1, dilation))
            before = after
        self.layers = nn.Sequential(*layers)
        same = stride == 1 and inputs == outputs
        self.shortcut = None if same else conv(inputs, outputs, 1, stride)

    def forward(self, x: Tensor) -> Tensor:
        active = functional.relu(self.bn1(x))
        y: Tensor = self.layers(active)
        return y + (x if self.shortcut is None else self.shortcut(active))


class WideResNet38(nn.Module):
    """Hold the network without its last normalisation and classifier.

    Attributes
    ----------
    channels : list of int
        Of the first convolution and of the six stages.
    """

    def __init__(self, inputs: int, width: float = 1.0) -> None:
        super().__init__()
        before = scaled(64, width)
        self.first = conv(inputs, before)
        self.channels = [before]
        stages = []
        for stage in STAGES:
            channels = tuple(scaled(c, width) for c in stage.channels)
            blocks = []
            for place in range(stage.blocks):
                stride = stage.stride if place == 0 else 1
                blocks.append(_Block(before, channels, stride, stage.dilation, stage.dropout))
                before = channels[-1]
            stages.append(nn.Sequential(*blocks))
            self.channels.append(before)
        self.stages = nn.ModuleList(stages)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return what the first convolution and each stage give, at 1, 1/2, 1/4 and 1/8."""
        found = [self.first(x)]
        for place, stage in enumerate(self.stages):
            x = functional.max_pool2d(found[-1], 3, 2, 1) if place < 2 else found[-1]
            found.append(stage(x))
        return found
