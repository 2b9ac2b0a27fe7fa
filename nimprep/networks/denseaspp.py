"""DenseASPP: dilated convolutions of growing rate, each of which sees those before it.

Source: Yang et al., "DenseASPP for semantic segmentation in street scenes", CVPR 2018.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.densenet import DenseNet121
from nimprep.networks.layers import conv, resized, scaled
from nimprep.networks.network import Logits, Network

RATES = (3, 6, 12, 18, 24)


class DenseASPP(Network):
    """Join DenseNet-121's features with five rates of dilation at an eighth of the size."""

    divisor = 8

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        middle, growth = scaled(128, width), scaled(64, width)
        self.encoder = DenseNet121(inputs, width)
        channels = self.encoder.channels
        self.blocks = nn.ModuleList()
        for place, rate in enumerate(RATES):
            self.blocks.append(_block(channels, middle, growth, rate, norm=place > 0))
            channels += growth
        self.head = nn.Sequential(nn.Dropout2d(0.1), conv(channels, classes, 1, bias=True))

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        # The published network rectifies in place: what is joined later is rectified as well.
        x = functional.relu(self.encoder(images[0]))
        for block in self.blocks:
            x = torch.cat([block(x), x], dim=1)
        return Logits(resized(self.head(x), images[0].shape[2:], align_corners=False))


def _block(inputs: int, middle: int, growth: int, rate: int, *, norm: bool) -> nn.Sequential:
    return nn.Sequential(
        *([nn.BatchNorm2d(inputs, momentum=3e-4)] if norm else []),
        nn.ReLU(),
        conv(inputs, middle, 1, bias=True),
        nn.BatchNorm2d(middle, momentum=3e-4),
        nn.ReLU(),
        conv(middle, growth, dilation=rate, bias=True),
        nn.Dropout2d(0.1),
    )
