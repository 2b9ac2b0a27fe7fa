"""SegNet: VGG16 with normalisation, undone by unpooling where each maximum was.

Source: Badrinarayanan, Kendall & Cipolla, "SegNet: A deep convolutional encoder-decoder
architecture for image segmentation", PAMI 39, 2017.
"""

from __future__ import annotations

from torch import Tensor

from nimprep.networks.network import Logits, Network
from nimprep.networks.unpooling import UnpoolingDecoder, pooled
from nimprep.networks.vgg import VGG16


class SegNet(Network):
    """Encode by VGG16, decode by its mirror image."""

    def __init__(self, inputs: int, classes: int, width: float = 1.0) -> None:
        super().__init__(inputs, classes)
        self.encoder = VGG16(inputs, batch_norm=True, width=width)
        self.decoder = UnpoolingDecoder(classes, width)

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        x = images[0]
        pools = []
        for stage in range(5):
            x, indices, size = pooled(self.encoder.stage(stage, x))
            pools.append((indices, size))
        return Logits(self.decoder(x, pools))
