"""Further images of a described dataset: thermal, confidence and the like."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from nimprep.errors import LayoutError
from nimprep.readers.description import ExtraSource
from nimprep.readers.matching import Place


def extra_image(place: Place, source: ExtraSource) -> npt.NDArray[Any]:
    """Read a further image.

    Raises
    ------
    DecodeError
        It is damaged, or holds values that the store's integers cannot say.
    """
    raise LayoutError(
        f"{place.path}: expected rgb, depth and labels, found a further plane; leave it out"
    )
