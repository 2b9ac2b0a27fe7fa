"""What some label images tell before an hour of conversion is spent on them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import IGNORE_LABEL
from nimprep.readers.description import Description
from nimprep.readers.label_values import is_jpeg, label_image
from nimprep.readers.matching import Place

PROBED = 32
"""So many label images, spread over the dataset, must all be masks before it is refused."""

_JPEG_NOTE = (
    "labels are JPEG, which changes values at the edges of areas; "
    "use their PNG originals where there are any"
)


def label_notes(
    root: Path, labels: Mapping[str, Place], description: Description
) -> tuple[str, ...]:
    """Return what is to be said of a dataset's labels, from a look at some.

    Mostly one image is decoded: the first that has a class besides 0 ends the search for masks.

    Raises
    ------
    LayoutError
        They are masks of 0 and 255 alone, where 255 would mean ignore and no map says so.
    """
    places = [labels[i] for i in sorted(labels)]
    some = places[:: max(1, -(-len(places) // PROBED))]
    source = description.label
    if source is None or not some:
        return ()
    meant = source.ranges is not None or source.colors is not None or source.named
    if not meant and source.default is None:
        _refuse_masks(root, some, description)
    try:
        return (_JPEG_NOTE,) if is_jpeg(some[0].path) else ()
    except DecodeError:
        return ()


def _refuse_masks(root: Path, some: list[Place], description: Description) -> None:
    others = [c.id for c in description.classes if c.id not in (0, IGNORE_LABEL)]
    both = 0
    for place in some:
        found = _values(place, description)
        if found is None or not found <= {0, IGNORE_LABEL}:
            return
        both += found == {0, IGNORE_LABEL}
    # Frames without labels are 255 throughout, and road may be in few: some must have both.
    if not both or not others:
        return
    raise LayoutError(
        f"{root}: expected class ids as labels, found only 0 and 255 in all of {len(some)} looked "
        f"at, as in {some[0].path.name}, and 255 means ignore; map them, --label-map "
        f'0:0,255:{others[0]} or "map": {{"0": 0, "255": {others[0]}}} under label in the '
        "description (255:255 if ignore is meant)"
    )


def _values(place: Place, description: Description) -> set[int] | None:
    """Return the class ids in a label image; None = it is bad, which is told when it is read."""
    if description.label is None:
        return None
    try:
        label = label_image(place, description.label, description.classes)
    except DecodeError:
        return None
    return set(np.flatnonzero(np.bincount(label.ravel(), minlength=256)).tolist())
