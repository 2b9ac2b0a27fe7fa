"""DeepLabv3+: ResNet-101, atrous spatial pyramid pooling, and a decoder of one skip.

Source: Chen et al., "Encoder-decoder with atrous separable convolution for semantic image
segmentation", ECCV 2018; output stride 16, plain convolutions.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from nimprep.networks.layers import ImagePooling, conv, conv_bn_relu, resized, scaled
from nimprep.networks.network import Logits, Network
from nimprep.networks.resnet import ResNet


class DeepLabV3Plus(Network):
    """See the surroundings of each pixel at four rates, then refine by an early layer."""

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        middle, low = scaled(256, width), scaled(48, width)
        self.encoder = ResNet(
            101, inputs, width, strides=(1, 2, 2, 1), dilations=(1, 1, 1, (2, 4, 8))
        )
        channels = self.encoder.channels
        self.branches = nn.ModuleList(
            [
                conv_bn_relu(channels[4], middle, 1),
                *(conv_bn_relu(channels[4], middle, dilation=rate) for rate in (6, 12, 18)),
                ImagePooling(channels[4], middle),
            ]
        )
        self.joined = nn.Sequential(conv_bn_relu(5 * middle, middle, 1), nn.Dropout(0.5))
        self.low = conv_bn_relu(channels[1], low, 1)
        self.head = nn.Sequential(
            conv_bn_relu(middle + low, middle),
            nn.Dropout(0.5),
            conv_bn_relu(middle, middle),
            nn.Dropout(0.1),
            conv(middle, classes, 1, bias=True),
        )

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        encoder = self.encoder
        low = encoder.layer(1, encoder.pool(encoder.stem(images[0])))
        x = encoder.layer(4, encoder.layer(3, encoder.layer(2, low)))
        x = self.joined(torch.cat([branch(x) for branch in self.branches], dim=1))
        x = torch.cat([resized(x, low.shape[2:], align_corners=True), self.low(low)], dim=1)
        return Logits(resized(self.head(x), images[0].shape[2:], align_corners=True))
