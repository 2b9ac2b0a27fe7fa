"""DUpsampling: every pixel of a small map holds the scores of a block of 8x8 pixels.

Source: Tian et al., "Decoders matter for semantic segmentation: Data-dependent decoding enables
flexible feature aggregation", CVPR 2019. Its authors' code is not public: this is the most used
reading of it, with an auxiliary head on the third layer, whose loss counts 0.4.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from nimprep.networks.layers import conv, conv_bn_relu, scaled
from nimprep.networks.losses import IGNORE, cross_entropy
from nimprep.networks.network import Network
from nimprep.networks.resnet import ResNet

BLOCK = 8
"""Pixels a side that one pixel of the small map becomes."""

AUXILIARY_WEIGHT = 0.4
"""What the auxiliary head's loss counts beside the main one's."""


class DUpsamplingOutputs(NamedTuple):
    """Hold logits and those of the auxiliary head, (B, C, H, W) each; None where not asked for."""

    logits: Tensor
    auxiliary: Tensor | None


class DUpsampling(Network):
    """Join the last three layers of a dilated ResNet-50 and upsample by learned blocks."""

    divisor = BLOCK
    auxiliary = True

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        middle, low = scaled(256, width), scaled(48, width)
        self.encoder = ResNet(
            50,
            inputs,
            width,
            strides=(1, 2, 1, 1),
            dilations=(1, 1, (1, 2, 2, 2, 2, 2), (2, 4, 4)),
            deep_stem=True,
        )
        channels = self.encoder.channels
        self.low2 = conv_bn_relu(channels[2], low, 1)
        self.low3 = conv_bn_relu(channels[3], low, 1)
        self.joined = nn.Sequential(
            conv_bn_relu(channels[4] + 2 * low, middle), conv_bn_relu(middle, middle)
        )
        self.up = conv(middle, classes * BLOCK**2, 1)
        self.auxiliary_head = nn.Sequential(
            conv_bn_relu(channels[3], middle),
            nn.Dropout(0.1),
            conv(middle, middle, 1, bias=True),
            conv(middle, classes * BLOCK**2, 1),
        )

    def losses(
        self,
        outputs: Any,
        labels: Tensor,
        class_weights: Tensor | None = None,
        ignore_index: int = IGNORE,
    ) -> dict[str, Tensor]:
        """Return the main head's cross-entropy and, times 0.4, the auxiliary head's."""
        parts = super().losses(outputs, labels, class_weights, ignore_index)
        if isinstance(outputs, Tensor) or outputs.auxiliary is None:
            return parts
        beside = cross_entropy(outputs.auxiliary, labels, class_weights, ignore_index)
        return {**parts, "auxiliary": AUXILIARY_WEIGHT * beside}

    def _outputs(self, *images: Tensor, auxiliary: bool) -> DUpsamplingOutputs:
        encoder = self.encoder
        layer1 = encoder.layer(1, encoder.pool(encoder.stem(images[0])))
        layer2 = encoder.layer(2, layer1)
        layer3 = encoder.layer(3, layer2)
        layer4 = encoder.layer(4, layer3)
        x = self.joined(torch.cat([layer4, self.low3(layer3), self.low2(layer2)], dim=1))
        beside = self._spread(self.auxiliary_head(layer3)) if auxiliary else None
        return DUpsamplingOutputs(self._spread(self.up(x)), beside)

    def _spread(self, x: Tensor) -> Tensor:
        """Return blocks, whose channels are (row, column, class), side by side as an image."""
        batch, _, height, width = x.shape
        x = x.reshape(batch, BLOCK, BLOCK, self.classes, height, width)
        x = x.permute(0, 3, 4, 1, 5, 2)
        return x.reshape(batch, self.classes, height * BLOCK, width * BLOCK)
