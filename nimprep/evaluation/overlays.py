"""The worst frames as the paper's figures: what each method got right, missed and made up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nimprep.evaluation.comparison import Comparison, Method
from nimprep.evaluation.predictions import prediction_files
from nimprep.evaluation.run import read_guess, read_label_of
from nimprep.evaluation.scores import BACKGROUND, or_none
from nimprep.frame import IGNORE_LABEL
from nimprep.parallel import Progress, map_frames
from nimprep.report.pictures import (
    NO_VALUE,
    Picture,
    data_uri,
    encode_picture,
    outcome_picture,
    shrink,
)
from nimprep.store.reader import Store

WIDTH = 520
"""Pixels; pictures on the page are at most this wide."""


@dataclass(frozen=True)
class Overlay:
    """Hold one picture of the page: one frame, one method, one class.

    Attributes
    ----------
    method, class_name : str
    iou : float or None
        The class's in this frame.
    uri : str
        The picture as a data address: true positives green, false negatives red, false positives
        blue, over the photograph.
    """

    method: str
    class_name: str
    iou: float | None
    uri: str


def worst_frames(found: Comparison) -> list[str]:
    """Return the frames' ids, the worst first: by mean IoU, averaged over the methods, then by id.

    Where a method's mean is undefined, the others' count; where all are, the frame comes last.
    """

    def worth(frame_id: str) -> tuple[bool, float, str]:
        ious = [m.evaluation.by_frame[frame_id].mean["iou"] for m in found.methods]
        defined = [iou for iou in ious if iou == iou]
        return not defined, float(np.mean(defined)) if defined else 0.0, frame_id

    return sorted(found.first.frames, key=worth)


def draw_frames(
    store: Store, found: Comparison, ids: Sequence[str], progress: Progress | None
) -> dict[str, list[Overlay]]:
    """Return each frame's pictures: by class that the label or a prediction has, then by method."""
    numbers = {frame_id: number for number, frame_id in enumerate(store.ids)}
    files = [prediction_files(method.predictions) for method in found.methods]

    def draw(frame_id: str) -> list[Overlay]:
        number = numbers[frame_id]
        label = read_label_of(store, number)
        guesses = [read_guess(store, label.shape, by_id[frame_id]) for by_id in files]
        rgb, counted = _photograph(store, number), label != IGNORE_LABEL
        drawn = []
        for place, c in enumerate(store.classes):
            called = [guess == c.id for guess in guesses]
            actual = label == c.id
            there = any((counted & mask).any() for mask in (actual, *called))
            if c.id == BACKGROUND or not there:
                continue
            for method, mask in zip(found.methods, called, strict=True):
                picture = outcome_picture(rgb, mask, actual, counted)
                drawn.append(_overlay(method, c.name, place, frame_id, picture))
        return drawn

    return dict(zip(ids, map_frames("draw", draw, ids, progress), strict=True))


def _photograph(store: Store, index: int) -> Picture:
    height, width = store.camera(index).shape
    if "rgb" not in store.arrays:
        return np.full((height, width, 3), NO_VALUE, np.uint8)
    return np.ascontiguousarray(store.arrays["rgb"].read(index)[:height, :width])


def _overlay(
    method: Method, class_name: str, place: int, frame_id: str, picture: Picture
) -> Overlay:
    iou = or_none(float(method.evaluation.by_frame[frame_id].scores["iou"][place]))
    data = encode_picture(shrink(picture, WIDTH), "webp")
    return Overlay(method.name, class_name, iou, data_uri(data, "webp"))
