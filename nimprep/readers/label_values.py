"""Label images of a described dataset, as class ids."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.frame import LabelClass
from nimprep.images import read_label
from nimprep.readers.description import LabelSource
from nimprep.readers.frames import check_label
from nimprep.readers.matching import Place


def label_image(
    place: Place, source: LabelSource, classes: Sequence[LabelClass]
) -> npt.NDArray[np.uint8]:
    """Read a label image as (H, W) uint8 class ids, 255 = ignore.

    Raises
    ------
    DecodeError
        It is damaged, or holds what neither the map nor the classes name.
    """
    raw = read_label(place.path)
    if source.ranges is None and source.colors is None:
        return check_label(raw, classes, place.path)
    return _mapped(raw, source, place.path)


def _mapped(raw: npt.NDArray[Any], source: LabelSource, path: Path) -> npt.NDArray[np.uint8]:
    codes = raw.astype(np.int64)
    if raw.ndim == 3:
        codes = codes @ np.array([1 << 16, 1 << 8, 1])
    values, where = np.unique(codes, return_inverse=True)
    mapped = []
    for value in values.tolist():
        key = (value >> 16, value >> 8 & 255, value & 255) if raw.ndim == 3 else value
        known = _class_of(key, source)
        if known is None:
            raise DecodeError(
                f"{path}: expected labels of the description's map, found {key}; "
                "add it to the map, or a 'default'"
            )
        mapped.append(known)
    return np.array(mapped, dtype=np.uint8)[where].reshape(codes.shape)


def _class_of(key: int | tuple[int, int, int], source: LabelSource) -> int | None:
    if isinstance(key, tuple):
        return (source.colors or {}).get(key, source.default)
    for first, last, known in source.ranges or ():
        if first <= key <= last:
            return known
    return source.default
