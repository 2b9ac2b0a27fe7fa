"""From the signs of every frame to what is doubted of the data set."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from nimprep.doubts.depth import LEAST_FOCAL_PX

NAMED = 5
"""So many of the frames that a doubt is of are named; of the rest the number is given."""

TITLES = {
    "byte-order": "Bytes of depth swapped?",
    "rotated-bits": "Bits of depth rotated?",
    "eight-bits": "Depth of 8 bits?",
    "saturated": "The largest value read as depth?",
    "disparity-name": "Disparity read as depth?",
    "grows-downwards": "Depth upside down, or disparity?",
    "sparse": "Depth without neighbours",
    "staircase": "Depth filled in steps",
    "camera-height": "Camera too low or too high",
    "normalised-camera": "Camera in shares of the image?",
    "principal-point": "Principal point outside the image",
    "field-of-view": "Camera of another image?",
    "beyond-range": "Depth beyond what a store holds",
    "exif-orientation": "Images turned by EXIF",
    "mask-255": "Class 255 ignored?",
    "ignored": "Labels ignored",
    "class-missing": "Classes that are nowhere",
    "gravity-turns": "Gravity turns within a recording",
    "gravity-up": "Gravity upside down?",
}
"""Of each kind of doubt, for people."""

Signs = Mapping[str, float]


@dataclass(frozen=True)
class Doubt:
    """Say one thing that a data set is perhaps read wrongly by.

    Attributes
    ----------
    kind : str
        Stable name.
    text : str
        What was found, what may be the cause, and what to do then.
    frames : list of str
        The ids of the first frames it is of.
    count : int
        So many frames it is of.
    """

    kind: str
    text: str
    frames: list[str]
    count: int

    @classmethod
    def of(cls, kind: str, text: str, ids: Sequence[str]) -> Doubt:
        """Return the doubt that is of just these frames."""
        return cls(kind, text, list(ids[:NAMED]), len(ids))

    def to_json(self) -> dict[str, Any]:
        """Return it as a store's attributes hold it."""
        return asdict(self)


def sentence(doubt: Mapping[str, Any]) -> str:
    """Return a doubt of a store's attributes as one line, with the frames that it is of."""
    frames = f"{doubt['count']} frame" + ("" if doubt["count"] == 1 else "s")
    return f"{doubt['text']} ({frames}, first {doubt['frames'][0]!r})"


@dataclass(frozen=True)
class Rule:
    """Say when a sign is a doubt.

    Attributes
    ----------
    kind : str
    sign : str
        The sign's name; frames without it are not asked.
    doubtful : callable
        Whether a frame with this value of it is one the doubt is of.
    text : callable
        What to say, of the median of the doubtful frames' values, and of those of `beside`.
    share : float
        Of the frames that have the sign, so many must be doubtful; 0 = one is enough.
    beside : tuple of str
        Signs that the text says, too; None where no doubtful frame has one.
    """

    kind: str
    sign: str
    doubtful: Callable[[float], bool]
    text: Callable[..., str]
    share: float = 0.5
    beside: tuple[str, ...] = ()


SWAPPED_ROUGHNESS = 0.5
"""Real depth is 51 or more, see `nimprep.doubts.raw.CERTAINLY_SWAPPED`; noise is 1."""

MULTIPLES_OF_8 = 0.99
"""The share of raw values: 0.09 to 0.15 on twenty real frames."""

EIGHT_BITS = 255

SATURATED = 0.001
"""The share of the raw values; where it means none on real frames, 0.00008 to 0.0083."""

ROW_CORRELATION = 0.4
"""Real depth has -0.96 to -0.49 in the lower half of the image, rendered objects 0.15 and 0.22,
and disparity of the real frames, read as depth, 0.45 to 1."""

WITH_NEIGHBOURS = 0.5
"""Dense real depth has 0.99 or more, LiDAR as measured 0.00."""

STAIRCASE = 0.2
"""Of LiDAR filled by the nearest 0.30 and more, linearly 0.00003; of a dense frame's holes 0.14."""

CAMERA_HEIGHT_M = (0.1, 3.0)
"""From a small robot's to a lorry's; on real frames 0.50 to 1.96."""

BEYOND_RANGE = 0.1
"""The share of the depth; 0.033 on a real frame with depth to 100 m."""

PRINCIPAL_POINT = (0.0, 1.0)

VIEW_DEG = (10.0, 150.0)


def percent(share: float) -> str:
    """Return a share in percent that is 0 or 100 only where it is."""
    if share in (0, 1):
        return "all" if share else "none"
    if share > 0.999:
        return "more than 99.9%"
    return "less than 1%" if share < 0.01 else f"{100 * share:.3g}%"


_DESCRIBE = "under depth in the description"

RULES: tuple[Rule, ...] = (
    Rule(
        "exif-orientation",
        "exif_orientation",
        lambda x: x != 1,
        lambda x: (
            f"images are turned by their EXIF orientation, {x:.0f}, as viewers show them; if "
            "labels or cameras are those of the pixels as they are stored, say "
            '"orientation": "ignore" in the description'
        ),
        share=0,
    ),
    Rule(
        "byte-order",
        "swapped_roughness",
        lambda x: x < SWAPPED_ROUGHNESS,
        lambda x: (
            f"depth is {1 / x:.1f} times as smooth with the bytes of its values swapped; if they "
            f'are swapped, give "byte_order": "swapped" {_DESCRIBE}'
        ),
    ),
    Rule(
        "rotated-bits",
        "multiples_of_8",
        lambda x: x >= MULTIPLES_OF_8,
        lambda x: (
            f"{percent(x)} of the raw depth values are multiples of 8, as where their bits are "
            f'rotated by 3 (SUN RGB-D); if so, give "rotate_right": 3 {_DESCRIBE}'
        ),
    ),
    Rule(
        "eight-bits",
        "largest_raw",
        lambda x: x <= EIGHT_BITS,
        lambda x: (
            f"raw depth values go to {x:.0f} only, as those of an 8-bit image kept in 16 bits, "
            "made for looking at; take the depth it was made of, or check its unit "
            "(--depth-scale)"
        ),
    ),
    Rule(
        "saturated",
        "at_most_raw",
        lambda x: x >= SATURATED,
        lambda x: (
            f"{percent(x)} of the raw depth values are the largest their type holds, and taken "
            f'for depth; if it means none, name it as "invalid" {_DESCRIBE}'
        ),
        share=0,
    ),
    Rule(
        "disparity-name",
        "disparity_name",
        lambda x: x > 0,
        lambda x: (
            "files that are read as depth have disparity in their names; if they hold it, give "
            f'"values": "disparity" {_DESCRIBE}'
        ),
        share=0,
    ),
    Rule(
        "grows-downwards",
        "row_correlation",
        lambda x: x > ROW_CORRELATION,
        lambda x: (
            "depth grows towards the bottom of the image (correlation with the row in the lower "
            f"half {x:.2f}), where roads come nearer, as of disparity or of images upside down; if "
            f'it is disparity, give "values": "disparity" {_DESCRIBE}'
        ),
    ),
    Rule(
        "sparse",
        "with_neighbours",
        lambda x: x < WITH_NEIGHBOURS,
        lambda x, alone: (
            f"{percent(x)} of the pixels with depth have it beside them on each axis, few as of "
            "LiDAR: normals, HHA and the like need neighbours"
            + (f", and {percent(alone)} have no normal, none being beside them" if alone else "")
            + "; convert with --fill linear"
        ),
        share=0,
        beside=("alone",),
    ),
    Rule(
        "staircase",
        "staircase",
        lambda x: x >= STAIRCASE,
        lambda x: (
            f"{percent(x)} of the pixels with depth were filled in and are exactly as far as all "
            "around them, the treads of steps, which normals take for walls; convert with --fill "
            "linear"
        ),
        share=0,
    ),
    Rule(
        "camera-height",
        "camera_height_m",
        lambda x: not CAMERA_HEIGHT_M[0] <= x <= CAMERA_HEIGHT_M[1],
        lambda x: (
            f"the camera is {x:.3g} m above the road that depth shows, and not "
            f"{CAMERA_HEIGHT_M[0]:g} to {CAMERA_HEIGHT_M[1]:g} m: perhaps the unit is another "
            "(--depth-scale), or the camera another image's"
        ),
    ),
    Rule(
        "normalised-camera",
        "focal_px",
        lambda x: x < LEAST_FOCAL_PX,
        lambda x: (
            f"the focal length is {x:.3g} pixels, as where it is a share of the image's size; "
            "give the camera in pixels: fx and cx times the width, fy and cy times the height"
        ),
        share=0,
    ),
    *(
        Rule(
            "principal-point",
            f"{name}_share",
            lambda x: not PRINCIPAL_POINT[0] <= x <= PRINCIPAL_POINT[1],
            lambda x, name=name, size=size: (
                f"the principal point lies outside the image, {name} at {x:.3g} of its {size}; "
                "give the camera of images of this size"
            ),
            share=0,
        )
        for name, size in (("cx", "width"), ("cy", "height"))
    ),
    Rule(
        "field-of-view",
        "view_deg",
        lambda x: not VIEW_DEG[0] <= x <= VIEW_DEG[1],
        lambda x: (
            f"the camera's field of view is {x:.3g} degrees, and not {VIEW_DEG[0]:g} to "
            f"{VIEW_DEG[1]:g}; give the camera of images of this size"
        ),
        share=0,
    ),
)
"""In the order in which doubts are said."""


def judge(frames: Iterable[tuple[str, Signs]], *, filled: bool, most_m: float) -> list[Doubt]:
    """Return what is doubted of a data set.

    Parameters
    ----------
    frames : iterable of (id, signs)
        In order; signs as of `nimprep.doubts.raw` and `nimprep.doubts.depth`.
    filled : bool
        Whether holes in depth are filled before anything is made of it.
    most_m : float
        The farthest depth that is kept, metres.
    """
    known = list(frames)
    found = judged(known, [r for r in RULES if not (filled and r.kind == "sparse")])
    # Of a camera in shares of the image's size both are true; of a tiny image's only the first.
    both = {"field-of-view", "normalised-camera"} <= found.keys()
    found.pop("field-of-view" if both else "normalised-camera", None)
    return [*found.values(), *_beyond_range(known, most_m)]


def judged(frames: Sequence[tuple[str, Signs]], rules: Iterable[Rule]) -> dict[str, Doubt]:
    """Return what rules say of frames, by kind."""
    found: dict[str, Doubt] = {}
    for rule in rules:
        asked = [(i, signs[rule.sign]) for i, signs in frames if rule.sign in signs]
        ids = [i for i, value in asked if rule.doubtful(value)]
        if ids and len(ids) >= rule.share * len(asked):
            text = rule.text(*_medians(dict(frames), ids, (rule.sign, *rule.beside)))
            found.setdefault(rule.kind, Doubt.of(rule.kind, text, ids))
    return found


def _medians(
    frames: Mapping[str, Signs], ids: Sequence[str], names: Sequence[str]
) -> list[float | None]:
    """Return the median of each sign over the frames that have it; None = none has."""
    values = [[frames[i][name] for i in ids if name in frames[i]] for name in names]
    return [statistics.median(some) if some else None for some in values]


def _beyond_range(frames: Sequence[tuple[str, Signs]], most_m: float) -> list[Doubt]:
    """Doubt where too much of the depth of all frames together is too far to be kept."""
    shares = [(i, signs["beyond_range"]) for i, signs in frames if "beyond_range" in signs]
    if not shares or (share := statistics.fmean(s for _, s in shares)) < BEYOND_RANGE:
        return []
    text = (
        f"{share:.0%} of the depth lies beyond {most_m:.6g} m, the farthest that the store holds, "
        'and is none there; where a value means none, name it under "invalid", else check the unit '
        "(--depth-scale), or store depth in a coarser one (--depth-unit)"
    )
    return [Doubt.of("beyond-range", text, [i for i, s in shares if s > 0])]
