"""Maps of labels: from the values or colours that files hold to class ids."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import LayoutError
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.readers.description import Color, LabelSource

MOST_VALUE = 99_999
"""The largest value that a map can name."""

_ENTRY = re.compile(r"([0-9]{1,5}(?:-[0-9]{1,5})?|#[0-9a-fA-F]{6}):([0-9]{1,3})")

_NONE = 0
"""What a table holds for values that nothing names; for others the class id + 1."""


def map_from_text(text: str) -> dict[str, int]:
    """Return the map that a command line's "0:0,128-255:1,#ff0000:2" is.

    Raises
    ------
    LayoutError
        It is none.
    """
    named: dict[str, int] = {}
    for entry in text.replace(" ", "").split(","):
        found = _ENTRY.fullmatch(entry)
        if found is None or found[1] in named:
            raise LayoutError(
                "--label-map: expected value:class, each value once, as in 0:0,128-255:1,"
                f"#ff0000:2, found {entry!r}; write it so"
            )
        named[found[1]] = int(found[2])
    return named


def with_map(
    source: LabelSource, named: Mapping[str, int], classes: Sequence[LabelClass], where: str
) -> LabelSource:
    """Return where labels are with what their values mean.

    Parameters
    ----------
    named : mapping of value ("7"), range ("128-255") or colour ("#rrggbb") to class id
    classes : sequence of LabelClass
        Those there are.
    where : str
        Who says the map, for messages.

    Raises
    ------
    LayoutError
        Two keys name one value, a range runs backwards, or a class is none.
    """
    check_classes(named.values(), classes, where)
    ranges = sorted((*_range(key, where), v) for key, v in named.items() if key[0] != "#")
    for (_, last, _), (first, _, _) in pairwise(ranges):
        if first <= last:
            raise LayoutError(
                f"{where}: expected each value once in a label map, found {first} twice; "
                "leave one of its keys out"
            )
    colors: dict[Color, int] = {}
    for key, value in named.items():
        if key[0] != "#":
            continue
        color = (int(key[1:3], 16), int(key[3:5], 16), int(key[5:7], 16))
        if color in colors:
            raise LayoutError(
                f"{where}: expected each colour once in a label map, found {key.lower()} twice; "
                "leave one out"
            )
        colors[color] = value
    return replace(source, ranges=tuple(ranges), colors=colors or None)


def check_classes(values: Any, classes: Sequence[LabelClass], where: str) -> None:
    """Raise `LayoutError` where one of the class ids is none of the classes nor 255."""
    known = [c.id for c in classes] + [IGNORE_LABEL]
    for value in values:
        if value not in known:
            raise LayoutError(
                f"{where}: expected labels mapped to classes ({', '.join(map(str, known))}), "
                f"found {value}; describe that class or map to another"
            )


def _range(key: str, where: str) -> tuple[int, int]:
    first, _, last = key.partition("-")
    found = int(first), int(last or first)
    if found[0] > found[1]:
        raise LayoutError(
            f"{where}: expected a range from less to more in a label map, found {key!r}; "
            "turn it around"
        )
    return found


def value_table(source: LabelSource, classes: Sequence[LabelClass]) -> npt.NDArray[np.uint16]:
    """Return class id + 1 by value, 0 = a value that has none; (100000,) uint16.

    Without a map, values are class ids.
    """
    table = np.full(MOST_VALUE + 1, _filled(source), np.uint16)
    if source.ranges is None and source.colors is None:
        for known in [*(c.id for c in classes), IGNORE_LABEL]:
            table[known] = known + 1
    for (red, green, blue), known in (source.colors or {}).items():
        # A grey image is one of colours whose channels are equal.
        if red == green == blue:
            table[red] = known + 1
    for first, last, known in source.ranges or ():
        table[first : last + 1] = known + 1
    return table


def color_table(source: LabelSource) -> npt.NDArray[np.uint16]:
    """Return class id + 1 by colour 0xRRGGBB, 0 = a colour that has none; (1 << 24,) uint16."""
    # Of zeros, which cost no memory until they are written: a table of all colours is 32 MiB.
    table = np.zeros(1 << 24, np.uint16)
    for (red, green, blue), known in (source.colors or {}).items():
        table[red << 16 | green << 8 | blue] = known + 1
    return table


def _filled(source: LabelSource) -> int:
    return _NONE if source.default is None else source.default + 1
