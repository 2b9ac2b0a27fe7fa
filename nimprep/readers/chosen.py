"""Frames of a described dataset that are asked for by what placeholders stand for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.readers.found import Found

_SHOWN = 12
"""So many values of a placeholder are named in a message."""


def chosen_of(images: Sequence[Found], only: Mapping[str, Sequence[str]]) -> list[Found]:
    """Return the images of what is asked for, by those placeholders that they have."""
    return [
        found
        for found in images
        if all(found.values.get(name, values[0]) in values for name, values in only.items())
    ]


def chosen_colors(
    root: Path, images: Sequence[Found], only: Mapping[str, Sequence[str]]
) -> list[Found]:
    """Return the colour images of what is asked for.

    Raises
    ------
    LayoutError
        Of some there is none.
    """
    for name, values in only.items():
        there = sorted({found.values[name] for found in images if name in found.values})
        if lost := [value for value in values if value not in there]:
            known = ", ".join(there[:_SHOWN]) + (", ..." if len(there) > _SHOWN else "")
            raise LayoutError(
                f"{root}: expected {name} {' and '.join(lost)}, which is asked for, found "
                f"{known or 'none'}; choose among those"
            )
    return chosen_of(images, only)
