"""What predictions are worth: per class, per group and per frame, from confusion matrices."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from nimprep.frame import LabelClass
from nimprep.metrics import (
    Counts,
    Scores,
    f_score_per_class,
    iou_per_class,
    pixel_accuracy,
    precision_per_class,
    recall_per_class,
)

FRACTION = "fraction"
"""The unit of scores in JSON: 0 to 1."""

BACKGROUND = 0
"""Id of the class that the mean leaves out, as the paper's average does."""

MEASURES: dict[str, Callable[[Counts], Scores]] = {
    "f_score": f_score_per_class,
    "iou": iou_per_class,
    "precision": precision_per_class,
    "recall": recall_per_class,
}
"""The scores of a class, as functions of the confusion matrix."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Hold what predictions are worth.

    Attributes
    ----------
    classes : tuple of LabelClass
        The store's.
    split : str or None
        Whose frames they are; None = the whole store's.
    frames : dict of str to (C, C) int64
        Each frame's confusion matrix by frame id, rows the label, columns the prediction, both in
        the order of `classes`. Pixels labelled 255 are left out.
    groups : mapping of str to str
        Each frame's scene, by frame id; a frame that is not named has none ("").
    """

    classes: tuple[LabelClass, ...]
    split: str | None
    frames: dict[str, Counts]
    groups: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def confusion(self) -> Counts:
        """(C, C) int64 of all frames together."""
        number = len(self.classes)
        return sum(self.frames.values(), np.zeros((number, number), np.int64))

    @cached_property
    def scores(self) -> dict[str, Scores]:
        """(C,) float64 per measure, 0 to 1; NaN where it is undefined."""
        return {name: measure(self.confusion) for name, measure in MEASURES.items()}

    @cached_property
    def mean(self) -> dict[str, float]:
        """Each measure's mean over the classes that are not background.

        A class that neither labels nor predictions have is left out. NaN where no class is left,
        or where one of them has no such score: no precision, as nothing was predicted to be of it,
        or no recall, as nothing is.
        """
        confusion = self.confusion
        seen = (confusion.sum(axis=0) + confusion.sum(axis=1)) > 0
        counted = seen & np.array([c.id != BACKGROUND for c in self.classes], dtype=bool)
        if not counted.any():
            return dict.fromkeys(MEASURES, math.nan)
        return {name: float(values[counted].mean()) for name, values in self.scores.items()}

    @cached_property
    def by_group(self) -> dict[str, Evaluation]:
        """The frames of each scene on their own, in the scenes' order; empty where there are none.

        Frames of no scene stand under "" where others have one.
        """
        members: dict[str, list[str]] = {}
        for frame_id in self.frames:
            members.setdefault(self.groups.get(frame_id, ""), []).append(frame_id)
        if set(members) <= {""}:
            return {}
        return {group: self._part(members[group]) for group in sorted(members)}

    @cached_property
    def by_frame(self) -> dict[str, Evaluation]:
        """Each frame on its own, the worst first: by mean IoU, then by id.

        A frame with no class but background in label and prediction has no mean, and comes last.
        """
        parts = {frame_id: self._part([frame_id]) for frame_id in self.frames}

        def worth(frame_id: str) -> tuple[bool, float, str]:
            iou = parts[frame_id].mean["iou"]
            return math.isnan(iou), 0.0 if math.isnan(iou) else iou, frame_id

        return {frame_id: parts[frame_id] for frame_id in sorted(parts, key=worth)}

    def _part(self, ids: Iterable[str]) -> Evaluation:
        return Evaluation(self.classes, self.split, {i: self.frames[i] for i in ids}, self.groups)

    def to_dict(self) -> dict[str, Any]:
        """Return what `nimprep evaluate --json` prints (schemas/evaluation.schema.json)."""
        return {
            "unit": FRACTION,
            "split": self.split,
            **self._summary(),
            "accuracy": or_none(pixel_accuracy(self.confusion)),
            "confusion": self.confusion.tolist(),
            "groups": [
                {"group": group, **part._summary()} for group, part in self.by_group.items()
            ],
            "by_frame": [
                {
                    "id": frame_id,
                    "group": self.groups.get(frame_id, ""),
                    "pixels": int(part.confusion.sum()),
                    "mean": {name: or_none(value) for name, value in part.mean.items()},
                    "iou": [or_none(value) for value in part.scores["iou"]],
                }
                for frame_id, part in self.by_frame.items()
            ],
        }

    def _summary(self) -> dict[str, Any]:
        """Return what is said of all frames and of a group's alike."""
        return {
            "frames": len(self.frames),
            "pixels": int(self.confusion.sum()),
            "classes": [
                {
                    "id": c.id,
                    "name": c.name,
                    "pixels": int(self.confusion[i].sum()),
                    **{name: or_none(values[i]) for name, values in self.scores.items()},
                }
                for i, c in enumerate(self.classes)
            ],
            "mean": {name: or_none(value) for name, value in self.mean.items()},
        }


def or_none(value: float) -> float | None:
    """Return a score as JSON can hold it: None in place of NaN."""
    return None if math.isnan(value) else float(value)
