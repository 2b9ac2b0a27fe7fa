"""The Canny map that GSCNN takes beside an image, as an operation that PyTorch can trace."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

LOW, HIGH = 10, 100
"""Canny's thresholds on 8-bit images, those of GSCNN's authors."""


@torch.library.custom_op("nimprep::canny_edges", mutates_args=())
def canny_edges(images: Tensor) -> Tensor:
    """Return where images have edges, by Canny's method.

    Parameters
    ----------
    images : (B, N, H, W)
        8-bit images; others are stretched, each by itself, so that they fill 0...255. Of three
        channels or more the first three count, else the first.

    Returns
    -------
    (B, 1, H, W)
        255 on an edge, else 0; of the images' dtype, float32 where they are 8-bit.

    References
    ----------
    Canny, "A computational approach to edge detection", PAMI 8, 1986.
    """
    import cv2

    dtype = images.dtype if images.is_floating_point() else torch.float32
    edges = torch.empty((len(images), 1, *images.shape[2:]), dtype=dtype)
    for place, image in enumerate(images.detach()):
        some = image[: 3 if len(image) >= 3 else 1]
        if some.dtype != torch.uint8:
            some = _stretched(some.to(torch.float32))
        pixels = np.ascontiguousarray(some.permute(1, 2, 0).cpu().numpy())
        edges[place, 0] = torch.from_numpy(cv2.Canny(pixels, LOW, HIGH))
    return edges.to(images.device)


def _stretched(image: Tensor) -> Tensor:
    low, high = image.min(), image.max()
    if not high > low:
        return torch.zeros_like(image, dtype=torch.uint8)
    return ((image - low) * (255 / (high - low))).round().clamp(0, 255).to(torch.uint8)


@canny_edges.register_fake
def _(images: Tensor) -> Tensor:
    dtype = images.dtype if images.is_floating_point() else torch.float32
    return images.new_empty((len(images), 1, *images.shape[2:]), dtype=dtype)
