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
from nimprep.derive.recipe import Recipe
from nimprep.doubts.depth import camera_signs, depth_signs
from nimprep.doubts.findings import find
from nimprep.doubts.gravity import GRAVITY_KINDS, gravity_doubts
from nimprep.doubts.judge import NAMED, judge, sentence
from nimprep.doubts.labels import LABEL_KINDS, label_doubts
from nimprep.doubts.surfaces import LEAST_IMAGE, level_signs, normal_signs
from nimprep.errors import DepthLossWarning, DoubtWarning, FindingWarning
from nimprep.frame import Frame, LabelClass
from nimprep.modality import MODALITIES
from nimprep.readers.crop import Margins
from nimprep.splits import SplitName
from nimprep.store.attributes import StoreAttributes
from nimprep.store.depth_loss import loss_text
from nimprep.store.table_specs import CLASS_PIXELS

_ANEW = LABEL_KINDS | GRAVITY_KINDS

Doubts = list[dict[str, Any]]

_ROADS = 64
_MOST_M = MODALITIES["depth"].most


def shows_road(frame_id: str, frames: int) -> bool:
    """Return whether the road is to be looked for in one of so many frames: some 64 tell of all.

    Which frames these are depends on their ids alone.
    """
    return zlib.crc32(frame_id.encode()) % max(1, frames // _ROADS) == 0


def frame_signs(
    frame: Frame, margins: Margins | None, *, road: bool = True, most_m: float = _MOST_M
) -> dict[str, float]:
    """Return the signs of a frame as it was read: the reader's, its depth's and its camera's.

    Parameters
    ----------
    margins : Margins, optional
        What was cut off it; the camera is judged by the whole image.
    road : bool
        Whether to look for the road, and how high the camera is above it.
    most_m : float
        The farthest depth that the store can hold, metres; what is farther is a sign.
    """
    camera, signs = frame.camera, dict(frame.signs)
    if frame.depth_m is not None:
        signs |= depth_signs(frame.depth_m, camera, most_m, road=road)
    return signs | camera_signs(camera if margins is None else _whole(camera, margins))


def derived_signs(
    frame: Frame,
    stored: Mapping[str, npt.NDArray[Any]],
    made: dict[str, float],
    recipe: Recipe,
    *,
    road: bool,
) -> dict[str, float]:
    """Return the signs of what was made of a frame's depth; none of a small image.

    Parameters
    ----------
    frame : Frame
        With depth as images were made of it.
    stored : mapping of modality to array
        As the store holds them.
    made : dict of str to float
        The signs that their makers give.
    road : bool
        Whether to measure the noise in normals, if there are any.
    """
    if frame.depth_m is None or frame.depth_m.size < LEAST_IMAGE:
        return {}
    signs = made | level_signs(stored)
    known = (MODALITIES[name] for name in stored if name in MODALITIES)
    if road and any(m.values == "vectors" for m in known):
        smoothed = recipe.normals != "nim"
        signs |= normal_signs(frame.depth_m, frame.camera, smoothed=smoothed)
    return signs


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
    most_m: float = _MOST_M,
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
    most_m : float
        The farthest depth that the store can hold, metres.
    """
    frames = [(frame.id, frame.signs) for frame in facts]
    found = [d.to_json() for d in judge(frames, filled=filled, most_m=most_m)]
    pixels = np.array([frame.class_pixels for frame in facts])
    found += doubts_of_gravity(
        [i for i, _ in frames],
        [frame.group for frame in facts],
        np.array([frame.gravity for frame in facts]),
        np.array([frame.gravity_from == "given" for frame in facts]),
    )
    return found + doubts_of_labels([i for i, _ in frames], pixels, classes, fixed_splits)


def findings_of(facts: Sequence[FrameFacts]) -> Doubts:
    """Return what is found in frames that were encoded, as a store's attributes hold it."""
    return [f.to_json() for f in find((frame.id, frame.signs) for frame in facts)]


def doubts_of_labels(
    ids: Sequence[str],
    class_pixels: npt.NDArray[np.integer],
    classes: Sequence[LabelClass],
    fixed_splits: Mapping[SplitName, Sequence[str]],
) -> Doubts:
    """Return what is doubted of labels; a test split that its authors chose may have none."""
    withheld = frozenset(fixed_splits.get("test", ()))
    return [d.to_json() for d in label_doubts(ids, class_pixels, classes, withheld)]


def doubts_of_gravity(
    ids: Sequence[str],
    groups: Sequence[str],
    gravity: npt.NDArray[np.float64],
    given: npt.NDArray[np.bool_],
) -> Doubts:
    """Return what is doubted of directions of gravity, as a store's attributes hold it."""
    return [d.to_json() for d in gravity_doubts(ids, groups, gravity, given)]


def with_doubts_of_all(
    about: StoreAttributes, tables: Mapping[str, npt.NDArray[Any]], classes: Sequence[LabelClass]
) -> StoreAttributes:
    """Return what is said of joined stores, with what is doubted of all frames together.

    That is of their labels, and of the directions of gravity within a recording.
    """
    ids, groups = ([str(text) for text in tables[name]] for name in ("frame_id", "group"))
    given = np.array([about.gravity_from(n) == "given" for n in range(len(ids))])
    found = doubts_of_gravity(ids, groups, tables["gravity"], given)
    found += doubts_of_labels(ids, tables[CLASS_PIXELS], classes, about.fixed_splits)
    return replace(about, doubts=[*about.doubts, *found])


def joined_doubts(found: Iterable[Doubts]) -> Doubts:
    """Return what is doubted of stores together, or found in them.

    That is without doubts of labels and of gravity, which are looked at anew. Of one kind there is
    one: it says what it says of the part with most such frames.
    """
    joined: dict[str, dict[str, Any]] = {}
    most: dict[str, int] = {}
    for doubt in (d for doubts in found for d in doubts if d["kind"] not in _ANEW):
        kind = doubt["kind"]
        before = joined.get(kind, {**doubt, "frames": [], "count": 0})
        text = doubt["text"] if doubt["count"] > most.get(kind, 0) else before["text"]
        most[kind] = max(doubt["count"], most.get(kind, 0))
        frames = [*before["frames"], *doubt["frames"]][:NAMED]
        count = before["count"] + doubt["count"]
        joined[kind] = {**before, "text": text, "frames": frames, "count": count}
    return list(joined.values())


def warn_of_doubts(
    where: object, about: StoreAttributes, known: StoreAttributes | None = None
) -> None:
    """Say each doubt of a data set and each finding as a warning.

    Parameters
    ----------
    about : StoreAttributes
        What has them.
    known : StoreAttributes, optional
        What it was before: what stood there already is not said again.
    """
    kinds = (
        (about.doubts, [] if known is None else known.doubts, DoubtWarning),
        (about.findings, [] if known is None else known.findings, FindingWarning),
    )
    for found, before, category in kinds:
        for doubt in (d for d in found if d not in before):
            warnings.warn(f"{where}: {sentence(doubt)}", category, stacklevel=3)


def warn_of_loss(where: object, about: StoreAttributes) -> None:
    """Say as a warning how much depth a store has not that its source had."""
    if about.depth_lost is not None:
        said = f"{where}: {loss_text(about.depth_lost)}"
        warnings.warn(said, DepthLossWarning, stacklevel=3)
