"""What is to be said of EXIF orientations that a frame's images were turned by."""

from __future__ import annotations

from collections.abc import Mapping

from nimprep.images import read_orientation
from nimprep.readers.description import Description
from nimprep.readers.matching import Place


def orientation_signs(places: Mapping[str, Place], description: Description) -> dict[str, float]:
    """Return the first orientation other than 1 by which one of a frame's files is turned.

    A sign as of `nimprep.doubts.judge`; none where none is turned.
    """
    sources = dict(description.sources())
    for name, place in places.items():
        source = sources.get(name)
        if source is None or source.orientation != "apply" or source.raw is not None:
            continue
        if (found := read_orientation(place.path)) != 1:
            return {"exif_orientation": float(found)}
    return {}
