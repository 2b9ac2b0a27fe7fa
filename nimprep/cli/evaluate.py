"""nimprep evaluate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from nimprep.cli.options import json_option, progress_bars, quiet_option


@click.command()
@click.argument("store", type=click.Path(path_type=Path))
@click.argument("predictions", type=click.Path(path_type=Path))
@click.option(
    "--split",
    type=click.Choice(["train", "val", "test"]),
    help="Whose frames are predicted; default: the split that all predictions are of, "
    "or the whole store where they are of several.",
)
@json_option
@quiet_option
def evaluate(store: Path, predictions: Path, split: str | None, as_json: bool, quiet: bool) -> None:
    """Score the folder PREDICTIONS against the labels of STORE.

    A prediction is <frame id>.png (class ids, 8 bits) or <frame id>.npy (scores, (C, H, W)).
    Pixels labelled 255 are left out; the mean is over the classes that are not background (0).
    """
    from nimprep.evaluation import evaluate_predictions

    found = evaluate_predictions(store, predictions, split, progress_bars(quiet))
    document = found.to_dict()
    click.echo(json.dumps(document, indent=2) if as_json else _score_table(document))


def _score_table(document: dict[str, Any]) -> str:
    """Return a row per class and their mean, and below it the confusion matrix."""
    heads = {"F-score": "f_score", "IoU": "iou", "precision": "precision", "recall": "recall"}
    rows = [*document["classes"], {"name": "mean, no background", **document["mean"]}]
    corner = "label \\ prediction"
    wide = max(len(text) for text in (corner, *(row["name"] for row in rows)))
    of = f"split {document['split']}" if document["split"] else "the whole store"
    lines = [f"{document['frames']} frames of {of}, {document['pixels']} pixels counted", ""]
    lines.append(" " * wide + "".join(f"{head:>11}" for head in heads))
    for row in rows:
        values = (row[name] for name in heads.values())
        cells = "".join(f"{'-' if v is None else format(v, '.4f'):>11}" for v in values)
        lines.append(f"{row['name']:<{wide}}{cells}")
    names = [row["name"] for row in document["classes"]]
    lines += ["", f"{corner:<{wide}}" + "".join(f"  {name:>12}" for name in names)]
    for name, counts in zip(names, document["confusion"], strict=True):
        widths = (max(len(other), 12) for other in names)
        numbers = "".join(f"  {n:>{w}}" for n, w in zip(counts, widths, strict=True))
        lines.append(f"{name:<{wide}}{numbers}")
    return "\n".join(lines)
