"""Scores on a split, over whole frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from nimprep.evaluation.scores import MEASURES, Evaluation, or_none
from nimprep.metrics import confusion_matrix
from nimprep.networks import Network
from nimprep.networks.beside import whole_logits
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.ranks import ranks
from nimprep.training.data import Feed
from nimprep.training.distributed import summed
from nimprep.training.options import TrainOptions
from nimprep.training.precision import Precision


def score_split(
    network: Network,
    feed: Feed,
    data: StoreDataset,
    options: TrainOptions,
    precision: Precision,
    check: Callable[[], None],
) -> Evaluation:
    """Return what a network's predictions for a split are worth, alike in every process.

    Each frame is predicted on its own and at its own size. `check` is called before each: an error
    that it raises ends it.
    """
    count = len(data.store.classes)
    confusion = np.zeros((count, count), np.int64)
    rank, processes = ranks()
    mine = range(rank, len(data), processes)
    loader = StoreLoader(data, 1, num_threads=options.threads, sampler=mine)
    network.eval()
    with torch.inference_mode():
        for batch in loader:
            check()
            height, width = (int(n) for n in batch["size"][0])
            images, depth = feed.images(batch, precision.device)
            own = [image[..., :height, :width] for image in images]
            beside = None if depth is None else depth[..., :height, :width]
            with precision.autocast():
                logits = whole_logits(network, own, feed.selection, data.scaling, beside)
            guess = logits.argmax(dim=1)[0].to("cpu", torch.uint8).numpy()
            label = batch["label"][0, :height, :width].numpy()
            confusion += confusion_matrix(label, guess, count)
    whole = summed(torch.from_numpy(confusion).to(precision.device)).cpu().numpy()
    return Evaluation(data.store.classes, str(data.split), {"": whole})


def figures(found: Evaluation) -> dict[str, Any]:
    """Return scores as the log and checkpoints hold them, 0 to 1: means, and of each class."""
    return {
        **{name: or_none(found.mean[name]) for name in MEASURES},
        "classes": {
            c.name: {name: or_none(found.scores[name][place]) for name in ("f_score", "iou")}
            for place, c in enumerate(found.classes)
        },
    }
