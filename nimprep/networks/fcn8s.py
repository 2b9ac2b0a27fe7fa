"""FCN-8s: VGG16 made convolutional, its scores at three scales added up.

Source: Long, Shelhamer & Darrell, "Fully convolutional networks for semantic segmentation", CVPR
2015; the one-stage recipe, in which pool4 and pool3 are scaled by 0.01 and 0.0001.
"""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import scaled
from nimprep.networks.network import Logits, Network
from nimprep.networks.vgg import VGG16


class FCN8s(Network):
    """Sum scores of fc7, pool4 and pool3, each upsampled by a learned kernel."""

    classifier: ClassVar = {"fc6": "classifier.0", "fc7": "classifier.3"}

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        hidden = scaled(4096, width)
        # 100 pixels of padding leave fc6, unpadded, something of the smallest image.
        self.encoder = VGG16(inputs, width=width, padding=100)
        channels = self.encoder.channels
        self.fc6 = nn.Conv2d(channels[4], hidden, 7)
        self.fc7 = nn.Conv2d(hidden, hidden, 1)
        self.drop = nn.Dropout2d(0.5)
        self.score = nn.Conv2d(hidden, classes, 1)
        self.score4 = nn.Conv2d(channels[3], classes, 1)
        self.score3 = nn.Conv2d(channels[2], classes, 1)
        self.up2 = _bilinear(classes, 4, 2)
        self.up4 = _bilinear(classes, 4, 2)
        self.up8 = _bilinear(classes, 16, 8)

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        x = images[0]
        pools = []
        for stage in range(5):
            stage_out = self.encoder.stage(stage, x)
            x = functional.max_pool2d(stage_out, 2, ceil_mode=True)
            pools.append(x)
        x = self.drop(functional.relu(self.fc6(x)))
        x = self.drop(functional.relu(self.fc7(x)))
        x = _added(self.up2(self.score(x)), self.score4(0.01 * pools[3]), 5)
        x = _added(self.up4(x), self.score3(0.0001 * pools[2]), 9)
        height, width = images[0].shape[2:]
        return Logits(self.up8(x)[:, :, 31 : 31 + height, 31 : 31 + width])


def _added(x: Tensor, skip: Tensor, offset: int) -> Tensor:
    """Return the scores, and those of a larger map cut out from an offset on."""
    height, width = x.shape[2:]
    return x + skip[:, :, offset : offset + height, offset : offset + width]


def _bilinear(classes: int, size: int, stride: int) -> nn.ConvTranspose2d:
    """Return a transposed convolution that begins as bilinear interpolation, class by class."""
    up = nn.ConvTranspose2d(classes, classes, size, stride, bias=False)
    centre = (size - 1) / 2
    line = 1 - (torch.arange(size) - centre).abs() / (size / 2)
    with torch.no_grad():
        up.weight.zero_()
        for c in range(classes):
            up.weight[c, c] = line[:, None] * line[None, :]
    return up
