"""Scores, confusion, scenes and worst frames as one page of HTML that needs nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nimprep.evaluation.comparison import DIGITS, HEADS, UNDEFINED, Comparison, Method, shown
from nimprep.evaluation.outcomes import STYLES, outcome_sample
from nimprep.evaluation.overlays import DrawnFrame, draw_frames, worst_frames
from nimprep.evaluation.scores import MEASURES, Evaluation
from nimprep.files import write_whole
from nimprep.folders import place_of
from nimprep.parallel import Progress
from nimprep.report.page import render_page
from nimprep.report.pictures import css_color, data_uri, encode_picture
from nimprep.store.reader import Store, open_store
from nimprep.text import printable


def write_page(
    out: Path,
    store: Store | Path | str,
    found: Comparison,
    worst: int = 10,
    progress: Progress | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Write the page.

    Parameters
    ----------
    out : path
    store : Store or path
        That the predictions were scored against.
    found : Comparison
    worst : int
        How many of the worst frames are drawn.
    overwrite : bool
        Replace a file that is there already; without, it is an error.

    Raises
    ------
    NimprepError
        The extra `report` is not installed, a file cannot be read any more, or `out` not
        written.
    """
    store = store if isinstance(store, Store) else open_store(store)
    ids = worst_frames(found)
    drawn = draw_frames(store, found, ids[:worst], progress)
    context = {
        "name": printable(place_of(Path(store.path)).name),
        "dataset": printable(str(store.about.dataset)),
        "split": found.first.split,
        "frames": len(found.first.frames),
        "pixels": int(found.first.confusion.sum()),
        "heads": list(HEADS.values()),
        "digits": DIGITS["percent"],
        "table": _table(found) if len(found.methods) > 1 else None,
        "methods": [_method(method) for method in found.methods],
        "groups": _groups(found),
        "worst": [_worst(found, frame_id, drawn[frame_id]) for frame_id in drawn],
        "legend": _legend(),
        "classes": [
            {"name": printable(c.name), "color": css_color(c.color), "id": c.id}
            for c in store.classes
        ],
        "by_frame": [_row(found, frame_id) for frame_id in ids],
    }
    sources = (Path(store.path), *(method.predictions for method in found.methods))
    data = render_page("evaluation.html.j2", context).encode()
    write_whole(out, data, *sources, overwrite=overwrite)


def _score(value: float) -> str:
    return shown(value, "percent")


def _table(found: Comparison) -> dict[str, Any]:
    table = found.table()
    return {
        "blocks": [printable(block) for block in table.blocks],
        "rows": [(printable(name), cells) for name, cells in table.rows],
    }


def _method(method: Method) -> dict[str, Any]:
    """Return a method's scores by class and its confusion matrix, with each row's shares."""
    evaluation = method.evaluation
    names = [printable(c.name) for c in evaluation.classes]
    scores = [[_score(float(evaluation.scores[m][i])) for m in MEASURES] for i in range(len(names))]
    counts = evaluation.confusion
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    return {
        "name": printable(method.name),
        "predictions": printable(str(method.predictions)),
        "rows": [*zip(names, scores, strict=True), ("mean, no background", _means(evaluation))],
        "classes": names,
        "confusion": [
            (name, list(zip(row.tolist(), part.tolist(), strict=True)))
            for name, row, part in zip(names, counts, shares, strict=True)
        ],
    }


def _means(evaluation: Evaluation) -> list[str]:
    return [_score(evaluation.mean[m]) for m in MEASURES]


def _ious(evaluations: list[Evaluation]) -> list[str]:
    return [_score(evaluation.mean["iou"]) for evaluation in evaluations]


def _groups(found: Comparison) -> list[dict[str, Any]]:
    """Return a row per scene: of one method all measures' means, of several each one's mean IoU."""
    alone = len(found.methods) == 1
    rows = []
    for group, part in found.first.by_group.items():
        parts = [method.evaluation.by_group[group] for method in found.methods]
        rows.append(
            {
                "group": printable(group) or "(no group)",
                "frames": len(part.frames),
                "pixels": int(part.confusion.sum()),
                "scores": _means(part) if alone else _ious(parts),
            }
        )
    return rows


def _row(found: Comparison, frame_id: str) -> dict[str, Any]:
    parts = [method.evaluation.by_frame[frame_id] for method in found.methods]
    return {
        "id": printable(frame_id),
        "group": printable(found.first.groups.get(frame_id, "")),
        "scores": _means(parts[0]) if len(parts) == 1 else _ious(parts),
    }


def _legend() -> list[dict[str, str]]:
    """Return a sample of each outcome and its name."""
    return [
        {"name": style.name, "uri": data_uri(encode_picture(outcome_sample(outcome), "png"), "png")}
        for outcome, style in STYLES.items()
    ]


def _worst(found: Comparison, frame_id: str, drawn: DrawnFrame) -> dict[str, Any]:
    pictures = [
        {
            "method": printable(overlay.method) if len(found.methods) > 1 else "",
            "class_name": printable(overlay.class_name),
            "iou": UNDEFINED if overlay.iou is None else f"{_score(overlay.iou)} %",
            "uri": overlay.uri,
        }
        for overlay in drawn.overlays
    ]
    sources = {"photograph": drawn.photograph, "label": drawn.label}
    return {**_row(found, frame_id), **sources, "pictures": pictures}
