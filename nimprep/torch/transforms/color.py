"""Colour jitter: one affine map of colours per sample, on rgb only."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nimprep.errors import ArrayError
from nimprep.torch.transforms.geometry import Sample, frame_size
from nimprep.torch.transforms.randomly import uniform

# Luma and chroma of NTSC's YIQ (FCC 1953, the two-digit coefficients): turning (I, Q) turns the
# hue and leaves greys alone.
_YIQ = torch.tensor(
    [[0.30, 0.59, 0.11], [0.60, -0.28, -0.32], [0.21, -0.52, 0.31]], dtype=torch.float64
)


def jitter(
    sample: Sample,
    brightness: float = 1.0,
    contrast: float = 1.0,
    saturation: float = 1.0,
    hue: float = 0.0,
) -> Sample:
    """Change the colours of rgb, in this order, clipped once at the end; padding stays 0.

    Parameters
    ----------
    brightness : float
        Factor on every value.
    contrast : float
        Factor on the distance from the frame's mean luma.
    saturation : float
        Factor on the distance from the pixel's own luma; 0 = grey.
    hue : float
        Turns around the colour circle, 0.5 = opposite colours.
    """
    if "rgb" not in sample:
        return sample
    rgb: Tensor = sample["rgb"]
    height, width = frame_size(sample)
    frame = rgb[:, :height, :width].float()
    luma = _YIQ[0]
    mean = (luma @ frame.mean(dim=(1, 2)).double().cpu()).item() * brightness
    cos, sin = (saturation * f(2 * math.pi * hue) for f in (math.cos, math.sin))
    chroma = torch.tensor([[1, 0, 0], [0, cos, -sin], [0, sin, cos]], dtype=torch.float64)
    turn = torch.linalg.solve(_YIQ, chroma @ _YIQ)
    matrix = (turn * (brightness * contrast)).to(frame)
    offset = (1 - contrast) * mean
    changed = torch.einsum("ij,jhw->ihw", matrix, frame) + offset
    result = torch.zeros_like(rgb)
    result[:, :height, :width] = changed.round().clamp(0, 255).to(rgb.dtype)
    return {**sample, "rgb": result}


@dataclass(frozen=True)
class ColorJitter:
    """Change brightness, contrast, saturation and hue of rgb by chance; nothing else.

    Parameters
    ----------
    brightness, contrast, saturation : float
        The factor is uniform in [max(0, 1 - x), 1 + x].
    hue : float
        The turn is uniform in [-x, x], at most 0.5.
    """

    brightness: float = 0.0
    contrast: float = 0.0
    saturation: float = 0.0
    hue: float = 0.0

    def __post_init__(self) -> None:
        amounts = (self.brightness, self.contrast, self.saturation, self.hue)
        if not all(0 <= x < float("inf") for x in amounts) or self.hue > 0.5:
            raise ArrayError(
                f"ColorJitter: expected amounts of at least 0 and a hue up to 0.5, found {amounts}"
            )

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample with other colours."""
        amounts = (self.brightness, self.contrast, self.saturation)
        brightness, contrast, saturation = (
            uniform(sample, max(0.0, 1 - x), 1 + x) for x in amounts
        )
        hue = uniform(sample, -self.hue, self.hue)
        return jitter(sample, brightness, contrast, saturation, hue)
