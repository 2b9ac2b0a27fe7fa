"""Colour images of a described dataset, as (H, W, 3) uint8."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from nimprep.images import read_rgb
from nimprep.readers.description import ColorSource
from nimprep.readers.matching import Place


def color_image(place: Place, source: ColorSource) -> npt.NDArray[np.uint8]:
    """Read a colour image as (H, W, 3) uint8, channels R, G, B.

    Raises
    ------
    DecodeError
        It is damaged, or has more than 8 bits and the description does not say their range.
    """
    return read_rgb(place.path)
