"""Signs in labels: what their counts tell of the ids."""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np
import numpy.typing as npt

from nimprep.doubts.judge import Doubt
from nimprep.frame import LabelClass

IGNORED = 0.95
"""From this share of the labels' pixels on, they are nearly all 255."""

MASKED = 0.001
"""From this share on, 255 is one of the two values of a mask."""

LABEL_KINDS = frozenset({"mask-255", "ignored", "class-missing"})

_NAMED = 5


def label_doubts(
    ids: Sequence[str],
    class_pixels: npt.NDArray[np.integer],
    classes: Sequence[LabelClass],
    withheld: Container[str] = (),
) -> list[Doubt]:
    """Return what is doubted of the labels of a data set.

    Parameters
    ----------
    ids : sequence of str
        The frames.
    class_pixels : (N, K + 1) integer
        Pixels of each class in every frame, and last of those to be ignored.
    classes : sequence of LabelClass
        The K classes; none = there are no labels.
    withheld : container of str
        Frames whose labels a benchmark keeps to itself: without any, they are not asked.
    """
    counts = class_pixels.astype(np.int64)
    some = counts[:, :-1].sum(axis=1) > 0
    # Frames without any label are another matter, unless there are no others.
    asked = [n for n, i in enumerate(ids) if some[n] or not (some.any() or i in withheld)]
    total = counts[asked].sum(axis=0)
    if not classes or not total.sum():
        return []
    of, ignored = [ids[n] for n in asked], total[-1] / total.sum()
    missing = [c for c, n in zip(classes, total[:-1], strict=True) if n == 0]
    present = [c.id for c, n in zip(classes, total[:-1], strict=True) if n]
    found = []
    if present == [0] and missing and ignored >= MASKED:
        found.append(Doubt.of("mask-255", _masked(missing), of))
    elif ignored >= IGNORED:
        share = "all" if ignored == 1 else f"{ignored:.1%}"
        text = (
            f"{share} of the labels' pixels are 255, which means ignore; if it is a class, map it, "
            '--label-map 0:0,255:1 or "map": {"0": 0, "255": 1} under label in the description'
        )
        found.append(Doubt.of("ignored", text, of))
    if missing and present and not found:
        found.append(Doubt.of("class-missing", _missing(missing), of))
    return found


def _masked(missing: Sequence[LabelClass]) -> str:
    return (
        f"the labels' values are 0 and 255 alone, and 255 means ignore: {_names(missing)} is "
        f"nowhere; if 255 is a class, map it, --label-map 0:0,255:{missing[0].id} or "
        f'"map": {{"0": 0, "255": {missing[0].id}}} under label in the description'
    )


def _missing(missing: Sequence[LabelClass]) -> str:
    text = f"no pixel of any label is {_names(missing)}"
    if any(c.id == 0 for c in missing):
        return (
            f"{text}; if ids are counted from 1, map them, --label-map 1:0,2:1 or "
            '"map": {"1": 0, "2": 1} under label in the description'
        )
    return f"{text}; check that the labels' values are the ids of the classes"


def _names(classes: Sequence[LabelClass]) -> str:
    more = len(classes) - _NAMED
    listed = ", ".join(f"{c.name} ({c.id})" for c in classes[:_NAMED])
    return listed + (f" and {more} more" if more > 0 else "")
