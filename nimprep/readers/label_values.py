"""Label images of a described dataset, as class ids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_start
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.images import read_plane
from nimprep.images.jpeg import SIGNATURE as JPEG
from nimprep.images.layout import PLAIN
from nimprep.images.palette import read_palette_index
from nimprep.readers.description import LabelSource
from nimprep.readers.label_map import MOST_VALUE, color_table, value_table
from nimprep.readers.matching import Place

_SHOWN = 8
"""So many values or colours are named in a message."""


def label_image(
    place: Place, source: LabelSource, classes: Sequence[LabelClass]
) -> npt.NDArray[np.uint8]:
    """Read a label image as (H, W) uint8 class ids, 255 = ignore.

    Of an image with a palette the index counts, unless the map names colours. A colour image whose
    channels are equal is a grey one; otherwise the map says what its colours mean. Alpha is passed
    over.

    Raises
    ------
    DecodeError
        It is damaged, or holds what neither the map nor the classes name.
    """
    raw = _raw(place, source)
    if raw.ndim == 2:
        return label_of_values(raw, source, classes, place.path)
    if source.colors is None:
        grey = raw[:, :, 0]
        if raw.shape[2] < 3 or not all(np.array_equal(grey, raw[:, :, c]) for c in (1, 2)):
            raise _colored(raw, place.path, mapped=source.ranges is not None)
        return label_of_values(grey, source, classes, place.path)
    return _of_colors(raw, source, place.path)


def _raw(place: Place, source: LabelSource) -> npt.NDArray[Any]:
    """Return what the file holds: (H, W), or (H, W, C) R, G, B, A."""
    layout = source.layout
    if replace(layout, orientation="apply") == PLAIN and not (source.colors and not source.ranges):
        index = read_palette_index(place.path, layout.orientation)
        if index is not None and source.colors is None:
            return index
        if index is not None:
            raise DecodeError(
                f"{place.path}: expected a map of either colours or values for an image with a "
                "palette, found one of both; name colours alone, or values alone for its indices"
            )
    return read_plane(place.path, layout, place.index)


def is_jpeg(path: Path) -> bool:
    """Tell whether a file is a JPEG, whatever its name is."""
    return read_start(path, len(JPEG)) == JPEG


def label_of_values(
    raw: npt.NDArray[Any], source: LabelSource, classes: Sequence[LabelClass], path: Path
) -> npt.NDArray[np.uint8]:
    """Return the class ids, (H, W) uint8, of a label's raw values, (H, W) integers.

    Raises
    ------
    DecodeError
        It holds what neither the map nor the classes name.
    """
    if raw.dtype.kind not in "ui":
        raise DecodeError(
            f"{path}: expected whole numbers as labels, found {raw.dtype}; save them as integers"
        )
    table = value_table(source, classes)
    if raw.dtype not in (np.uint8, np.uint16):
        # What no map can name is what the last value is that this one does not.
        outside = (raw < 0) | (raw > MOST_VALUE)
        found = table.take(np.where(outside, 0, raw))
        found[outside] = 0 if source.default is None else source.default + 1
    else:
        found = table.take(raw)
    if not found.all():
        values = [str(v) for v in np.unique(raw[found == 0]).tolist()]
        raise _unknown(values, source, classes, path)
    return (found - np.uint16(1)).astype(np.uint8)


def _of_colors(raw: npt.NDArray[Any], source: LabelSource, path: Path) -> npt.NDArray[np.uint8]:
    if raw.dtype != np.uint8 or raw.shape[2] < 3:
        raise DecodeError(
            f"{path}: expected colours of 8 bits, which the map names, found {raw.shape[2]} "
            f"channels of {raw.dtype}; "
            "name one channel in 'channel', and its values in the map"
        )
    codes = _codes(raw)
    found = color_table(source).take(codes)
    if source.default is not None:
        found[found == 0] = source.default + 1
    elif not found.all():
        raise _unknown(_hex(np.unique(codes[found == 0])), source, (), path)
    return (found - np.uint16(1)).astype(np.uint8)


def _codes(raw: npt.NDArray[Any]) -> npt.NDArray[np.int32]:
    """Return colours as 0xRRGGBB."""
    codes = raw[:, :, 0].astype(np.int32)
    for channel in (1, 2):
        codes <<= 8
        codes |= raw[:, :, channel]
    return codes


def _hex(codes: npt.NDArray[np.int32]) -> list[str]:
    return [f"#{code:06x}" for code in codes.tolist()]


def _unknown(
    values: Sequence[str], source: LabelSource, classes: Sequence[LabelClass], path: Path
) -> DecodeError:
    """Return the error for values or colours that nothing names."""
    mapped = source.ranges is not None or source.colors is not None
    known = [*(c.id for c in classes), IGNORE_LABEL]
    expected = "labels of the description's map" if mapped else f"labels {known}"
    more = f" and {len(values) - _SHOWN} more" if len(values) > _SHOWN else ""
    found = ", ".join(values[:_SHOWN]) + more
    if is_jpeg(path):
        step = (
            "JPEG changes values at the edges of areas: use the labels' PNG originals, or map "
            "ranges ('map': {'0-63': 0, ...})"
        )
    elif mapped:
        step = "add it to the map, or a 'default'"
    else:
        step = (
            f"map it to a class, --label-map {values[0]}:{known[0]} or the description's 'map' "
            "and 'classes', or use --no-labels"
        )
    return DecodeError(f"{path}: expected {expected}, found {found}; {step}")


def _colored(raw: npt.NDArray[Any], path: Path, *, mapped: bool) -> DecodeError:
    """Return the error for a colour image of which only values are known; it shows a map."""
    expected = "one channel, whose values the map names" if mapped else "class ids in one channel"
    if raw.dtype != np.uint8 or raw.shape[2] < 3:
        return DecodeError(
            f"{path}: expected {expected}, found {raw.shape[2]} channels of {raw.dtype}; name the "
            'one that counts in the description, "channel": "R"'
        )
    if is_jpeg(path):
        return DecodeError(
            f"{path}: expected {expected}, found a colour JPEG, which changes colours at the edges "
            "of areas; use the labels' PNG originals"
        )
    colors = _hex(np.unique(_codes(raw)))
    shown = ", ".join(f'"{color}": {n}' for n, color in enumerate(colors[:_SHOWN]))
    more = ", ..." if len(colors) > _SHOWN else ""
    return DecodeError(
        f"{path}: expected {expected}, found a colour image ({len(colors)} colours); describe what "
        f'they mean, with the right ids, "map": {{{shown}{more}}}, or name the channel that '
        'counts, "channel": "R"'
    )
