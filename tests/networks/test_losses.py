"""Losses: what is known of them by analysis, plain twins of them, and that they are never NaN."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from nimprep.errors import ArrayError
from nimprep.networks import NETWORKS, build_network
from nimprep.networks.gscnn import GSCNNOutputs
from nimprep.networks.gscnn_losses import (
    attention_loss,
    dual_task_loss,
    edge_loss,
    label_edges,
)
from nimprep.networks.losses import cross_entropy
from tests.networks.test_networks import images, made

IGNORE = 255

TWELVE = [
    name for name in NETWORKS if name not in ("rtfnet34", "rtfnet50", "rtfnet101", "rtfnet152")
]


def some(seed: int = 0, size: tuple[int, int] = (20, 26)) -> tuple[Tensor, Tensor, Tensor]:
    """Return logits, edges and labels in blocks, a corner of which is ignored."""
    generator = torch.Generator().manual_seed(seed)
    small = torch.randint(0, 3, (2, 4, 6), generator=generator)
    labels = small.repeat_interleave(6, 1).repeat_interleave(6, 2)[:, : size[0], : size[1]]
    labels[0, :4, :4] = IGNORE
    logits = torch.randn(2, 3, *size, generator=generator) * 3
    edge = torch.rand(2, 1, *size, generator=generator)
    return logits, edge, labels.contiguous()


def one_hot(labels: Tensor, classes: int = 3) -> Tensor:
    known = torch.where(labels == IGNORE, 0, labels)
    return functional.one_hot(known, classes).permute(0, 3, 1, 2).float()


@pytest.mark.parametrize("weighted", [False, True])
def test_cross_entropy_is_pytorchs(weighted: bool) -> None:
    logits, _, labels = some()
    weights = torch.tensor([0.5, 2.0, 3.0]) if weighted else None
    wanted = functional.cross_entropy(logits, labels, weights, ignore_index=IGNORE)
    torch.testing.assert_close(cross_entropy(logits, labels, weights), wanted)
    assert cross_entropy(torch.zeros(1, 4, 2, 2), labels[:1, :2, :2] * 0) == pytest.approx(
        math.log(4)
    )


def test_edges_are_the_pixels_near_another_class() -> None:
    labels = torch.zeros(1, 9, 12, dtype=torch.int64)
    labels[:, :, 6:] = 1
    edges = label_edges(labels, IGNORE)
    assert edges[0].all(dim=0).tolist() == [4 <= u <= 7 for u in range(12)]
    labels[:, :, 6:] = IGNORE
    assert not label_edges(labels, IGNORE).any()


def test_edges_are_those_of_a_plain_search() -> None:
    _, _, labels = some()
    rows = labels.numpy()
    wanted = np.zeros(rows.shape, bool)
    height, width = rows.shape[1:]
    for b, v, u in np.ndindex(rows.shape):
        for i, j in np.ndindex(height, width):
            near = (i - v) ** 2 + (j - u) ** 2 <= 4
            both = IGNORE not in (rows[b, v, u], rows[b, i, j])
            wanted[b, v, u] |= near and both and rows[b, i, j] != rows[b, v, u]
    assert 0 < wanted.mean() < 1
    assert np.array_equal(label_edges(labels, IGNORE).numpy(), wanted)


def test_the_edge_loss_is_the_balanced_binary_cross_entropy() -> None:
    _, edge, labels = some()
    known = (labels != IGNORE).numpy()
    wanted = label_edges(labels, IGNORE).numpy()
    beta = (known & ~wanted).sum() / known.sum()
    total = 0.0
    for place in np.ndindex(wanted.shape):
        if known[place]:
            likely = float(edge[:, 0][place])
            total -= beta * math.log(likely) if wanted[place] else (1 - beta) * math.log(1 - likely)
    assert float(edge_loss(edge, labels, IGNORE)) == pytest.approx(total / known.sum(), rel=1e-5)
    # Edges and others count alike: beta (1 - beta) log 2 each.
    half = torch.full_like(edge, 0.5)
    alike = 2 * beta * (1 - beta) * math.log(2)
    assert float(edge_loss(half, labels, IGNORE)) == pytest.approx(alike, rel=1e-5)
    assert float(edge_loss(half, labels * 0, IGNORE)) == 0


def test_attention_counts_pixels_of_certain_edges_alone() -> None:
    logits, edge, labels = some()
    there = (edge[:, 0] > 0.8) & (labels != IGNORE)
    wanted = functional.cross_entropy(logits, labels, ignore_index=IGNORE, reduction="none")[there]
    assert float(attention_loss(logits, edge, labels, None, IGNORE)) == pytest.approx(
        float(wanted.mean()), rel=1e-5
    )
    assert float(attention_loss(logits, edge * 0, labels, None, IGNORE)) == 0


def zeta(classes: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Return 1/sqrt(2) |gradient of smoothed classes| of one image, (C, H, W), by plain sums."""
    _, height, width = classes.shape
    gauss = np.exp(-(np.arange(-3, 4) ** 2) / 2.0)
    gauss = np.outer(gauss, gauss) / gauss.sum() ** 2
    sobel = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / 8
    total = np.zeros((height, width))

    def filtered(x: npt.NDArray[Any], kernel: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
        r = len(kernel) // 2
        out = np.zeros_like(x)
        for v, u in np.ndindex(x.shape):
            for i, j in np.ndindex(kernel.shape):
                row = min(max(v + i - r, 0), height - 1)
                out[v, u] += kernel[i, j] * x[row, min(max(u + j - r, 0), width - 1)]
        return out

    for plane in classes.astype(float):
        smooth = filtered(plane, gauss)
        total += filtered(smooth, sobel) ** 2 + filtered(smooth, sobel.T) ** 2
    return np.sqrt(total / 2)


def test_the_dual_task_loss_is_its_plain_twin() -> None:
    logits, _, labels = some(size=(14, 16))
    hard = one_hot(logits.argmax(dim=1)).numpy()
    wanted = one_hot(labels).numpy()
    differences = []
    for b in range(2):
        found, right = zeta(hard[b]), zeta(wanted[b])
        for v, u in np.ndindex(found.shape):
            near = labels[b, max(v - 4, 0) : v + 5, max(u - 4, 0) : u + 5]
            if max(found[v, u], right[v, u]) > 1e-5 and not (near == IGNORE).any():
                differences.append(abs(found[v, u] - right[v, u]))
    assert len(differences) > 100
    loss = float(dual_task_loss(logits, labels, IGNORE))
    assert loss == pytest.approx(float(np.mean(differences)), rel=1e-4)


def test_the_dual_task_loss_is_0_where_classes_are_right_and_known_where_a_step_is_missed() -> None:
    labels = torch.zeros(1, 20, 30, dtype=torch.int64)
    labels[:, :, 15:] = 1
    right = one_hot(labels, 2) * 9
    assert float(dual_task_loss(right, labels, IGNORE)) < 1e-6
    # Of a step seen along the line through it, smoothed and differentiated, the sum is 1; the
    # filters reach 8 pixels of it.
    blind = torch.zeros(1, 2, 20, 30)
    blind[:, 0] = 9
    assert float(dual_task_loss(blind, labels, IGNORE)) == pytest.approx(1 / 8, rel=1e-4)


def test_the_dual_task_loss_has_a_gradient_that_lowers_the_wrong_class() -> None:
    labels = torch.zeros(1, 24, 24, dtype=torch.int64)
    logits = one_hot(labels, 2)
    logits[:, 1, 8:16, 8:16] = 1.2
    logits.requires_grad_()
    dual_task_loss(logits, labels, IGNORE).backward()
    gradient = logits.grad
    assert gradient is not None
    assert gradient.isfinite().all()
    assert float((gradient[:, 1] - gradient[:, 0])[:, 7:17, 7:17].sum()) > 0


@pytest.mark.parametrize("name", TWELVE)
def test_every_network_has_a_loss_that_is_the_sum_of_its_parts(name: str) -> None:
    network = made(name)
    inputs = images(network, 64, 64)
    labels = (inputs[0][:, 0] > 0.5).long()
    torch.manual_seed(0)
    outputs = network(*inputs)
    parts = network.losses(outputs, labels)
    names = {"dupsampling": ["auxiliary"], "gscnn": ["edge", "attention", "dual"]}
    assert list(parts) == ["segmentation", *names.get(name, [])]
    torch.manual_seed(0)
    loss = network.loss(outputs, labels.to(torch.uint8), torch.ones(3))
    assert loss.item() == pytest.approx(sum(part.item() for part in parts.values()), rel=1e-5)
    assert network.loss(outputs, torch.full_like(labels, IGNORE)).item() == 0
    loss.backward()
    logits = outputs if isinstance(outputs, Tensor) else outputs.logits
    assert torch.equal(network.loss(logits, labels), parts["segmentation"])


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_nothing_to_learn_from_is_0_with_a_gradient_and_extremes_are_finite(dtype: Any) -> None:
    network = build_network("gscnn", 3, 3, width=0.125)
    logits, edge, labels = some()
    none = torch.full_like(labels, IGNORE)
    huge = torch.full_like(logits, 1e4) * torch.tensor([1.0, -1, 0])[:, None, None]
    for numbers, likely, given in (
        (logits, edge, none),
        (huge, torch.ones_like(edge), labels),
        (-huge, torch.zeros_like(edge), labels),
        (huge * 0, edge, labels * 0),
    ):
        x, e = (t.detach().to(dtype).requires_grad_() for t in (numbers, likely))
        with torch.autocast("cpu", torch.bfloat16, enabled=dtype == torch.bfloat16):
            loss = network.loss(GSCNNOutputs(x, e), given)
        loss.backward()
        assert loss.isfinite()
        assert x.grad is not None
        assert e.grad is not None
        assert x.grad.isfinite().all()
        assert e.grad.isfinite().all()
        if given is none:
            assert loss.item() == 0


def test_the_parts_count_as_the_papers_say() -> None:
    logits, edge, labels = some()
    parts = build_network("gscnn", 3, 3, width=0.125).losses(GSCNNOutputs(logits, edge), labels)
    torch.testing.assert_close(parts["edge"], 20 * edge_loss(edge, labels, IGNORE))
    network = made("dupsampling")
    outputs = network(*images(network, 64, 64))
    labels = torch.zeros(1, 64, 64, dtype=torch.int64)
    beside = cross_entropy(outputs.auxiliary, labels)
    torch.testing.assert_close(network.losses(outputs, labels)["auxiliary"], 0.4 * beside)


def test_labels_that_do_not_fit_are_one_line() -> None:
    logits, _, labels = some()
    for wrong, said in (
        (labels[:, :5], r"expected integer \(2, 20, 26\)"),
        (labels.float(), "found torch.float32"),
        (labels + 1, "expected 0 to 2, or 255 where there is none, found"),
    ):
        with pytest.raises(ArrayError, match=said):
            cross_entropy(logits, wrong)
