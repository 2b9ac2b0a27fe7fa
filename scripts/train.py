"""Train a small encoder-decoder on a store: the paper's setups, in plain PyTorch.

    nimprep synth raw --frames 64 && nimprep convert raw data.zarr
    python scripts/train.py data.zarr --setup nim-rgb+d
    python scripts/train.py data.zarr --setup nim-rgb+d --resume       # goes on where it stopped
    python scripts/train.py data.zarr --setup nim-rgb+d --overwrite    # begins anew
    python scripts/train.py data.zarr --setups all                     # a table of its setups
    nimprep evaluate data.zarr runs/nim-rgb+d/predictions/test         # the same scores

An example to start from; the networks of the paper are larger.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, interpolate
from tqdm import tqdm

import nimprep
from nimprep.errors import LayoutError, NimprepError
from nimprep.evaluation import Evaluation
from nimprep.files import check_file, write_whole
from nimprep.folders import PARTIAL, refuse_inside, told
from nimprep.frame import IGNORE_LABEL
from nimprep.metrics import confusion_matrix
from nimprep.text import printable
from nimprep.torch import SETUPS, StoreDataset, StoreLoader
from nimprep.torch.transforms import (
    ColorJitter,
    Compose,
    RandomCrop,
    RandomHorizontalFlip,
    RandomScale,
)

WIDTHS = (16, 32, 64, 96)

CHECKPOINT = "checkpoint.pt"


def block(channels: int, width: int, stride: int = 1) -> nn.Sequential:
    """Return two 3x3 convolutions, the first with this stride."""
    layers: list[nn.Module] = []
    for c, s in ((channels, stride), (width, 1)):
        layers += [nn.Conv2d(c, width, 3, s, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU()]
    return nn.Sequential(*layers)


class Network(nn.Module):
    """An encoder per tensor of the input, their features added up, and one decoder."""

    def __init__(self, channels: Sequence[int], classes: int) -> None:
        super().__init__()
        self.encoders = nn.ModuleList(
            nn.ModuleList(block(a, b, 2) for a, b in zip((c, *WIDTHS), WIDTHS, strict=False))
            for c in channels
        )
        self.decoder = nn.ModuleList(
            block(deep + skip, skip)
            for deep, skip in zip(WIDTHS[:0:-1], WIDTHS[-2::-1], strict=True)
        )
        self.head = nn.Conv2d(WIDTHS[0], classes, 1)

    def forward(self, inputs: Sequence[Tensor]) -> Tensor:
        """Return (B, classes, H, W) scores of (B, C, H, W) images of any size."""
        features: list[Tensor] = []
        for encoder, image in zip(self.encoders, inputs, strict=True):
            x = image
            for level, stage in enumerate(encoder):
                x = stage(x)
                if len(features) == level:
                    features.append(x)
                else:
                    features[level] = x = features[level] + x
        x = features.pop()
        for stage in self.decoder:
            skip = features.pop()
            x = interpolate(x, skip.shape[2:], mode="bilinear", align_corners=False)
            x = stage(torch.cat([x, skip], dim=1))
        size = inputs[0].shape[2:]
        return interpolate(self.head(x), size, mode="bilinear", align_corners=False)


def tensors(batch: dict[str, Any], device: torch.device) -> list[Tensor]:
    """Return a batch's inputs on the device: one tensor, or two that are to be fused."""
    inputs = batch["inputs"] if isinstance(batch["inputs"], tuple) else (batch["inputs"],)
    return [x.to(device, non_blocking=True) for x in inputs]


def dataset(options: argparse.Namespace, split: str, transform: Any = None) -> StoreDataset:
    """Open a split of the store; normals are computed where it has none.

    A label is its class's place, which is the plane that the network has for it, whatever its id.
    """
    store = nimprep.open_store(options.store)
    return StoreDataset(
        options.store,
        split=split,
        setup=options.setup,
        fusion=options.fusion,
        transform=transform,
        normals="cached" if "normal" in store.modalities else "nim",
        classes={c.name: place for place, c in enumerate(store.classes)},
        seed=options.seed,
    )


def train_epoch(
    model: Network, optimizer: torch.optim.Optimizer, loader: StoreLoader, bar: tqdm
) -> float:
    """Train for one epoch and return the mean loss."""
    model.train()
    device = next(model.parameters()).device
    total = 0.0
    for step, batch in enumerate(loader, 1):
        label = batch["label"].to(device, non_blocking=True)
        loss = cross_entropy(model(tensors(batch, device)), label, ignore_index=IGNORE_LABEL)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        total += loss.item()
        bar.set_postfix(bar.scores, loss=f"{total / step:.3f}")
        bar.update()
    return total / len(loader)


@torch.no_grad()
def score(model: Network, data: StoreDataset, split: str, folder: Path | None) -> Evaluation:
    """Score a split at full size, frame by frame; write predictions where a folder is given."""
    model.eval()
    device = next(model.parameters()).device
    frames = {}
    ids = np.array([c.id for c in data.store.classes], np.uint8)
    for batch in StoreLoader(data):
        height, width = batch["size"][0].tolist()
        inside = (..., slice(height), slice(width))  # frames of several sizes are padded
        scores = model([x[inside] for x in tensors(batch, device)])
        guess = scores.argmax(dim=1)[0].byte().cpu().numpy()
        label = batch["label"][0][inside].numpy()
        frames[batch["id"][0]] = confusion_matrix(label, guess, scores.shape[1])
        if folder is not None:
            png = cv2.imencode(".png", ids[guess])[1].tobytes()
            path = folder / f"{batch['id'][0]}.png"
            write_whole(path, png, Path(data.store.path), overwrite=True)
    return Evaluation(data.store.classes, split, frames)


def folder_of(options: argparse.Namespace) -> Path:
    """Return the folder of a run."""
    return options.out / (options.setup + ("-fusion" if options.fusion else ""))


def check_place(options: argparse.Namespace) -> None:
    """Refuse, before anything is trained, a folder that must not be written to, or not unasked."""
    out = folder_of(options)
    check_file(out / CHECKPOINT, options.store, overwrite=True)
    for split in ("val", "test"):
        refuse_inside(out / "predictions" / split / "any", options.store)
    asked = options.overwrite or (options.resume and (out / CHECKPOINT).exists())
    with told(out, LayoutError):
        names = [] if asked or not out.exists() else [path.name for path in out.iterdir()]
    # What a kill left that is not whole is no run.
    if found := min((name for name in names if not name.endswith(PARTIAL)), default=None):
        advice = "--overwrite or another --out" if options.resume else "--resume or --overwrite"
        raise LayoutError(
            f"{out}: expected a new or empty folder for the run, found {found!r} in it; "
            f"give {advice}"
        )


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Train one setup and return the losses by epoch and the scores by split."""
    torch.manual_seed(options.seed)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    transform = Compose(
        [
            RandomScale((0.75, 1.5)),
            RandomCrop(*options.crop),
            RandomHorizontalFlip(),
            ColorJitter(0.3, 0.3, 0.3, 0.05),
        ]
    )
    data = dataset(options, "train", transform)
    evaluated = {split: dataset(options, split) for split in ("val", "test")}
    loader = StoreLoader(data, options.batch, shuffle=True, drop_last=len(data) > options.batch)
    model = Network(data.selection.channels, data.num_classes).to(device)
    optimizer = torch.optim.AdamW(model.parameters(), lr=options.lr)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.epochs)
    state: dict[str, Any] = {"epoch": 0, "losses": []}
    out = folder_of(options)
    parts = {"model": model, "optimizer": optimizer, "schedule": schedule}
    if options.resume and (out / CHECKPOINT).exists():
        state = torch.load(out / CHECKPOINT, map_location=device, weights_only=True)
        for name, part in parts.items():
            part.load_state_dict(state[name])
    if options.overwrite:
        # Cut short before its first epoch ends, this run must not be gone on with as that one.
        (out / CHECKPOINT).unlink(missing_ok=True)
    first = state["epoch"]
    with tqdm(
        total=options.epochs * len(loader), initial=first * len(loader), desc=printable(out.name)
    ) as bar:
        bar.scores = {}
        for epoch in range(first, options.epochs):
            loader.set_epoch(epoch)
            losses = [*state["losses"], train_epoch(model, optimizer, loader, bar)]
            schedule.step()
            mean = score(model, evaluated["val"], "val", None).mean
            bar.scores = {"IoU": f"{mean['iou']:.3f}"}
            state = {"epoch": epoch + 1, "losses": losses}
            state |= {name: part.state_dict() for name, part in parts.items()}
            saved = io.BytesIO()
            torch.save(state, saved)
            write_whole(out / CHECKPOINT, saved.getvalue(), options.store, overwrite=True)
    scores = {
        split: score(model, frames, split, out / "predictions" / split)
        for split, frames in evaluated.items()
    }
    return {"name": out.name, "losses": state["losses"], "scores": scores}


def print_table(results: Sequence[dict[str, Any]]) -> None:
    """Print F-score and IoU per class and their mean without background, a row per run."""
    classes = [printable(c.name) for c in results[0]["scores"]["test"].classes]
    columns = [*classes, "mean"]
    print(f"{'':18}{'':6}" + "".join(f"{name:^20}" for name in columns))
    print(f"{'setup':18}{'split':6}" + f"{'F-score':>10}{'IoU':>8}  " * len(columns))
    for result in results:
        for split, found in result["scores"].items():
            pairs = zip(
                [*found.scores["f_score"], found.mean["f_score"]],
                [*found.scores["iou"], found.mean["iou"]],
                strict=True,
            )
            cells = "".join(f"{f:10.4f}{iou:8.4f}  " for f, iou in pairs)
            print(f"{printable(result['name']):18}{split:6}{cells}")


def main(arguments: Sequence[str] | None = None) -> list[dict[str, Any]]:
    """Train what the command line asks for and print the scores."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("store", type=Path)
    parser.add_argument("--setup", default="nim-rgb+d", help="as StoreDataset takes it")
    parser.add_argument(
        "--setups", choices=["all"], help="all the store serves; with --fusion of two"
    )
    parser.add_argument("--fusion", action="store_true", help="an encoder for each modality")
    parser.add_argument("--out", type=Path, default=Path("runs"))
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--crop", type=int, nargs=2, default=(288, 384), metavar=("H", "W"))
    parser.add_argument("--lr", type=float, default=3e-3)
    parser.add_argument("--seed", type=int, default=0)
    there = parser.add_mutually_exclusive_group()
    there.add_argument("--resume", action="store_true", help="go on from the last checkpoint")
    there.add_argument("--overwrite", action="store_true", help="begin anew where a run is")
    options = parser.parse_args(arguments)
    names = [options.setup]
    if options.setups:
        served = {*nimprep.open_store(options.store).modalities, "normal"}
        names = [name for name, parts in SETUPS.items() if served.issuperset(parts)]
        names = [name for name in names if len(SETUPS[name]) == 2 or not options.fusion]
    runs = [argparse.Namespace(**{**vars(options), "setup": name}) for name in names]
    for one in runs:
        check_place(one)
    results = [run(one) for one in runs]
    print_table(results)
    return results


if __name__ == "__main__":
    try:
        main()
    except NimprepError as error:
        sys.exit(f"error: {printable(str(error))}")
