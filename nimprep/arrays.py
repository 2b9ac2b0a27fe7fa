"""Arrays as callers have them: masks, and which numbers are a depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError

LEAST_DEPTH_M = 1e-4
"""Smaller depths, metres, are none: no sensor sees them, and one over them drowns all others."""


def unmasked(values: Any, none: Any) -> npt.NDArray[Any]:
    """Return values as an array, `none` where a masked array has its mask.

    ``np.asarray`` alone would return what lies under the mask as if it were meant.
    """
    if isinstance(values, np.ma.MaskedArray):
        values = values.filled(none)
    return np.asarray(values)


def floats(values: Any, name: str) -> npt.NDArray[np.float64]:
    """Return a few numbers as float64, NaN where they are masked.

    Raises
    ------
    ArrayError
        They are no numbers, or rows of different length.
    """
    try:
        if isinstance(values, np.ma.MaskedArray):
            values = np.ma.filled(values.astype(np.float64), np.nan)
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArrayError(f"{name}: expected numbers, found {values!r:.60}") from error


def without_mask(values: Any, name: str) -> npt.NDArray[Any]:
    """Return values as an array where there is nothing that a masked pixel could be read as.

    Raises
    ------
    ArrayError
        Something is masked.
    """
    masked = int(np.sum(np.ma.getmask(values)))
    if masked:
        raise ArrayError(f"{name}: expected values everywhere, found {masked} masked; fill them")
    return np.asarray(values)
