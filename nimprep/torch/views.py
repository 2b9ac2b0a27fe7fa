"""What networks are given of a modality other than its values: repeated, masked, stretched."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

Scale = Callable[[str, Tensor, Tensor], None]
"""`Scaling.apply`."""


@dataclass(frozen=True)
class View:
    """Say what a tensor holds that is made of one modality as a network is given it.

    Attributes
    ----------
    of : str
        The modality, of one channel.
    channels : int
    write : callable
        Called with the modality's values in their unit, (1, H, W) float32 with 0 = none, what
        scales it, and the tensor to write, (C, H, W) float32.
    """

    of: str
    channels: int
    write: Callable[[Tensor, Scale, Tensor], None]


def _repeated(depth_m: Tensor, scale: Scale, out: Tensor) -> None:
    scale("depth", depth_m, out[:1])
    out[1:] = out[:1]


def _mask(depth_m: Tensor, scale: Scale, out: Tensor) -> None:
    out.copy_(depth_m != 0)


def _stretched(depth_m: Tensor, scale: Scale, out: Tensor) -> None:
    known = depth_m != 0
    out.zero_()
    if known.any():
        low, high = depth_m[known].min(), depth_m.max()
        out[known] = (depth_m[known] - low) / (high - low).clamp(min=1e-6)


VIEWS: dict[str, View] = {
    "depth3": View("depth", 3, _repeated),
    "mask": View("depth", 1, _mask),
    "depth-minmax": View("depth", 1, _stretched),
}
"""By the name that setups and `modalities` have for them.

``depth3`` is depth three times over, scaled as depth is, for encoders that take three channels;
``mask`` is 1 where there is depth and 0 where not; ``depth-minmax`` is each image's own depth from
0, its nearest, to 1, its farthest, and 0 where there is none.
"""
