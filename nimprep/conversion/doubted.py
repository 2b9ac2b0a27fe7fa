"""What is doubted of the frames of a conversion, and of stores that are joined."""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.conversion.records import FrameFacts
from nimprep.doubts.depth import camera_signs, depth_signs
from nimprep.doubts.judge import NAMED, judge, sentence
from nimprep.doubts.labels import LABEL_KINDS, label_doubts
from nimprep.errors import DoubtWarning
from nimprep.frame import Frame, LabelClass
from nimprep.readers.crop import Margins
from nimprep.splits import SplitName
from nimprep.store.attributes import StoreAttributes
from nimprep.store.frames import MAX_DEPTH_M
from nimprep.store.table_specs import CLASS_PIXELS

Doubts = list[dict[str, Any]]

_ROADS = 64


def shows_road(frame_id: str, frames: int) -> bool:
    """Return whether the road is to be looked for in one of so many frames: some 64 tell of all.

    Which frames these are depends on their ids alone.
    """
    return zlib.crc32(frame_id.encode()) % max(1, frames // _ROADS) == 0


def frame_signs(frame: Frame, margins: Margins | None, *, road: bool = True) -> dict[str, float]:
    """Return the signs of a frame as it was read: the reader's, its depth's and its camera's.

    Parameters
    ----------
    margins : Margins, optional
        What was cut off it; the camera is judged by the whole image.
    road : bool
        Whether to look for the road, and how high the camera is above it.
    """
    camera, signs = frame.camera, dict(frame.signs)
    if frame.depth_m is not None:
        signs |= depth_signs(frame.depth_m, camera, MAX_DEPTH_M, road=road)
    return signs | camera_signs(camera if margins is None else _whole(camera, margins))


def _whole(camera: Camera, margins: Margins) -> Camera:
    return replace(
        camera,
        cx=camera.cx + margins.left,
        cy=camera.cy + margins.top,
        width=camera.width + margins.left + margins.right,
        height=camera.height + margins.top + margins.bottom,
    )


def doubts_of(
    facts: Sequence[FrameFacts],
    classes: Sequence[LabelClass],
    fixed_splits: Mapping[SplitName, Sequence[str]],
    *,
    filled: bool,
) -> Doubts:
    """Return what is doubted of frames that were encoded, as a store's attributes hold it.

    Parameters
    ----------
    classes : sequence of LabelClass
        The labels'; none = there are no labels.
    fixed_splits : mapping of split to ids
        As the attributes hold it: see `doubts_of_labels`.
    filled : bool
        Whether holes in depth are filled.
    """
    frames = [(frame.id, frame.signs) for frame in facts]
    found = [d.to_json() for d in judge(frames, filled=filled, most_m=MAX_DEPTH_M)]
    pixels = np.array([frame.class_pixels for frame in facts])
    return found + doubts_of_labels([i for i, _ in frames], pixels, classes, fixed_splits)


def doubts_of_labels(
    ids: Sequence[str],
    class_pixels: npt.NDArray[np.integer],
    classes: Sequence[LabelClass],
    fixed_splits: Mapping[SplitName, Sequence[str]],
) -> Doubts:
    """Return what is doubted of labels; a test split that its authors chose may have none."""
    withheld = frozenset(fixed_splits.get("test", ()))
    return [d.to_json() for d in label_doubts(ids, class_pixels, classes, withheld)]


def with_doubts_of_labels(
    about: StoreAttributes, tables: Mapping[str, npt.NDArray[Any]], classes: Sequence[LabelClass]
) -> StoreAttributes:
    """Return what is said of joined stores, with what is doubted of all their labels together."""
    ids = [str(i) for i in tables["frame_id"]]
    found = doubts_of_labels(ids, tables[CLASS_PIXELS], classes, about.fixed_splits)
    return replace(about, doubts=[*about.doubts, *found])


def joined_doubts(found: Iterable[StoreAttributes]) -> Doubts:
    """Return what is doubted of stores together, without their labels, which are counted anew.

    Of one kind there is one doubt: it says what it says of the part with most such frames.
    """
    joined: dict[str, dict[str, Any]] = {}
    most: dict[str, int] = {}
    for doubt in (d for about in found for d in about.doubts if d["kind"] not in LABEL_KINDS):
        kind = doubt["kind"]
        before = joined.get(kind, {**doubt, "frames": [], "count": 0})
        text = doubt["text"] if doubt["count"] > most.get(kind, 0) else before["text"]
        most[kind] = max(doubt["count"], most.get(kind, 0))
        frames = [*before["frames"], *doubt["frames"]][:NAMED]
        count = before["count"] + doubt["count"]
        joined[kind] = {**before, "text": text, "frames": frames, "count": count}
    return list(joined.values())


def warn_of_doubts(where: object, doubts: Iterable[Mapping[str, Any]]) -> None:
    """Say each doubt of a data set as a warning."""
    for doubt in doubts:
        warnings.warn(f"{where}: {sentence(doubt)}", DoubtWarning, stacklevel=3)
