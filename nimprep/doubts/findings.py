"""What is found in frames that are read rightly, and less than they seem."""

from __future__ import annotations

from collections.abc import Iterable

from nimprep.doubts.judge import Doubt, Rule, Signs, judged, percent
from nimprep.doubts.surfaces import ROUGH_DEG, can_be_cut, cut_sign, one_value_sign
from nimprep.modality import MODALITIES

TITLES = {
    "noisy-normals": "Normals are noise",
    "no-floor": "No floor in view",
    "one-value-depth": "Depth saturated",
    **{
        f"one-value-{m.name}-{c}": f"{m.long_name} saturated: {channel}"
        for m in MODALITIES.values()
        if m.values == "levels"
        for c, channel in enumerate(m.channels)
    },
    **{
        f"cut-{m.name}": f"{m.long_name[0].upper()}{m.long_name[1:]} cut"
        for m in MODALITIES.values()
        if can_be_cut(m)
    },
}
"""Of each kind, for people."""

ONE_VALUE = 0.5
"""The share of the pixels: of depth up to 0.04 on real frames, of HHA 0.46; of HHA's height from
the lowest point 1 where that is an outlier."""

NOISY_FRAMES = 0.2
"""The share of the frames: some data sets have depth of two kinds."""

RULES: tuple[Rule, ...] = (
    Rule(
        "noisy-normals",
        "noisy_normals_deg",
        lambda x: x >= ROUGH_DEG,
        lambda x: (
            f"normals are noise: those of the road are turned by {x:.0f} degrees in the median, as "
            "where depth is from stereo; convert with --normals nim-edge, which smooths noise"
        ),
        share=NOISY_FRAMES,
    ),
    Rule(
        "no-floor",
        "no_floor",
        lambda x: x > 0,
        lambda x: (
            "no floor is in view, and HHA's heights are counted from the lowest point instead; "
            "--hha-ground lowest counts those of all frames so"
        ),
        share=0,
    ),
    Rule(
        "one-value-depth",
        one_value_sign(MODALITIES["depth"]),
        lambda x: x > ONE_VALUE,
        lambda x: (
            f"depth is saturated, {percent(x)} of it one and the same value; if that means none, "
            'name it as "invalid" under depth in the description'
        ),
        share=0,
    ),
    *(
        Rule(
            f"one-value-{m.name}-{c}",
            one_value_sign(m, c),
            lambda x: x > ONE_VALUE,
            lambda x, m=m, channel=channel: (
                f"{m.long_name}'s {channel} is saturated, {percent(x)} of it one and the same "
                "value; the lowest point may be an outlier (--hha-ground floor), the unit another "
                "(--depth-scale), or the direction of gravity (--gravity)"
            ),
            share=0,
        )
        for m in MODALITIES.values()
        if m.values == "levels"
        for c, channel in enumerate(m.channels)
    ),
    *(
        Rule(
            f"cut-{m.name}",
            cut_sign(m),
            lambda x: x > 0,
            lambda x, m=m: (
                f"{m.name} is cut: {percent(x)} of it lies beyond {'±' if m.fill else ''}"
                f"{m.most:.6g} {m.units}, and is stored as that"
            ),
            share=0,
        )
        for m in MODALITIES.values()
        if can_be_cut(m)
    ),
)
"""In the order in which they are said."""


def find(frames: Iterable[tuple[str, Signs]]) -> list[Doubt]:
    """Return what is found in frames, as `nimprep.doubts.judge.judge` returns doubts."""
    found = list(frames)
    return list(judged(found, RULES).values())
