"""The worst frames as the paper's figures: what each method got right, missed and made up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nimprep.evaluation.comparison import Comparison, Method
from nimprep.evaluation.outcomes import draw_outcomes, find_outcomes, fit_outcomes
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
    label_picture,
    shrink,
)
from nimprep.store.reader import Store

WIDTH = 520
"""Pixels; pictures on the page are about as wide: larger ones shrink, smaller ones grow."""

QUALITY = 80
"""Of the pictures' WebP: less blurs stripes and dots."""


@dataclass(frozen=True)
class Overlay:
    """Hold one picture of the page: one frame, one method, one class.

    Attributes
    ----------
    method, class_name : str
    iou : float or None
        The class's in this frame.
    uri : str
        The picture as a data address: what became of the class's pixels, over the photograph, as
        `nimprep.evaluation.outcomes` draws it.
    """

    method: str
    class_name: str
    iou: float | None
    uri: str


@dataclass(frozen=True)
class DrawnFrame:
    """Hold a frame's pictures.

    Attributes
    ----------
    photograph : str
        As a data address; "" where the store has none.
    label : str
        Its classes in their colours.
    overlays : list of Overlay
        By class that the label or a prediction has, then by method.
    """

    photograph: str
    label: str
    overlays: list[Overlay]


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
) -> dict[str, DrawnFrame]:
    """Return each frame's pictures."""
    numbers = {frame_id: number for number, frame_id in enumerate(store.ids)}
    files = [prediction_files(method.predictions) for method in found.methods]

    def draw(frame_id: str) -> DrawnFrame:
        label = read_label_of(store, numbers[frame_id])
        photograph = _photograph(store, numbers[frame_id])
        shown = np.full((*label.shape, 3), NO_VALUE, np.uint8) if photograph is None else photograph
        shown = _fit(shown)
        guesses = [read_guess(store, label.shape, by_id[frame_id]) for by_id in files]
        drawn = []
        for place, c in enumerate(store.classes):
            called = [guess == c.id for guess in guesses]
            actual, counted = label == c.id, label != IGNORE_LABEL
            there = any((counted & mask).any() for mask in (actual, *called))
            if c.id == BACKGROUND or not there:
                continue
            for method, mask in zip(found.methods, called, strict=True):
                outcomes = find_outcomes(mask, actual, counted)
                picture = draw_outcomes(shown, fit_outcomes(outcomes, *shown.shape[:2]))
                drawn.append(_overlay(method, c.name, place, frame_id, picture))
        truth = _uri(_fit(label_picture(label, store.classes)))
        return DrawnFrame("" if photograph is None else _uri(shown), truth, drawn)

    return dict(zip(ids, map_frames("draw", draw, ids, progress), strict=True))


def _photograph(store: Store, index: int) -> Picture | None:
    if "rgb" not in store.arrays:
        return None
    height, width = store.camera(index).shape
    return np.ascontiguousarray(store.arrays["rgb"].read(index)[:height, :width])


def _fit(image: Picture) -> Picture:
    """Return a picture about as wide as the page shows it; one that grows keeps its pixels."""
    times = max(1, WIDTH // image.shape[1])
    return shrink(image.repeat(times, axis=0).repeat(times, axis=1), WIDTH)


def _overlay(
    method: Method, class_name: str, place: int, frame_id: str, picture: Picture
) -> Overlay:
    iou = or_none(float(method.evaluation.by_frame[frame_id].scores["iou"][place]))
    return Overlay(method.name, class_name, iou, _uri(picture))


def _uri(picture: Picture) -> str:
    return data_uri(encode_picture(picture, "webp", QUALITY), "webp")
