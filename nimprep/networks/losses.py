"""What training lowers: cross-entropy, and what single networks add to it."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from nimprep.errors import ArrayError

IGNORE = 255
"""The label of pixels that have none."""


def cross_entropy(
    logits: Tensor,
    labels: Tensor,
    class_weights: Tensor | None = None,
    ignore_index: int = IGNORE,
) -> Tensor:
    """Return the mean cross-entropy of the labelled pixels, each counted by its class's weight.

    As `torch.nn.functional.cross_entropy`, but 0, not NaN, where no pixel counts; in float32
    whatever autocast says.

    Parameters
    ----------
    logits : (B, C, H, W) floating
    labels : (B, H, W) integer
        0 to C - 1, or `ignore_index`.
    class_weights : (C,) floating, optional
        None = 1 each.
    ignore_index : int
        The label of pixels that do not count.

    Raises
    ------
    ArrayError
        The shapes do not fit, or a label is no class. That is looked at on the CPU alone, and not
        in a graph that PyTorch compiles.
    """
    labels = checked_labels(logits, labels, ignore_index)
    with torch.autocast(logits.device.type, enabled=False):
        numbers = logits.to(torch.promote_types(logits.dtype, torch.float32))
        weights = numbers.new_ones(numbers.shape[1])
        if class_weights is not None:
            weights = class_weights.to(weights)
        each = functional.cross_entropy(
            numbers, labels, weights, ignore_index=ignore_index, reduction="none"
        )
        known = labels != ignore_index
        counted = weights[torch.where(known, labels, 0)] * known
        return each.sum() / _or_one(counted.sum())


def mean_where(values: Tensor, counts: Tensor) -> Tensor:
    """Return the mean of the values that count, 0 where none does; gradients pass, 0 as well."""
    return torch.where(counts, values, torch.zeros_like(values)).sum() / _or_one(counts.sum())


def _or_one(total: Tensor) -> Tensor:
    return torch.where(total > 0, total, torch.ones_like(total))


def checked_labels(logits: Tensor, labels: Tensor, ignore_index: int) -> Tensor:
    """Return labels as int64; `ArrayError` where they are not the logits'."""
    if labels.is_floating_point() or labels.shape != (len(logits), *logits.shape[2:]):
        raise ArrayError(
            f"labels: expected integer {(len(logits), *logits.shape[2:])} as the logits' images, "
            f"found {labels.dtype} {tuple(labels.shape)}"
        )
    labels = labels.to(torch.int64)
    if labels.device.type == "cpu" and not torch.compiler.is_compiling():
        wrong = (labels != ignore_index) & ((labels < 0) | (labels >= logits.shape[1]))
        if wrong.any():
            raise ArrayError(
                f"labels: expected 0 to {logits.shape[1] - 1}, or {ignore_index} where there is "
                f"none, found {int(labels[wrong][0])}; give the network that many classes"
            )
    return labels
