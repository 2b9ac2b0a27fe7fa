"""GSCNN: a second stream that looks at shapes alone, gated by what the first one sees.

Source: Takikawa et al., "Gated-SCNN: Gated shape CNNs for semantic segmentation", ICCV 2019.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from nimprep.networks.edges import canny_edges
from nimprep.networks.gscnn_losses import (
    EDGE_WEIGHT,
    attention_loss,
    dual_task_loss,
    edge_loss,
)
from nimprep.networks.layers import ImagePooling, conv, conv_bn_relu, resized, scaled
from nimprep.networks.losses import IGNORE
from nimprep.networks.network import Network
from nimprep.networks.resnet import BasicBlock
from nimprep.networks.wide_resnet import WideResNet38

GATING = (2, 3, 6)
"""The encoder's stages that gate: of 256, 512 and 4096 channels."""

RATES = (12, 24, 36)


class GSCNNOutputs(NamedTuple):
    """Hold logits, (B, C, H, W), and how likely each pixel is an edge, (B, 1, H, W) in 0...1."""

    logits: Tensor
    edge: Tensor | None


class _Gate(nn.Module):
    """Let through what the gating map and the feature itself say is a boundary."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.attention = nn.Sequential(
            nn.BatchNorm2d(channels + 1),
            conv(channels + 1, channels + 1, 1, bias=True),
            nn.ReLU(),
            conv(channels + 1, 1, 1, bias=True),
            nn.BatchNorm2d(1),
            nn.Sigmoid(),
        )
        self.conv = conv(channels, channels, 1)

    def forward(self, feature: Tensor, gating: Tensor) -> Tensor:
        attention = self.attention(torch.cat([feature, gating], dim=1))
        y: Tensor = self.conv(feature * (attention + 1))
        return y


class _ShapeStream(nn.Module):
    """Find boundaries at full size: three residual blocks, each with fewer channels and a gate."""

    def __init__(self, first: int, gating: list[int], width: float) -> None:
        super().__init__()
        channels = [first, *(scaled(c, width) for c in (32, 16, 8))]
        pairs = list(pairwise(channels))
        self.gating = nn.ModuleList(conv(c, 1, 1, bias=True) for c in gating)
        self.blocks = nn.ModuleList(BasicBlock(a, a) for a, _ in pairs)
        self.reduced = nn.ModuleList(conv(a, b, 1, bias=True) for a, b in pairs)
        self.gates = nn.ModuleList(_Gate(b) for _, b in pairs)
        self.edge = conv(channels[-1], 1, 1)
        # The published network has this one and looks at it nowhere: parameters are as many.
        self.unused = conv(first, 1, 1, bias=True).requires_grad_(False)

    def forward(self, first: Tensor, stages: list[Tensor]) -> Tensor:
        x = first
        for place, stage in enumerate(stages):
            x = self.reduced[place](self.blocks[place](x))
            gating = resized(self.gating[place](stage), first.shape[2:], align_corners=True)
            x = self.gates[place](x, gating)
        return torch.sigmoid(self.edge(x))


class GSCNN(Network):
    """Segment by a wide residual network whose pyramid sees the edges of a shape stream."""

    divisor = 8
    auxiliary = True
    wants_canny = True

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        middle, low = scaled(256, width), scaled(48, width)
        self.encoder = WideResNet38(inputs, width)
        channels = self.encoder.channels
        self.shape = _ShapeStream(channels[0], [channels[i] for i in GATING], width)
        self.with_canny = conv(2, 1, 1)
        last = channels[-1]
        self.pooling = ImagePooling(last, middle)
        self.edge_branch = conv_bn_relu(1, middle, 1)
        self.branches = nn.ModuleList(
            [
                conv_bn_relu(last, middle, 1),
                *(conv_bn_relu(last, middle, dilation=rate) for rate in RATES),
            ]
        )
        self.joined = conv(6 * middle, middle, 1)
        self.low = conv(channels[1], low, 1)
        self.head = nn.Sequential(
            conv_bn_relu(middle + low, middle),
            conv_bn_relu(middle, middle),
            conv(middle, classes, 1),
        )

    def forward(  # type: ignore[override]
        self, x: Tensor, canny: Tensor | None = None
    ) -> Tensor | GSCNNOutputs:
        """Return logits; in training logits and edges.

        Parameters
        ----------
        x : (B, N, H, W) floating
        canny : (B, 1, H, W), optional
            255 on an edge of the raw image, else 0 (`nimprep.networks.edges.canny_edges`); None =
            made of `x`, each image stretched to 0...255.

        Raises
        ------
        ArrayError
            Channels or sizes are others.
        """
        found: Tensor | GSCNNOutputs = super().forward(x, self._canny(x, canny))
        return found

    def outputs(  # type: ignore[override]
        self, x: Tensor, canny: Tensor | None = None
    ) -> GSCNNOutputs:
        """Return logits and edges in any mode; parameters as for `forward`."""
        found: GSCNNOutputs = super().outputs(x, self._canny(x, canny))
        return found

    def _channels(self, count: int) -> tuple[int, ...]:
        return (*super()._channels(count), 1)

    @staticmethod
    def _canny(x: Tensor, canny: Tensor | None) -> Tensor:
        return canny_edges(x) if canny is None else canny.to(x.dtype)

    def losses(
        self,
        outputs: Any,
        labels: Tensor,
        class_weights: Tensor | None = None,
        ignore_index: int = IGNORE,
    ) -> dict[str, Tensor]:
        """Return "segmentation", "edge" (times 20), "attention" and "dual": see `gscnn_losses`."""
        parts = super().losses(outputs, labels, class_weights, ignore_index)
        if isinstance(outputs, Tensor) or outputs.edge is None:
            return parts
        logits, edge = outputs
        labels = labels.to(torch.int64)
        attention = attention_loss(logits, edge, labels, class_weights, ignore_index)
        return {
            **parts,
            "edge": EDGE_WEIGHT * edge_loss(edge, labels, ignore_index),
            "attention": attention,
            "dual": dual_task_loss(logits, labels, ignore_index),
        }

    def _outputs(self, *images: Tensor, auxiliary: bool) -> GSCNNOutputs:
        x, canny = images
        stages = self.encoder(x)
        edge = self.shape(stages[0], [stages[i] for i in GATING])
        seen = torch.sigmoid(self.with_canny(torch.cat([edge, canny], dim=1)))
        last = stages[-1]
        edges = resized(seen, last.shape[2:], align_corners=True)
        pyramid = [self.pooling(last), self.edge_branch(edges)]
        pyramid += [branch(last) for branch in self.branches]
        up = resized(self.joined(torch.cat(pyramid, dim=1)), stages[1].shape[2:], True)
        logits = self.head(torch.cat([self.low(stages[1]), up], dim=1))
        logits = resized(logits, x.shape[2:], align_corners=False)
        return GSCNNOutputs(logits, edge if auxiliary else None)
