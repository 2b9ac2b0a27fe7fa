"""Further images of a described dataset: thermal, confidence and the like, in their units."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError, DecodeError
from nimprep.images import read_plane
from nimprep.modality import Modality
from nimprep.plane import plane_from, to_plane
from nimprep.readers.description import ExtraSource
from nimprep.readers.matching import Place


def extra_record(name: str, source: ExtraSource) -> Modality:
    """Return all that is known of a described plane.

    Raises
    ------
    ArrayError
        It describes none that there can be.
    """
    return plane_from(name, vars(source))


def extra_image(place: Place, name: str, source: ExtraSource) -> npt.NDArray[Any]:
    """Read a further image.

    Returns
    -------
    (H, W) float32, in the plane's unit; NaN = none
        Or uint8, where bytes are the numbers themselves.

    Raises
    ------
    DecodeError
        It is damaged, has several channels of which none is named, or holds values that the
        store's integers cannot say.
    """
    plane = extra_record(name, source)
    raw = _one_channel(read_plane(place.path, source.layout, place.index), place)
    own = source.source_scale is None and source.source_offset is None
    if plane.is_plain and own and raw.dtype == np.uint8:
        return raw
    if own and raw.dtype.kind == "f":
        _refuse_fractions(raw, place)
    scale = plane.scale if source.source_scale is None else source.source_scale
    offset = plane.offset if source.source_offset is None else source.source_offset
    if own:
        # Of the file's numbers, as they are the stored ones.
        none = raw == source.fill if source.fill is not None else np.zeros(raw.shape, np.bool_)
    else:
        none = np.zeros(raw.shape, np.bool_)
    numbers = raw.astype(np.float64) * scale + offset
    numbers[none] = np.nan
    try:
        # Here, where the file is known.
        to_plane(plane, numbers)
    except ArrayError as error:
        raise DecodeError(f"{place.path}: {error}") from error
    if plane.is_plain:
        return np.rint(numbers).astype(np.uint8)
    return numbers.astype(np.float32)


def _refuse_fractions(raw: npt.NDArray[Any], place: Place) -> None:
    """Raise `DecodeError` where what is to be stored integers has fractions: it is values."""
    finite = raw[np.isfinite(raw)]
    wrong = finite[finite != np.rint(finite)]
    if wrong.size:
        raise DecodeError(
            f"{place.path}: expected whole numbers, those to be stored, found {wrong[0]:g}; say "
            'what the file\'s numbers are, "source_scale": 1 where they are the values'
        )


def _one_channel(image: npt.NDArray[Any], place: Place) -> npt.NDArray[Any]:
    """Return an image's only channel; several that are equal count as one."""
    if image.dtype.kind not in "uif":
        raise DecodeError(
            f"{place.path}: expected numbers, found {image.dtype}; save it as numbers of 8 or 16 "
            "bits, or as floats"
        )
    if image.ndim == 2:
        return image
    first = image[:, :, 0]
    if all(np.array_equal(first, image[:, :, c]) for c in range(1, min(image.shape[2], 3))):
        return first
    raise DecodeError(
        f"{place.path}: expected one number per pixel, found {image.shape[2]} channels; name the "
        'one that counts in the description, "channel": "A"'
    )
