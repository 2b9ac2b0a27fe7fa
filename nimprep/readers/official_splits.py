"""The split that a dataset's authors chose, as folders' names or list files say it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from nimprep.readers.description import Description
from nimprep.readers.matching import Matched
from nimprep.splits import SplitName


@dataclass(frozen=True)
class OfficialSplits:
    """Hold which frames the authors put into which split.

    Attributes
    ----------
    of_frame : mapping of frame id to split
        Frames that are not in it are free.
    skipped : frozenset of frame id
        Those to be left out.
    notes : tuple of str
        One line each: what was taken for a split.
    """

    of_frame: Mapping[str, SplitName] = field(default_factory=dict)
    skipped: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


def official_splits(root: Path, description: Description, matched: Matched) -> OfficialSplits:
    """Return the split of the dataset's authors.

    Raises
    ------
    LayoutError
        A list is missing or names what is no frame, or a frame is in no list or in several.
    """
    return OfficialSplits()
