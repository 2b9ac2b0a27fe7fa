"""Several methods side by side: the paper's table of methods and measures."""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any, Literal

from nimprep.evaluation.scores import BACKGROUND, FRACTION, MEASURES, Evaluation

Unit = Literal["percent", "fraction"]
"""What tables show scores in; everywhere else they are fractions, 0 to 1."""

DIGITS: dict[Unit, int] = {"percent": 2, "fraction": 4}
"""Tables show scores to so many decimals; equal at these, two methods are equally good."""

CORNER: dict[Unit, str] = {"percent": "in %", "fraction": ""}
"""What stands in a table's corner, where its unit has to be said."""

UNDEFINED = "–"
"""Stands for a score that is undefined: the precision of a class that was never predicted."""

HEADS = {"f_score": "F-score", "iou": "IoU", "precision": "precision", "recall": "recall"}
"""What tables call the measures."""

MEAN = "mean"
"""What tables call the mean over the classes that are not background."""


@dataclass(frozen=True, eq=False)
class Method:
    """Hold one method's predictions and what they are worth.

    Attributes
    ----------
    name : str
        What tables call it.
    predictions : Path
        The folder they were read from.
    evaluation : Evaluation
    """

    name: str
    predictions: Path
    evaluation: Evaluation


@dataclass(frozen=True)
class Cell:
    """Hold one score of a table: its text, "" where it is undefined, and whether it is best."""

    text: str
    best: bool


@dataclass(frozen=True)
class Table:
    """Hold a table of methods and measures before it is written in any notation.

    Attributes
    ----------
    blocks : tuple of str
        The classes that are not background, and their mean where there are several.
    heads : tuple of str
        The measures, the same in each block.
    unit : {"percent", "fraction"}
        Of the scores.
    rows : tuple of (str, tuple of Cell)
        A method's name and its scores, block by block.
    """

    blocks: tuple[str, ...]
    heads: tuple[str, ...]
    unit: Unit
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Hold several methods' scores on the same frames."""

    methods: tuple[Method, ...]

    @property
    def first(self) -> Evaluation:
        """The first method's; classes, split and frames are the same for all."""
        return self.methods[0].evaluation

    @property
    def foreground(self) -> tuple[int, ...]:
        """Which of the classes are not background, by their place."""
        return tuple(i for i, c in enumerate(self.first.classes) if c.id != BACKGROUND)

    def values(self, place: int | None, measure: str) -> list[float]:
        """Return each method's score of the class at a place, or of the mean (None)."""
        found = (method.evaluation for method in self.methods)
        if place is None:
            return [evaluation.mean[measure] for evaluation in found]
        return [float(evaluation.scores[measure][place]) for evaluation in found]

    def best(self, place: int | None, measure: str) -> list[bool]:
        """Say of each method whether its score is the highest, as far as tables show it.

        All of several equals are; none is where there is one method only, or no score above 0.
        """
        digits = [round(v, DIGITS["fraction"]) for v in self.values(place, measure)]
        highest = max((v for v in digits if not math.isnan(v)), default=0.0)
        return [len(digits) > 1 and highest > 0 and v == highest for v in digits]

    def table(self, measures: Sequence[str] = tuple(MEASURES), unit: Unit = "percent") -> Table:
        """Return methods × measures for each class that is not background, and their mean."""
        places: list[int | None] = [*self.foreground]
        if len(places) != 1:
            places.append(None)
        columns = []
        for place in places:
            for measure in measures:
                texts = [
                    "" if math.isnan(v) else shown(v, unit) for v in self.values(place, measure)
                ]
                best = self.best(place, measure)
                columns.append([Cell(t, b) for t, b in zip(texts, best, strict=True)])
        names = [method.name for method in self.methods]
        return Table(
            blocks=tuple(MEAN if p is None else self.first.classes[p].name for p in places),
            heads=tuple(HEADS[measure] for measure in measures),
            unit=unit,
            rows=tuple(zip(names, zip(*columns, strict=True), strict=True)),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return what `nimprep evaluate --json` prints of several folders."""
        return {
            "unit": FRACTION,
            "split": self.first.split,
            "frames": len(self.first.frames),
            "methods": [
                {
                    "name": method.name,
                    "predictions": str(method.predictions),
                    "evaluation": method.evaluation.to_dict(),
                }
                for method in self.methods
            ],
            "best": {
                "classes": [
                    {"id": self.first.classes[p].id, "name": self.first.classes[p].name}
                    | self._best_names(p)
                    for p in self.foreground
                ],
                "mean": self._best_names(None),
            },
        }

    def _best_names(self, place: int | None) -> dict[str, list[str]]:
        return {
            measure: [
                method.name
                for method, best in zip(self.methods, self.best(place, measure), strict=True)
                if best
            ]
            for measure in MEASURES
        }


def shown(value: float, unit: Unit) -> str:
    """Return a score, 0 to 1 or NaN, as tables show it."""
    if math.isnan(value):
        return UNDEFINED
    # Rounded once, so that both units show the same digits.
    digits = Decimal(f"{value:.{DIGITS['fraction']}f}")
    return f"{digits:f}" if unit == "fraction" else f"{100 * digits:.{DIGITS['percent']}f}"


def method_names(folders: Sequence[Path]) -> list[str]:
    """Name methods by their folders, as briefly as tells them apart.

    One folder: its name. Several: what all paths end in alike is left out (``a/pred`` and
    ``b/pred`` are a and b), then each gets as many of its last folders as no other has.
    """
    parts = [Path(os.path.abspath(folder)).parts for folder in folders]  # noqa: PTH100
    if len(parts) > 1:
        shortest = min(map(len, parts))
        alike = next((n for n in range(shortest) if len({p[-1 - n] for p in parts}) > 1), shortest)
        parts = [p[: len(p) - min(alike, len(p) - 1)] for p in parts]
    return ["/".join(p[-_needed(p, parts) :]).replace("//", "/") for p in parts]


def _needed(own: tuple[str, ...], parts: Sequence[tuple[str, ...]]) -> int:
    """Return how many of a path's last parts no other path ends in."""
    for number in range(1, len(own)):
        if Counter(p[-number:] for p in parts)[own[-number:]] == 1:
            return number
    return len(own)
