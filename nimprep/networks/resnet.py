"""Residual networks as encoders, named as torchvision names them.

Source: He et al., "Deep residual learning for image recognition", CVPR 2016; the stride of a
bottleneck on its 3x3 convolution.
"""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, conv_bn_relu, scaled

DEPTHS = {
    18: (2, 2, 2, 2),
    34: (3, 4, 6, 3),
    50: (3, 4, 6, 3),
    101: (3, 4, 23, 3),
    152: (3, 8, 36, 3),
}
"""Blocks in each of the four layers."""


class BasicBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    expansion = 1

    def __init__(self, inputs: int, channels: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv1 = conv(inputs, channels, 3, stride, dilation)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = conv(channels, channels, 3, 1, dilation)
        self.bn2 = nn.BatchNorm2d(channels)
        self.downsample = _shortcut(inputs, channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(self.bn1(self.conv1(x)))
        y = self.bn2(self.conv2(y))
        return functional.relu(y + (x if self.downsample is None else self.downsample(x)))


class Bottleneck(nn.Module):
    """A 3x3 convolution of fewer channels, between two 1x1, beside a shortcut."""

    expansion = 4

    def __init__(self, inputs: int, channels: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.conv1 = conv(inputs, channels, 1)
        self.bn1 = nn.BatchNorm2d(channels)
        self.conv2 = conv(channels, channels, 3, stride, dilation)
        self.bn2 = nn.BatchNorm2d(channels)
        self.conv3 = conv(channels, 4 * channels, 1)
        self.bn3 = nn.BatchNorm2d(4 * channels)
        self.downsample = _shortcut(inputs, 4 * channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        y = functional.relu(self.bn1(self.conv1(x)))
        y = functional.relu(self.bn2(self.conv2(y)))
        y = self.bn3(self.conv3(y))
        return functional.relu(y + (x if self.downsample is None else self.downsample(x)))


def _shortcut(inputs: int, outputs: int, stride: int) -> nn.Sequential | None:
    if stride == 1 and inputs == outputs:
        return None
    return nn.Sequential(conv(inputs, outputs, 1, stride), nn.BatchNorm2d(outputs))


class ResNet(nn.Module):
    """Hold a residual network without its classifier.

    Parameters
    ----------
    depth : {18, 34, 50, 101, 152}
    inputs : int
        Channels of the image.
    width : float
        Of the channels.
    strides : sequence of int
        Of the first block of each layer.
    dilations : sequence of (int or sequence of int)
        Of each layer's blocks; a number = of all.
    deep_stem : bool
        Three 3x3 convolutions (64, 64, 128) in place of the 7x7.

    Attributes
    ----------
    channels : list of int
        Of the stem and of the four layers.
    """

    def __init__(
        self,
        depth: int,
        inputs: int,
        width: float = 1.0,
        strides: Sequence[int] = (1, 2, 2, 2),
        dilations: Sequence[int | Sequence[int]] = (1, 1, 1, 1),
        deep_stem: bool = False,
    ) -> None:
        super().__init__()
        block = Bottleneck if depth >= 50 else BasicBlock
        base = [scaled(c, width) for c in (64, 128, 256, 512)]
        stem = 2 * base[0] if deep_stem else base[0]
        self.conv1: nn.Module = nn.Conv2d(inputs, stem, 7, 2, 3, bias=False)
        if deep_stem:
            self.conv1 = nn.Sequential(
                *conv_bn_relu(inputs, base[0], stride=2),
                *conv_bn_relu(base[0], base[0]),
                conv(base[0], stem),
            )
        self.deep_stem = deep_stem
        self.bn1 = nn.BatchNorm2d(stem)
        self.channels = [stem]
        for number, blocks in enumerate(DEPTHS[depth]):
            steps = dilations[number]
            each = [steps] * blocks if isinstance(steps, int) else list(steps)
            layer = []
            before = self.channels[-1]
            for place in range(blocks):
                stride = strides[number] if place == 0 else 1
                layer.append(block(before, base[number], stride, each[place]))
                before = block.expansion * base[number]
            setattr(self, f"layer{number + 1}", nn.Sequential(*layer))
            self.channels.append(before)

    def stem(self, x: Tensor) -> Tensor:
        """Return what comes before the max pool, at half the size."""
        return functional.relu(self.bn1(self.conv1(x)))

    def pool(self, x: Tensor) -> Tensor:
        """Return the stem's output pooled to half its size."""
        return functional.max_pool2d(x, 3, 2, 1)

    def layer(self, number: int, x: Tensor) -> Tensor:
        """Return what a layer, 1 to 4, makes of the one before it."""
        y: Tensor = getattr(self, f"layer{number}")(x)
        return y
