"""RTFNet: two residual encoders whose maps are added scale by scale, and five steps up.

With surface normals as the second image it is NIM-RTFNet.

Source: Sun, Zuo & Liu, "RTFNet: RGB-thermal fusion network for semantic segmentation of urban
scenes", RA-L 4, 2019; Wang et al., IROS 2020, for NIM-RTFNet, whose depth is not said.
"""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from nimprep.networks.layers import conv
from nimprep.networks.network import Logits, Network
from nimprep.networks.resnet import ResNet


class _Step(nn.Module):
    """Convolve three times beside a shortcut; where it goes up, to twice the size."""

    def __init__(self, inputs: int, outputs: int, up: bool) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            conv(inputs, outputs, 1),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            conv(outputs, outputs),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            _twice(outputs, outputs) if up else conv(outputs, outputs),
            nn.BatchNorm2d(outputs),
        )
        self.shortcut = (
            nn.Sequential(_twice(inputs, outputs), nn.BatchNorm2d(outputs)) if up else None
        )

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.layers(x)
        return functional.relu(y + (x if self.shortcut is None else self.shortcut(x)))


def _twice(inputs: int, outputs: int) -> nn.ConvTranspose2d:
    return nn.ConvTranspose2d(inputs, outputs, 2, 2, bias=False)


class RTFNet(Network):
    """Add the second encoder's maps to the first's at five scales; logits are 0 or more.

    Parameters
    ----------
    depth : {18, 34, 50, 101, 152}
        Of both ResNets.
    """

    divisor = 32

    def __init__(
        self, inputs: tuple[int, int], classes: int, width: float = 1.0, depth: int = 18
    ) -> None:
        super().__init__(inputs, classes)
        self.first = ResNet(depth, inputs[0], width)
        self.second = ResNet(depth, inputs[1], width)
        channels = self.first.channels[-1]
        steps: list[nn.Module] = []
        for place in range(5):
            after = classes if place == 4 else channels // 2
            steps += [_Step(channels, channels, up=False), _Step(channels, after, up=True)]
            channels = after
        self.decoder = nn.Sequential(*steps)
        for module in self.decoder.modules():
            if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
                nn.init.xavier_uniform_(module.weight)

    def _outputs(self, *images: Tensor, auxiliary: bool) -> Logits:
        y = self.second.stem(images[1])
        x = self.first.stem(images[0]) + y
        x, y = self.first.pool(x), self.second.pool(y)
        for number in range(1, 5):
            y = self.second.layer(number, y)
            x = self.first.layer(number, x) + y
        return Logits(self.decoder(x))
