"""GSCNN's losses of edges, and of edges and classes that disagree.

Written as the paper states them: equation 3 with lambda 1 = 20 and lambda 2 = 1, its binary
cross-entropy balanced by a coefficient beta; equations 4 to 8 with lambda 3 = lambda 4 = 1, tau = 1
and the threshold 0.8. Equation 6 lacks a minus sign, as its authors say. The paper writes sums over
pixels; here each is a mean over the pixels that count, so that weights mean the same at every size.
What it leaves open is ours and said where it stands: beta's formula, how wide an edge of the labels
is, and the Gaussian's sigma. The public code (nv-tlabs/GSCNN, 2019) does otherwise:

- edges: the network's probabilities go through a sigmoid a second time; the image's border is an
  edge, the border of the first class alone is none;
- classes, here and where edges are certain: cross-entropy is weighted by 2 minus each label's share
  of its own image, and summed over a batch's images;
- the regularizer: its functions that smooth and differentiate return at once what they are given,
  which its authors called a bug, so that it compares not gradients but each class's probability,
  divided by the batch's largest, at every pixel; a sample of the Gumbel softmax at temperature 0.5
  stands for argmax forward too; ignored pixels are taken for class 0.

Source: Takikawa et al., "Gated-SCNN: Gated shape CNNs for semantic segmentation", ICCV 2019.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from nimprep.networks.losses import cross_entropy, mean_where

EDGE_WEIGHT = 20.0
"""Lambda 1 of equation 3; lambda 2 to 4, of classes and of the regularizer's parts, are 1."""

CERTAIN = 0.8
"""How likely an edge must be for its pixel to count in the attention loss: equation 6."""

TEMPERATURE = 1.0
"""Tau of the Gumbel softmax that stands for argmax in the gradient: equation 8."""

RADIUS = 2
"""How near to another class a pixel is an edge, pixels: the public code's."""

SIGMA = 1.0
"""Of the Gaussian before the gradient, pixels: ours."""

_REACH = 3
_NOTHING = 1e-5


def label_edges(labels: Tensor, ignore_index: int, radius: int = RADIUS) -> Tensor:
    """Return where another class is at most `radius` pixels away, (B, H, W) bool.

    Pixels without a label are no edge and make none.
    """
    height, width = labels.shape[1:]
    around = functional.pad(labels, (radius,) * 4, value=ignore_index)
    edges = torch.zeros_like(labels, dtype=torch.bool)
    for v in range(-radius, radius + 1):
        for u in range(-radius, radius + 1):
            if 0 < u * u + v * v <= radius * radius:
                near = around[:, radius + v :, radius + u :][:, :height, :width]
                edges = edges | ((near != labels) & (near != ignore_index))
    return edges & (labels != ignore_index)


def edge_loss(edge: Tensor, labels: Tensor, ignore_index: int) -> Tensor:
    """Return the balanced binary cross-entropy of the edges, the mean over labelled pixels.

    Edges count times beta, the share of pixels that are none, and others times 1 - beta: few are
    edges, and both kinds count alike (Xie & Tu, "Holistically-nested edge detection", ICCV 2015,
    equation 2). 0 where all pixels are of one kind.

    Parameters
    ----------
    edge : (B, 1, H, W)
        How likely each pixel is an edge, 0 to 1.
    labels : (B, H, W) int64
    ignore_index : int
    """
    wanted = label_edges(labels, ignore_index)
    known = labels != ignore_index
    with torch.autocast(edge.device.type, enabled=False):
        likely = edge[:, 0].to(torch.promote_types(edge.dtype, torch.float32))
        each = functional.binary_cross_entropy(likely, wanted.to(likely.dtype), reduction="none")
        beta = mean_where((~wanted).to(likely.dtype), known)
        return mean_where(each * torch.where(wanted, beta, 1 - beta), known)


def attention_loss(
    logits: Tensor,
    edge: Tensor,
    labels: Tensor,
    class_weights: Tensor | None,
    ignore_index: int,
) -> Tensor:
    """Return the cross-entropy where an edge is certain: equation 6, with its minus sign."""
    certain = edge.detach()[:, 0] > CERTAIN
    there = torch.where(certain, labels, ignore_index)
    return cross_entropy(logits, there, class_weights, ignore_index)


def dual_task_loss(logits: Tensor, labels: Tensor, ignore_index: int) -> Tensor:
    """Return how far edges of the predicted classes are from those of the labels.

    Equation 5: the mean of |zeta - zeta'| over the pixels where either is not 0, zeta (equation 4)
    being 1/sqrt(2) times the length, over classes and both directions, of the gradient, by Sobel's
    kernel, of the smoothed classes. Classes are argmax; the gradient goes through a Gumbel softmax
    (equation 8), whose noise is drawn from torch's generator. Where the filters reach an ignored
    pixel nothing counts.
    """
    known = labels != ignore_index
    classes = logits.shape[1]
    with torch.autocast(logits.device.type, enabled=False):
        numbers = logits.to(torch.promote_types(logits.dtype, torch.float32))
        found = _gradient(_argmax(numbers))
        wanted = _gradient(_one_hot(torch.where(known, labels, 0), classes).to(numbers.dtype))
        reach = 2 * (_REACH + 1) + 1
        near = functional.max_pool2d((~known).to(numbers.dtype)[:, None], reach, 1, reach // 2)
        either = (found.detach() > _NOTHING) | (wanted > _NOTHING)
        return mean_where((found - wanted).abs(), either & (near[:, 0] == 0))


def _one_hot(labels: Tensor, classes: int) -> Tensor:
    return functional.one_hot(labels, classes).permute(0, 3, 1, 2)


def _argmax(logits: Tensor) -> Tensor:
    """Return the likeliest class as one of (B, C, H, W), with a Gumbel softmax's gradient."""
    noise = -torch.empty_like(logits).exponential_().log()
    soft = functional.softmax((functional.log_softmax(logits, 1) + noise) / TEMPERATURE, dim=1)
    hard = _one_hot(logits.argmax(dim=1), logits.shape[1]).to(logits.dtype)
    return hard + (soft - soft.detach())


def _gradient(x: Tensor) -> Tensor:
    """Return zeta, (B, H, W), of classes (B, C, H, W)."""
    steps = torch.arange(-_REACH, _REACH + 1, dtype=x.dtype, device=x.device)
    smooth = torch.exp(-(steps**2) / (2 * SIGMA**2))
    smooth = smooth / smooth.sum()
    blurred = _filtered(_filtered(x, smooth[None, :]), smooth[:, None])
    sobel = x.new_tensor([[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / 8
    right, down = _filtered(blurred, sobel), _filtered(blurred, sobel.t())
    squared = (right**2 + down**2).sum(dim=1)
    # The root's gradient at 0 is infinite.
    some = squared > _NOTHING**2
    root = torch.sqrt(torch.where(some, squared, torch.ones_like(squared)))
    return torch.where(some, root, torch.zeros_like(root)) / math.sqrt(2)


def _filtered(x: Tensor, kernel: Tensor) -> Tensor:
    """Return each channel correlated with a kernel, the border repeated beyond it."""
    down, right = kernel.shape[0] // 2, kernel.shape[1] // 2
    channels = x.shape[1]
    padded = functional.pad(x, (right, right, down, down), mode="replicate")
    return functional.conv2d(padded, kernel.expand(channels, 1, -1, -1), groups=channels)
