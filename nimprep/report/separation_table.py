"""What tells the road from other classes, as data for a page's table, and in lines of text."""

from __future__ import annotations

from typing import Any

from nimprep.report.separation import PIXELS, Row, Score, Separation

_GAIN = 0.01
"""By less one number tells no more than another."""

_SOME = 0.01
"""Where more of the sampled pixels have no value it is said."""


def separation_table(found: Separation) -> dict[str, Any]:
    """Return what the template prints."""
    if found.road is None:
        return {"reason": found.reason, "road": "", "rows": []}
    best = [found.best(column) for column in range(len(found.others))]
    return {
        "reason": "",
        "road": found.road.name,
        "others": [c.name for c in found.others],
        "left_out": found.left_out,
        "frames": found.frames,
        "pixels": PIXELS,
        "advice": advice(found),
        "rows": [
            {
                "name": row.name,
                "stored": row.stored,
                "options": _options(row, "…"),
                "missing": row.missing if row.missing >= _SOME else None,
                "cells": [
                    _cell(score, row is best[column]) for column, score in enumerate(row.scores)
                ],
            }
            for row in found.rows
        ],
    }


def _cell(score: Score | None, best: bool) -> dict[str, Any]:
    if score is None:
        return {"text": "–", "share": 0.0, "best": False, "span": "", "side": ""}
    several = score.frames > 1
    return {
        "text": f"{score.auc:.3f}",
        # From 0.5, which tells nothing, to 1.
        "share": 200 * (score.auc - 0.5),
        "best": best,
        "span": f"{score.low:.2f}–{score.high:.2f}" if several else "",
        "side": "more" if score.higher else "less",
    }


def _options(row: Row, there: str) -> str:
    """Return the options of `convert` that store a row's modality beside those that are there."""
    added = f"--modalities {there},{row.added}" if row.added else ""
    return f"{added} {row.options}".strip()


def advice(found: Separation) -> list[str]:
    """Return a sentence per class: what tells it best, and how to get that if it is not there."""
    return [
        _sentence(found, column, row)
        for column in range(len(found.others))
        if (row := found.best(column)) is not None
    ]


def _sentence(found: Separation, column: int, best: Row) -> str:
    def area(of: Row) -> float:
        score = of.scores[column]
        return 0.5 if score is None else score.auc

    road = "" if found.road is None else found.road.name
    said = f"{road} from {found.others[column].name}: {best.name} tells most, {area(best):.3f}"
    stored = max((row for row in found.rows if row.stored), key=area, default=None)
    if best.stored or stored is None:
        return f"{said}; the store has it."
    if area(best) - area(stored) < _GAIN:
        return f"{said}, and {stored.name}, which the store has, no less: {area(stored):.3f}."
    return (
        f"{said}; of what the store has {stored.name}, {area(stored):.3f}. "
        f"To have it: nimprep convert with {_options(best, ','.join(found.modalities))}"
    )
