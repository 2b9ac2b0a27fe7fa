"""What the numbers of depth images most likely mean, with the evidence for it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.inspection.conventions import MILLIMETRE, Convention
from nimprep.inspection.kinds import Kind
from nimprep.inspection.raw_depth import Ground, RawDepth, focal_length, ground_of, raw_depth_of
from nimprep.inspection.samples import roughness

SCALES: dict[float, tuple[str, float]] = {
    MILLIMETRE: ("millimetres", 2.0),
    1 / 256: ("1/256 m", 0.8),
    1 / 5000: ("1/5000 m", 0.8),
    0.01: ("centimetres", 0.3),
    1 / 4000: ("1/4000 m", 0.3),
    1 / 512: ("1/512 m", -0.5),
    1e-4: ("1/10000 m", 0.0),
    1 / 6553.5: ("1/6553.5 m", -0.2),
    0.005: ("1/200 m", -1.0),
    1000 / 65535: ("1000 m / 65535", -1.0),
}
"""Metres per unit of whole numbers: its name, and how common it is, points."""

FLOATS: dict[float, tuple[str, float]] = {
    1.0: ("metres", 2.0),
    MILLIMETRE: ("millimetres", 0.5),
    0.01: ("centimetres", 0.3),
    1000.0: ("1000 m per unit, as CARLA's normalised depth", -1.0),
}

_CARLA = 1000 / (256**3 - 1)
_BYTES: dict[float, tuple[str, float]] = {
    _CARLA: ("1000 m / (256^3 - 1), as CARLA has it", 2.0),
    MILLIMETRE: ("millimetres", 0.5),
    1e-4: ("1/10000 m", 0.0),
}


@dataclass(frozen=True)
class Clues:
    """Hold what is known beside the values.

    Attributes
    ----------
    conventions : tuple of Convention
    numbers : mapping
        Of the camera file, if there is one.
    stated : float, optional
        Scale that a file states: units per metre, or metres per unit.
    stated_where : str
    named : str
        "depth" or "disparity", as the names say.
    """

    conventions: tuple[Convention, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)
    stated: float | None = None
    stated_where: str = ""
    named: Kind = Kind.DEPTH


@dataclass(frozen=True)
class Encoding:
    """Say what numbers mean.

    Attributes
    ----------
    name : str
    document : mapping
        What a description says of depth, without `files`.
    score : float
        Points; a lead of 2 is a clear one.
    reasons : tuple of str
    """

    name: str
    document: Mapping[str, Any]
    score: float
    reasons: tuple[str, ...]


_STRETCHED = (
    "every image reaches from 0 to 65535: if each was stretched, as relative depth is, no scale "
    "makes metres of it"
)
UNLIKELY = -3.0
"""An encoding of fewer points is a guess at best."""


def encodings_of(planes: Sequence[npt.NDArray[Any]], clues: Clues) -> list[Encoding]:
    """Return what depth images' numbers may mean, the likeliest first.

    Parameters
    ----------
    planes : sequence of (H, W)
        Raw, of one channel.
    """
    planes, changed, said, points = _undone(planes)
    raw = raw_depth_of(planes)
    if raw is None:
        return []
    table = SCALES if raw.whole else FLOATS
    return _ranked(raw, table, clues, {**changed, **_invalid(raw)}, said, points)


def encodings_of_bytes(
    pixels: Sequence[npt.NDArray[Any]], order: str, clues: Clues
) -> list[Encoding]:
    """Return the same for numbers whose bytes lie in channels, the lowest first."""
    places = ["RGBA".index(name) for name in order]
    planes = [
        sum((p[..., place].astype(np.uint32) << np.uint32(8 * k)) for k, place in enumerate(places))
        for p in pixels
    ]
    raw = raw_depth_of(planes)  # type: ignore[arg-type]
    if raw is None:
        return []
    said = (f"the bytes of {order}, lowest first, make one smooth number",)
    return _ranked(raw, _BYTES, clues, {"bytes": order, **_invalid(raw)}, said, 0.0)


def _undone(
    planes: Sequence[npt.NDArray[Any]],
) -> tuple[Sequence[npt.NDArray[Any]], dict[str, Any], tuple[str, ...], float]:
    """Undo swapped bytes and rotated bits: planes, what a description says of it, why."""
    if planes[0].dtype != np.uint16:
        return planes, {}, (), 0.0
    swapped = [plane.byteswap() for plane in planes]
    rough, smooth = (float(np.mean([roughness(p) for p in some])) for some in (planes, swapped))
    if smooth < 0.25 * rough and rough > 0.02:
        why = f"with its bytes swapped it is {rough / max(smooth, 1e-9):.0f} times as smooth"
        return swapped, {"byte_order": "swapped"}, (why,), 0.0
    values = np.concatenate([plane[plane > 0][::7] for plane in planes])
    low = values & 7
    if values.size > 50 and np.unique(values).size > 16 and float((low < 4).mean()) > 0.98:
        turned = [(plane >> 3) | (plane << 13) for plane in planes]
        even = float((low == 0).mean())
        better = float(np.mean([roughness(p) for p in turned])) <= 1.05 * rough
        sixteen = float((values & 15 == 0).mean())
        if even > 0.3 and better and sixteen < 0.9:
            why = (
                f"the lowest 3 bits are 0 in {even:.0%} of values, and hold the highest of the "
                "others: bits rotated by 3, as in SUN RGB-D"
            )
            return turned, {"rotate_right": 3}, (why,), 4.0
    return planes, {}, (), 0.0


def _invalid(raw: RawDepth) -> dict[str, Any]:
    invalid: list[Any] = [0, *(int(v) if v.is_integer() else v for v in raw.apart)]
    if raw.negative:
        invalid.append([None, 0])
    return {"invalid": invalid} if len(invalid) > 1 else {}


def _ranked(
    raw: RawDepth,
    table: Mapping[float, tuple[str, float]],
    clues: Clues,
    document: dict[str, Any],
    said: tuple[str, ...],
    millimetre_points: float,
) -> list[Encoding]:
    ground = ground_of(raw)
    scales = dict(table)
    if raw.stretched:
        said, millimetre_points = (*said, _STRETCHED), 0.0
    stated = _stated(clues.stated)
    if stated is not None and not any(math.isclose(stated, s, rel_tol=1e-3) for s in scales):
        scales[stated] = (f"1/{1 / stated:g} m", 0.0)
    along_ray = any(convention.along_ray for convention in clues.conventions)
    found = []
    for scale, (name, points) in scales.items():
        about, more = _plausibility(raw, ground, scale, clues)
        reasons, score = [*about, *said], points + more - (6 if raw.stretched else 0)
        if math.isclose(scale, MILLIMETRE) and raw.whole:
            score += millimetre_points
        if stated is not None and math.isclose(stated, scale, rel_tol=1e-3):
            reasons.append(f"{clues.stated_where} states {clues.stated:g}")
            score += 6
        for convention in clues.conventions:
            if math.isclose(convention.scale, scale):
                reasons.append(convention.about)
                score += convention.points
        if raw.whole and "bytes" not in document:
            why, more = _steps(raw, scale)
            reasons += why
            score += more
        kind = {"values": "distance"} if along_ray else {}
        found.append(Encoding(name, {**kind, "scale_m": scale, **document}, score, tuple(reasons)))
    return sorted(found, key=lambda encoding: -encoding.score)


def _stated(number: float | None) -> float | None:
    """Return metres per unit of a stated scale, which may be units per metre."""
    if number is None or number <= 0 or number == 1:
        return None
    return 1 / number if number > 1 else number


def _plausibility(
    raw: RawDepth, ground: Ground | None, scale: float, clues: Clues
) -> tuple[list[str], float]:
    """Return how likely metres are, as points (0 at best), with what they are."""
    low, middle, high = raw.least * scale, raw.median * scale, raw.most * scale
    said = [f"{_metres(low)} to {_metres(high)} m, median {_metres(middle)} m"]
    # Rooms have medians around 2 m, streets around 10 m.
    score = -0.5 * min((math.log(middle / 2) / 0.7) ** 2, (math.log(middle / 9) / 0.8) ** 2)
    if low > 6:
        score -= (math.log(low / 6) / 0.7) ** 2
    if high < 0.6:
        score -= (math.log(high / 0.6) / 0.5) ** 2
    if high > 250:
        score -= (math.log(high / 250) / 0.4) ** 2
    if ground is not None and ground.slope < 0 and ground.depth_fit > 0.8:
        focal, given = focal_length(clues.numbers, raw.planes[0].shape[::-1])
        height = ground.depth_height * scale / focal
        score -= min(8.0, 0.5 * (math.log(height / 1.4) / 0.6) ** 2)
        by = "by the camera file" if given else "if the view is about 67 degrees wide"
        said.append(f"a ground that falls {_metres(height)} m below the camera, {by}")
    return said, score


def _metres(value: float) -> str:
    return f"{value:.2g}" if value < 10 or value > 1e6 else f"{value:.0f}"


def _steps(raw: RawDepth, scale: float) -> tuple[list[str], float]:
    """Return what steps between values tell: millimetres times 5 are multiples of 5."""
    values = raw.values.astype(np.int64)
    if np.unique(values).size < 32:
        return [], 0.0
    for step in (10, 5, 4):
        if float((values % step == 0).mean()) > 0.995:
            fits = math.isclose(scale * step, MILLIMETRE)
            why = [f"all values are multiples of {step}: millimetres times {step}"] if fits else []
            return why, (3.0 if step == 4 else 5.0) if fits else 0.0
    return [], 0.0


def disparities_of(planes: Sequence[npt.NDArray[Any]], clues: Clues) -> list[Encoding]:
    """Return what disparity images' numbers may mean, the likeliest first."""
    planes, changed, said, _ = _undone_bytes(planes)
    raw = raw_depth_of(planes)
    if raw is None:
        return []
    scales = _DISPARITIES if raw.whole else {1.0: ("pixels", 2.0)}
    if planes[0].dtype == np.uint8:
        scales = _DISPARITIES_8
    ground = ground_of(raw)
    found = []
    for scale, (name, points) in scales.items():
        most = raw.most * scale
        share = most / raw.width
        score = points - (math.log(share / 0.12) / 0.8) ** 2 - (8 if share > 0.8 else 0)
        reasons = [*said, f"up to {most:.3g} pixels, {share:.0%} of the width"]
        if raw.stretched:
            reasons.append(_STRETCHED)
            score -= 6
        if ground is not None and ground.slope > 0:
            reasons.append("values grow towards the bottom, as disparity does")
        document: dict[str, Any] = {"values": "disparity", "scale_px": scale, **changed}
        if "doffs" in clues.numbers:
            document["offset_px"] = clues.numbers["doffs"]
            reasons.append("the camera file gives an offset (doffs)")
        found.append(Encoding(name, {**document, **_invalid(raw)}, score, tuple(reasons)))
    return sorted(found, key=lambda encoding: -encoding.score)


_DISPARITIES = {
    1 / 256: ("1/256 pixel", 2.0),
    1 / 16: ("1/16 pixel", 0.5),
    1 / 64: ("1/64 pixel", 0.0),
    0.01: ("1/100 pixel", 0.0),
    1.0: ("pixels", 0.0),
    1 / 32: ("1/32 pixel", -0.5),
}
_DISPARITIES_8 = {1.0: ("pixels", 1.0), 0.25: ("1/4 pixel", 0.0), 0.5: ("1/2 pixel", 0.0)}


def _undone_bytes(
    planes: Sequence[npt.NDArray[Any]],
) -> tuple[Sequence[npt.NDArray[Any]], dict[str, Any], tuple[str, ...], float]:
    undone = _undone(planes)
    return (planes, {}, (), 0.0) if "rotate_right" in undone[1] else undone


def cityscapes_offset(encoding: Encoding) -> Encoding:
    """Return an encoding of disparity with Cityscapes' offset: (p - 1) / 256."""
    return replace(
        encoding,
        name="(value - 1) / 256 pixel",
        document={**encoding.document, "offset_px": -1 / 256},
        reasons=(*encoding.reasons, "named as Cityscapes names it, whose disparity is (p - 1)/256"),
    )
