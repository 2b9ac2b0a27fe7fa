"""U-Net: each scale's features are joined to the upsampled ones of the scale below.

Source: Ronneberger, Fischer & Brox, "U-Net: Convolutional networks for biomedical image
segmentation", MICCAI 2015; with padded convolutions and batch normalisation.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv_bn_relu, scaled
from nimprep.networks.network import Logits, Network

CHANNELS = (64, 128, 256, 512, 1024)
"""Of the double convolutions, from full size down to a sixteenth."""


class UNet(Network):
    """Four times down by pooling, four times up by transposed convolutions."""

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        channels = [scaled(c, width) for c in CHANNELS]
        before = [inputs, *channels]
        self.down = nn.ModuleList(_double(a, b) for a, b in zip(before[:-1], channels, strict=True))
        self.up = nn.ModuleList()
        self.joined = nn.ModuleList()
        for below, skip in zip(reversed(channels[1:]), reversed(channels[:-1]), strict=True):
            self.up.append(nn.ConvTranspose2d(below, below // 2, 2, 2))
            self.joined.append(_double(below // 2 + skip, skip))
        self.head = nn.Conv2d(channels[0], classes, 1)

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        x = self.down[0](images[0])
        skips = []
        for double in self.down[1:]:
            skips.append(x)
            x = double(functional.max_pool2d(x, 2))
        for up, double, skip in zip(self.up, self.joined, reversed(skips), strict=True):
            x = double(torch.cat([skip, _padded(up(x), skip)], dim=1))
        return Logits(self.head(x))


def _double(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(conv_bn_relu(inputs, outputs), conv_bn_relu(outputs, outputs))


def _padded(x: Tensor, other: Tensor) -> Tensor:
    """Pad with zeros to another map's size, the smaller half on the left and on top."""
    down, right = other.shape[2] - x.shape[2], other.shape[3] - x.shape[3]
    if not (down or right):
        return x
    return functional.pad(x, (right // 2, right - right // 2, down // 2, down - down // 2))
