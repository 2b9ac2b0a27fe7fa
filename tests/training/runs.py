"""A run without its training: a network of random weights, described as `train` does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from nimprep.networks import Network, build_network, read_checkpoint, save_checkpoint
from nimprep.networks.network import SMALLEST
from nimprep.store.reader import open_store
from nimprep.torch import StoreDataset, collate
from nimprep.training import TrainOptions
from nimprep.training.data import Feed, frame_size
from nimprep.training.loop import described
from nimprep.training.recipes import completed
from tests.training.stores import SMALL


def make_run(
    store: Path, out: Path, network: Any, setup: str | tuple[str, ...], **options: Any
) -> Path:
    """Write best.pt of a network that nobody trained; its labels differ from pixel to pixel."""
    opened = open_store(store)
    given = TrainOptions(network=network, setup=setup, **{**SMALL, "width": 0.06, **options})
    full = completed(given, frame_size(opened))
    feed = Feed(opened, full)
    torch.manual_seed(1)
    net = build_network(network, feed.channels, feed.classes, full.width)
    feed.fit(net)
    with torch.no_grad():
        for part in net.modules():
            if isinstance(part, nn.BatchNorm2d):
                part.running_mean.uniform_(-0.2, 0.2)
                part.running_var.uniform_(0.3, 1.0)
    data = feed.open("train")
    if min(frame_size(opened)) >= SMALLEST:
        _balance(net.eval(), feed, data)
    out.mkdir(parents=True, exist_ok=True)
    found = described(feed, full, data, wants_depth=net.wants_depth)
    checkpoint = replace(found, state=net.state_dict())
    save_checkpoint(checkpoint, out / "best.pt")
    return out


def _balance(net: Network, feed: Feed, data: StoreDataset) -> None:
    """Let no class be likelier than the others over a frame, where the network ends in a bias."""
    biases = [p for n, p in net.named_parameters() if n.endswith("bias") and len(p) == net.classes]
    with torch.no_grad():
        fed = feed.fed(collate([data[0]]), data, net, torch.device("cpu"))
        logits = net(*fed.images).movedim(1, 0).flatten(1)
        if biases:
            biases[-1] -= logits.median(dim=1).values


def change_run(run: Path, **fields: Any) -> None:
    """Write a run's checkpoint again with other fields."""
    save_checkpoint(replace(read_checkpoint(run), **fields), run / "best.pt")
