"""DenseNet-121 as an encoder, named as torchvision names it.

Source: Huang et al., "Densely connected convolutional networks", CVPR 2017.
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, scaled

LAYERS = (6, 12, 24, 16)
GROWTH = 32


class DenseLayer(nn.Module):
    """Add `growth` channels to those there are."""

    def __init__(self, inputs: int, growth: int, dilation: int) -> None:
        super().__init__()
        self.norm1 = nn.BatchNorm2d(inputs)
        self.conv1 = conv(inputs, 4 * growth, 1)
        self.norm2 = nn.BatchNorm2d(4 * growth)
        self.conv2 = conv(4 * growth, growth, 3, dilation=dilation)

    def forward(self, x: Tensor) -> Tensor:
        y = self.conv1(functional.relu(self.norm1(x)))
        y = self.conv2(functional.relu(self.norm2(y)))
        return torch.cat([x, y], dim=1)


class Transition(nn.Module):
    """Halve the channels, and the size where it pools."""

    def __init__(self, inputs: int, outputs: int, pools: bool) -> None:
        super().__init__()
        self.norm = nn.BatchNorm2d(inputs)
        self.conv = conv(inputs, outputs, 1)
        self.pools = pools

    def forward(self, x: Tensor) -> Tensor:
        x = self.conv(functional.relu(self.norm(x)))
        return functional.avg_pool2d(x, 2) if self.pools else x


class DenseNet121(nn.Module):
    """Hold DenseNet-121 at output stride 8 as DenseASPP uses it: a fourth transition ends it.

    Only the first transition pools; the third block is dilated by 2, the fourth by 4.

    Attributes
    ----------
    channels : int
        Of what it returns.
    """

    def __init__(self, inputs: int, width: float = 1.0) -> None:
        super().__init__()
        growth = scaled(GROWTH, width)
        channels = 2 * growth
        layers: OrderedDict[str, nn.Module] = OrderedDict(
            conv0=nn.Conv2d(inputs, channels, 7, 2, 3, bias=False),
            norm0=nn.BatchNorm2d(channels),
            relu0=nn.ReLU(),
            pool0=nn.MaxPool2d(3, 2, 1),
        )
        for number, (count, dilation) in enumerate(zip(LAYERS, (1, 1, 2, 4), strict=True), 1):
            block: OrderedDict[str, nn.Module] = OrderedDict()
            for place in range(1, count + 1):
                block[f"denselayer{place}"] = DenseLayer(channels, growth, dilation)
                channels += growth
            layers[f"denseblock{number}"] = nn.Sequential(block)
            layers[f"transition{number}"] = Transition(channels, channels // 2, number == 1)
            channels //= 2
        layers["norm"] = nn.BatchNorm2d(channels)
        self.features = nn.Sequential(layers)
        self.channels = channels

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.features(x)
        return y
