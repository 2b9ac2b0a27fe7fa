"""The decoder that SegNet and FuseNet share: unpool by the encoder's indices, convolve."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv, conv_bn_relu
from nimprep.networks.vgg import stage_channels

Pooled = tuple[Tensor, Tensor, tuple[int, int]]
"""A pooled map, where its maxima were, and the size before."""


def pooled(x: Tensor) -> Pooled:
    """Pool 2x2, keeping what undoes it."""
    y, indices = functional.max_pool2d(x, 2, return_indices=True)
    return y, indices, (x.shape[2], x.shape[3])


class UnpoolingDecoder(nn.Module):
    """Mirror VGG16's stages: each unpools, then convolves as often as the encoder's did.

    Parameters
    ----------
    classes : int
    width : float
    stages : int
        How many, from the deepest of them on.
    drops : collection of int
        Stages, counted from 1 at full size, whose result is thinned out by `Dropout(0.5)`.
    """

    def __init__(
        self, classes: int, width: float = 1.0, stages: int = 5, drops: tuple[int, ...] = ()
    ) -> None:
        super().__init__()
        channels = stage_channels(width)
        modules: list[nn.Module] = []
        for number in reversed(range(stages)):
            into = channels[number][-1]
            after = channels[number - 1][-1] if number else classes
            count = len(channels[number])
            layers: list[nn.Module] = [
                conv_bn_relu(into, into, bias=True) for _ in range(count - 1)
            ]
            # The very last convolution gives the logits: nothing after it.
            layers.append(
                conv_bn_relu(into, after, bias=True) if number else conv(into, after, bias=True)
            )
            layers += [nn.Dropout(0.5)] if number + 1 in drops else []
            modules.append(nn.Sequential(*layers))
        self.stages = nn.ModuleList(modules)

    def forward(self, x: Tensor, pools: list[tuple[Tensor, tuple[int, int]]]) -> Tensor:
        """Return the logits.

        Parameters
        ----------
        pools : list of (indices, (height, width))
            Of the encoder's pools, the first at full size.
        """
        for stage, (indices, size) in zip(self.stages, reversed(pools), strict=True):
            x = stage(functional.max_unpool2d(x, indices, [2, 2], output_size=size))
        return x
