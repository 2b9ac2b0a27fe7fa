"""Convolution and average pooling in which neighbours of alike depth count more.

Source: Wang & Neumann, "Depth-aware CNN for RGB-D segmentation", ECCV 2018, equations 1 to 5.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional


def _taps(x: Tensor, dilation: int = 1) -> Iterator[Tensor]:
    """Yield an image as its nine neighbours see it: row by row, zeros outside."""
    height, width = x.shape[2:]
    padded = functional.pad(x, (dilation,) * 4)
    for row in range(0, 3 * dilation, dilation):
        for column in range(0, 3 * dilation, dilation):
            yield padded[:, :, row : row + height, column : column + width]


def _similarity(near: Tensor, depth: Tensor, alpha: float) -> Tensor:
    """Return exp(-alpha |D_i - D_j|), (B, 1, H, W): the mean difference where D has channels."""
    return torch.exp(-alpha * (depth - near).abs().mean(dim=1, keepdim=True))


class DepthAwareConv(nn.Module):
    """Convolve 3x3, each tap weighted by how alike its depth is to the centre's.

    Parameters
    ----------
    inputs, outputs : int
        Channels.
    alpha : float
        How fast unlike depth stops counting.
    dilation : int
    """

    def __init__(self, inputs: int, outputs: int, alpha: float, dilation: int = 1) -> None:
        super().__init__()
        # Holds weight and bias, with their initial values, under torchvision's names.
        plain = nn.Conv2d(inputs, outputs, 3)
        self.weight, self.bias = plain.weight, plain.bias
        self.alpha = alpha
        self.dilation = dilation

    def forward(self, x: Tensor, depth: Tensor) -> Tensor:
        """Return (B, outputs, H, W) of images, (B, inputs, H, W), and their depth, (B, 1, H, W)."""
        kernel = self.weight.flatten(2)
        total = None
        pairs = zip(_taps(x, self.dilation), _taps(depth, self.dilation), strict=True)
        for place, (tap, near) in enumerate(pairs):
            weighted = tap * _similarity(near, depth, self.alpha)
            part = functional.conv2d(
                weighted, kernel[:, :, place, None, None], self.bias if place == 0 else None
            )
            total = part if total is None else total + part
        assert total is not None
        return total


class DepthAwarePool(nn.Module):
    """Average 3x3 at stride 1, weighted by likeness of depth.

    Parameters
    ----------
    alpha : float
    authors : bool
        As the authors' kernel does it: in the first row and column the centre's depth is that of
        the second, and taps outside the image count with weight 1 and value 0. Else as their
        paper says: of the taps within the image alone.
    """

    def __init__(self, alpha: float, authors: bool = True) -> None:
        super().__init__()
        self.alpha = alpha
        self.authors = authors

    def forward(self, x: Tensor, depth: Tensor) -> Tensor:
        """Return (B, C, H, W) of features of that shape and their depth, (B, 1, H, W)."""
        centre = depth
        if self.authors:
            centre = torch.cat([centre[:, :, 1:2], centre[:, :, 1:]], dim=2)
            centre = torch.cat([centre[:, :, :, 1:2], centre[:, :, :, 1:]], dim=3)
        total, weights = torch.zeros_like(x), torch.zeros_like(depth[:, :1])
        inside = torch.ones_like(depth[:, :1])
        for tap, near, there in zip(_taps(x), _taps(depth), _taps(inside), strict=True):
            weight = _similarity(near, centre, self.alpha) * there
            total = total + weight * tap
            weights = weights + weight + (1 - there if self.authors else 0)
        return total / weights
