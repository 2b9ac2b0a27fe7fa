"""What several networks are made of: convolutions with normalisation, resizing, image pooling."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


def scaled(channels: int, width: float, multiple: int = 8) -> int:
    """Return a number of channels at a width: 1 leaves it, less rounds it to a multiple."""
    if width == 1:
        return channels
    return max(multiple, round(channels * width / multiple) * multiple)


def conv(
    inputs: int, outputs: int, size: int = 3, stride: int = 1, dilation: int = 1, bias: bool = False
) -> nn.Conv2d:
    """Return a convolution whose padding keeps the size at stride 1."""
    padding = dilation * (size - 1) // 2
    return nn.Conv2d(inputs, outputs, size, stride, padding, dilation, bias=bias)


def conv_bn_relu(
    inputs: int, outputs: int, size: int = 3, stride: int = 1, dilation: int = 1, bias: bool = False
) -> nn.Sequential:
    """Return a convolution, batch normalisation and ReLU."""
    return nn.Sequential(
        conv(inputs, outputs, size, stride, dilation, bias), nn.BatchNorm2d(outputs), nn.ReLU()
    )


def resized(x: Tensor, size: tuple[int, int] | torch.Size, align_corners: bool) -> Tensor:
    """Return images at another size, bilinear."""
    return functional.interpolate(
        x, size=(size[0], size[1]), mode="bilinear", align_corners=align_corners
    )


class ImagePooling(nn.Module):
    """Pool a whole image to one pixel, and spread what a 1x1 convolution makes of it again.

    A batch of one is normalised by the running statistics: one number per channel has no variance.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = conv(inputs, outputs, 1)
        self.bn = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        pooled = self.conv(x.mean(dim=(2, 3), keepdim=True))
        alone = self.training and len(x) == 1
        normal = _by_running_statistics(self.bn, pooled) if alone else self.bn(pooled)
        return functional.relu(normal).expand(-1, -1, *x.shape[2:])


def _by_running_statistics(bn: nn.BatchNorm2d, x: Tensor) -> Tensor:
    return functional.batch_norm(
        x, bn.running_mean, bn.running_var, bn.weight, bn.bias, training=False, eps=bn.eps
    )
