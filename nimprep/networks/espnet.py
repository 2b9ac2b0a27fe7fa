"""ESPNet: spatial pyramids of dilated convolutions, for devices with little power.

Source: Mehta et al., "ESPNet: Efficient spatial pyramid of dilated convolutions for semantic
segmentation", ECCV 2018; p = 2, q = 8, with the light decoder. Normalisation by eps 1e-3.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, scaled
from nimprep.networks.network import Logits, Network

DILATIONS = (1, 2, 4, 8, 16)


class _Branches(nn.Module):
    """Convolve at five dilations, whose sums are concatenated: no gaps show in the result."""

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        count = len(DILATIONS)
        some = outputs // count
        first = outputs - (count - 1) * some
        self.reduced = conv(inputs, some, 3 if stride == 2 else 1, stride)
        self.dilated = nn.ModuleList(
            conv(some, first if rate == 1 else some, dilation=rate) for rate in DILATIONS
        )

    def forward(self, x: Tensor) -> Tensor:
        x = self.reduced(x)
        one, two, *rest = (branch(x) for branch in self.dilated)
        parts, total = [one, two], two
        for part in rest:
            total = total + part
            parts.append(total)
        return torch.cat(parts, dim=1)


class _Normal(nn.Sequential):
    def __init__(self, channels: int) -> None:
        super().__init__(nn.BatchNorm2d(channels, eps=1e-3), nn.PReLU(channels))


class _Down(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.branches = _Branches(inputs, outputs, stride=2)
        self.normal = _Normal(outputs)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.normal(self.branches(x))
        return y


class _Block(nn.Module):
    def __init__(self, channels: int) -> None:
        super().__init__()
        self.branches = _Branches(channels, channels, stride=1)
        self.normal = _Normal(channels)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.normal(x + self.branches(x))
        return y


def _cbr(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(conv(inputs, outputs, 3, stride), *_Normal(outputs))


def _smaller(x: Tensor) -> Tensor:
    return functional.avg_pool2d(x, 3, 2, 1)


class ESPNet(Network):
    """Encode at three scales with the image at each; decode class scores alone."""

    divisor = 8

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        c16, c64, c128 = (scaled(c, width) for c in (16, 64, 128))
        self.level1 = _cbr(inputs, c16, 2)
        self.normal1 = _Normal(c16 + inputs)
        self.down2 = _Down(c16 + inputs, c64)
        self.level2 = nn.Sequential(*(_Block(c64) for _ in range(2)))
        self.normal2 = _Normal(2 * c64 + inputs)
        self.down3 = _Down(2 * c64 + inputs, c128)
        self.level3 = nn.Sequential(*(_Block(c128) for _ in range(8)))
        self.normal3 = _Normal(2 * c128)
        self.score3 = conv(2 * c128, classes, 1)
        self.score2 = conv(2 * c64 + inputs, classes, 1)
        self.before_up3 = nn.BatchNorm2d(classes, eps=1e-3)
        self.up3 = nn.ConvTranspose2d(classes, classes, 2, 2, bias=False)
        self.joined2 = nn.Sequential(_Normal(2 * classes), _cbr(2 * classes, classes))
        self.up2 = nn.ConvTranspose2d(classes, classes, 2, 2, bias=False)
        self.after_up2 = _Normal(classes)
        self.joined1 = _cbr(classes + c16, classes)
        self.up1 = nn.ConvTranspose2d(classes, classes, 2, 2, bias=False)

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        half = _smaller(images[0])
        first = self.level1(images[0])
        down = self.down2(self.normal1(torch.cat([first, half], dim=1)))
        second = self.normal2(torch.cat([self.level2(down), down, _smaller(half)], dim=1))
        down = self.down3(second)
        third = self.score3(self.normal3(torch.cat([down, self.level3(down)], dim=1)))
        x = self.up3(self.before_up3(third))
        x = self.up2(self.joined2(torch.cat([self.score2(second), x], dim=1)))
        x = self.joined1(torch.cat([self.after_up2(x), first], dim=1))
        return Logits(self.up1(x))
