"""FuseNet: the depth encoder's maps are added to the colour encoder's, stage by stage.

Source: Hazirbas et al., "FuseNet: Incorporating depth into semantic segmentation via fusion-based
CNN architecture", ACCV 2016; sparse fusion, SF1 to SF5.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional

from nimprep.errors import ArrayError
from nimprep.networks.network import Logits, Network
from nimprep.networks.unpooling import UnpoolingDecoder, pooled
from nimprep.networks.vgg import VGG16


class FuseNet(Network):
    """Encode by two VGG16 with normalisation, decode as SegNet does.

    Parameters
    ----------
    stages : {1, 2, 3, 4, 5}
        How many stages are fused; the second encoder ends there.
    """

    divisor = 32

    def __init__(
        self, inputs: tuple[int, int], classes: int, width: float = 1.0, stages: int = 5
    ) -> None:
        if stages not in range(1, 6):
            raise ArrayError(f"stages: expected 1 to 5, found {stages!r}")
        super().__init__(inputs, classes)
        self.stages = stages
        self.first = VGG16(inputs[0], batch_norm=True, width=width)
        self.second = VGG16(inputs[1], batch_norm=True, width=width, stages=stages)
        self.decoder = UnpoolingDecoder(classes, width, drops=(3, 4, 5))

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        x, y = images
        pools = []
        for stage in range(5):
            x = self.first.stage(stage, x)
            if stage < self.stages:
                y = self.second.stage(stage, y)
                x = x + y
            x, indices, size = pooled(x)
            pools.append((indices, size))
            if stage >= 2:
                x = functional.dropout(x, 0.5, self.training)
            if stage + 1 < self.stages:
                y = functional.max_pool2d(y, 2)
                y = functional.dropout(y, 0.5, self.training) if stage >= 2 else y
        return Logits(self.decoder(x, pools))
