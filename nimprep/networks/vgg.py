"""VGG16's convolutions as an encoder, named as torchvision names them.

Source: Simonyan & Zisserman, "Very deep convolutional networks for large-scale image recognition",
ICLR 2015, configuration D.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

from torch import Tensor, nn

from nimprep.networks.layers import conv, scaled

STAGES = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Channels of the convolutions before each of the five max pools."""


def stage_channels(width: float = 1.0) -> tuple[tuple[int, ...], ...]:
    """Return the channels of each stage's convolutions at a width."""
    return tuple(tuple(scaled(c, width) for c in stage) for stage in STAGES)


class VGG16(nn.Module):
    """Hold the convolutions of VGG16, stage by stage; pooling is the network's own.

    Parameters
    ----------
    inputs : int
        Channels of the image.
    batch_norm : bool
        Whether each convolution is followed by batch normalisation.
    width : float
        Of the channels; 1 = 64 to 512.
    stages : int
        How many of the five there are.
    padding : int
        Of the very first convolution.
    dilations : sequence of int
        Of each stage's convolutions.
    first : callable, optional
        Makes each stage's first convolution of its channels in and out and its dilation; it is
        called with what `stage` is given beside the image.
    """

    def __init__(
        self,
        inputs: int,
        batch_norm: bool = False,
        width: float = 1.0,
        stages: int = 5,
        padding: int = 1,
        dilations: Sequence[int] = (1, 1, 1, 1, 1),
        first: Callable[[int, int, int], nn.Module] | None = None,
    ) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        self._spans: list[range] = []
        self.channels: list[int] = []
        before = inputs
        for channels, dilation in list(zip(stage_channels(width), dilations, strict=True))[:stages]:
            begin = len(layers)
            for c in channels:
                own = first if len(layers) == begin else None
                layers.append(
                    conv(before, c, dilation=dilation, bias=True)
                    if own is None
                    else own(before, c, dilation)
                )
                layers += [nn.BatchNorm2d(c)] if batch_norm else []
                layers.append(nn.ReLU())
                before = c
            self._spans.append(range(begin, len(layers)))
            self.channels.append(before)
            # torchvision's numbering counts the pool; the network pools by itself.
            layers.append(nn.Identity())
        self.features = nn.ModuleList(layers)
        if padding != 1:
            cast(nn.Conv2d, self.features[0]).padding = (padding, padding)

    def stage(self, number: int, x: Tensor, *beside: Tensor) -> Tensor:
        """Return what a stage, counted from 0, makes of the stage's before it, pooled."""
        begin, *rest = self._spans[number]
        x = self.features[begin](x, *beside)
        for place in rest:
            x = self.features[place](x)
        return x
