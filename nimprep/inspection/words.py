"""What the words in files' and folders' names hint at."""

from __future__ import annotations

import re
from functools import lru_cache

from nimprep.inspection.kinds import Kind

_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


HINTS: dict[Kind, frozenset[str]] = {
    Kind.MASK: _set("depthmask validmask"),
    Kind.DEPTH: _set(
        "depth depths depthmap depthmaps dep dense sparse zbuffer distance range bfx groundtruth"
    ),
    Kind.DISPARITY: _set("disp disps disparity disparities occ noc"),
    Kind.LABEL: _set(
        "label labels labelled semantic semantics sem seg segs segmentation segmentations gt mask "
        "masks annotation annotations classgt ids trainids parsing fillcolor freespace"
    ),
    Kind.INSTANCES: _set("instance instances panoptic instanceids"),
    Kind.CONFIDENCE: _set("conf confidence confidences valid validity uncertainty"),
    Kind.NORMALS: _set("normal normals normalmap"),
    Kind.HHA: _set(Kind.HHA),
    Kind.THERMAL: _set("thermal ir infrared infra nir fir lwir tir"),
    Kind.FLOW: _set("flow flows opticalflow sceneflow motion"),
    Kind.COLOUR: _set(
        "rgb rgbs color colors colour image images img imgs left right jpegimages photo photos "
        "pylon camera leftimg im"
    ),
    Kind.CAMERA: _set(
        "calib calibs calibration calibrations intrinsic intrinsics camera cameras cam cams "
        "extrinsic extrinsics"
    ),
}
"""By kind, the words that hint at it. Earlier kinds win where a name has words of several."""

_NO_FOLDER = frozenset(["valid"])
_ALL = frozenset().union(*HINTS.values()) - _NO_FOLDER


@lru_cache(maxsize=65536)
def words_of(name: str) -> tuple[str, ...]:
    """Return a name's words in small letters: "gtFine_labelIds" is gt, fine, label, ids."""
    return tuple(word.lower() for word in _WORDS.findall(name))


@lru_cache(maxsize=65536)
def has_role(name: str) -> bool:
    """Tell whether a name has a word that says what kind of file it is of."""
    return any(word in _ALL for word in words_of(name))


def hint_of(pattern: str) -> tuple[Kind, str]:
    """Return the kind that a pattern's names hint at, and the word; empty where none does.

    The file's name counts first, then the folders from the innermost out.
    """
    parts = re.sub(r"\{\w+\}", "", pattern).rsplit("/")
    for part in reversed(parts):
        stem = part.rpartition(".")[0] if part is parts[-1] else part
        words = words_of(stem)
        if words[-2:] in (("depth", "mask"), ("valid", "mask"), ("depth", "valid")):
            return Kind.MASK, " ".join(words[-2:])
        for kind, known in HINTS.items():
            for word in words:
                if word in known:
                    return kind, word
    return Kind.NONE, ""


def has_words(pattern: str, kind: Kind) -> bool:
    """Tell whether any part of a pattern has a word that hints at a kind."""
    return any(word in HINTS[kind] for word in words_of(re.sub(r"\{\w+\}", "/", pattern)))
