"""MFNet: two small encoders, one for each image, and a decoder that adds what both saw.

Source: Ha et al., "MFNet: Towards real-time semantic segmentation for autonomous vehicles with
multi-spectral scenes", IROS 2017.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, scaled
from nimprep.networks.network import Logits, Network

FIRST = (16, 48, 48, 96, 96)
SECOND = (16, 16, 16, 36, 36)
"""Channels of the five stages, of the colour image's encoder and of the other's."""

LAST = 32
"""Channels of the decoder's map at half the size; at others they are both encoders' together."""


def _conv(inputs: int, outputs: int, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        conv(inputs, outputs, dilation=dilation, bias=True),
        nn.BatchNorm2d(outputs),
        nn.LeakyReLU(0.2),
    )


class _Inception(nn.Module):
    """Convolve half the channels as they lie, half with dilation, side by side."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.near = _conv(inputs, outputs // 2)
        self.far = _conv(inputs, outputs - outputs // 2, dilation=2)

    def forward(self, x: Tensor) -> Tensor:
        return torch.cat([self.near(x), self.far(x)], dim=1)


def _encoder(inputs: int, channels: tuple[int, ...]) -> nn.ModuleList:
    one, two, three, four, five = channels
    return nn.ModuleList(
        [
            _conv(inputs, one),
            nn.Sequential(_conv(one, two), _conv(two, two)),
            nn.Sequential(_conv(two, three), _conv(three, three)),
            nn.Sequential(_Inception(three, four), *(_Inception(four, four) for _ in range(2))),
            nn.Sequential(*(_Inception(a, five) for a in (four, five, five))),
        ]
    )


class MFNet(Network):
    """Fuse late: the decoder adds both encoders' maps at each scale."""

    divisor = 16

    def __init__(self, inputs: tuple[int, int], classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        first = tuple(scaled(c, width, 4) for c in FIRST)
        second = tuple(scaled(c, width, 4) for c in SECOND)
        last = scaled(LAST, width, 4)
        both = [a + b for a, b in zip(first, second, strict=True)]
        self.first = _encoder(inputs[0], first)
        self.second = _encoder(inputs[1], second)
        # Maps are added to what the decoder has at their scale, so they set its channels.
        self.decoder = nn.ModuleList(
            [
                _conv(both[4], both[2]),
                _conv(both[2], both[1]),
                _conv(both[1], last),
                _conv(last, classes),
            ]
        )

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        x, y = images
        skips = []
        for place, (first, second) in enumerate(zip(self.first, self.second, strict=True)):
            x, y = first(x), second(y)
            if place < 4:
                skips.append(torch.cat([x, y], dim=1))
                x, y = functional.max_pool2d(x, 2), functional.max_pool2d(y, 2)
        z = torch.cat([x, y], dim=1)
        for place, decode in enumerate(self.decoder):
            z = functional.interpolate(z, scale_factor=2.0, mode="nearest")
            z = decode(z + skips[3 - place] if place < 3 else z)
        return Logits(z)
