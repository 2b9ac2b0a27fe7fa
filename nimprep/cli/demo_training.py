"""The part of `nimprep demo --train`: a network trained, its predictions, what they are worth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nimprep.cli.echo import echo
from nimprep.cli.options import progress_bars
from nimprep.cli.training_watcher import watcher_for
from nimprep.text import printable

FRAMES, SIZE = 60, (144, 192)
"""What is learned from: enough for a network to tell the road, few enough for two cores."""

OPTIONS: dict[str, Any] = {
    "network": "mfnet",
    "setup": "nim-rgb+d",
    "epochs": 12,
    "batch": 4,
    "lr": 0.05,
    "clip": 1.0,
    "width": 0.25,
    "crop": "none",
    "metric": "iou",
}
"""A quarter of MFNet's channels, for two cores; what is not said is its authors' recipe."""


def check_extra() -> None:
    """Raise `NimprepError`, which names the extra, where PyTorch is not there."""
    import nimprep.torch  # noqa: F401


def train_demo(store: Path, out: Path, quiet: bool) -> None:
    """Train on a store, predict its test frames and score them; leave all of it in a folder."""
    from nimprep.evaluation import compare_predictions
    from nimprep.evaluation.text import evaluation_text
    from nimprep.files import write_whole
    from nimprep.training import predict, train

    run, predictions, scores = out / "run", out / "predictions", out / "evaluation.json"
    said = " ".join(f"--{name} {value}" for name, value in OPTIONS.items())
    _step(f"nimprep train {store} {said} --out {run}")
    train(store, run, watcher=watcher_for(quiet), **OPTIONS)
    progress = progress_bars(quiet)
    _step(f"nimprep predict {store} {run} --out {predictions} --save-scores")
    done = predict(store, run, predictions, progress=progress, save_scores=True)
    echo(f"{printable(str(done.folder))}: {len(done.ids)} frames")
    _step(f"nimprep evaluate {store} {predictions}")
    found = compare_predictions(store, [predictions], progress=progress)
    write_whole(scores, (json.dumps(found.first.to_dict(), indent=2) + "\n").encode())
    metrics = ("f_score", "iou", "precision", "recall")
    echo(evaluation_text(found.first, metrics, 3, "percent"), lines=True, bold=True)
    names = {"store": store, "run": run, "predictions": predictions, "scores": scores}
    echo(_NEXT.format(**{n: printable(str(p)) for n, p in names.items()}), lines=True)


def _step(command: str) -> None:
    echo(f"$ {printable(command)}")


_NEXT = """
What was made
  {run}: the network; {predictions}: labels, and scores; {scores}: the table above

What to do next
  overlays:          nimprep evaluate {store} {predictions} --html page.html
  on a robot:        from nimprep.networks import load_run
                     labels = load_run("{run}").predict(rgb, depth_m, camera)
  without PyTorch:   nimprep export {run} network.onnx --onnx
  another network:   nimprep train {store} --network rtfnet18 --setup nim-rgb+d --out run-2
  your own data:     nimprep convert FOLDER out.zarr   (nimprep convert --help)
"""
