"""What kind of image a pattern's files are: by their values first, by their names second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.inspection.kinds import Kind
from nimprep.inspection.samples import Sample, roughness
from nimprep.inspection.words import has_words, hint_of

FEW = 64
"""Labels have at most so many different values or colours in a sample."""


@dataclass(frozen=True)
class Guess:
    """Say what images are, and why.

    Attributes
    ----------
    kind : str
        "colour", "depth", "disparity", "label", "colour label", "mask", "confidence", "picture of
        depth", "hha", "normals", "thermal", "colour and thermal", "flow", "grey picture", "image".
    evidence : tuple of str
    channel : str
        The one that counts, where others are empty; "" = all.
    """

    kind: Kind
    evidence: tuple[str, ...] = ()
    channel: str = ""


def guessed(pattern: str, samples: list[Sample]) -> Guess:
    """Return what kind of image the samples of a pattern are."""
    hint, word = hint_of(pattern)
    named = (f"named {word!r}",) if word else ()
    first = samples[0]
    if first.channels == 1:
        return _one_channel(pattern, hint, named, samples)
    if first.pixels.dtype == np.uint8 and first.channels in (3, 4):
        return _bytes(pattern, hint, named, samples)
    if first.pixels.dtype == np.uint16 and first.channels == 3:
        if all(_equal_channels(sample.pixels) for sample in samples):
            return Guess(Kind.DEPTH, (*named, "three equal 16-bit channels"), "R")
        if hint == Kind.FLOW:
            return Guess(Kind.FLOW, named)
        if hint == Kind.NORMALS:
            return Guess(Kind.NORMALS, named)
        single = _single_channel([sample.pixels for sample in samples])
        if single and hint not in (Kind.DEPTH, Kind.COLOUR):
            return Guess(Kind.LABEL, (*named, f"only {single} is not 0"), single)
        if hint in (Kind.LABEL, Kind.INSTANCES) and _blocky([s.pixels[..., 0] for s in samples]):
            # SYNTHIA has instances in the second.
            return Guess(Kind.LABEL, (*named, "of 16-bit channels the first is taken"), "R")
        return Guess(Kind.COLOUR, (*named, "16-bit RGB"))
    if first.pixels.dtype.kind == "f" and first.channels == 3:
        if all(_equal_channels(sample.pixels) for sample in samples):
            return Guess(Kind.DEPTH, (*named, f"three equal channels of {first.pixels.dtype}"), "R")
        lengths = np.linalg.norm(first.pixels.reshape(-1, 3)[::97].astype(np.float64), axis=1)
        if abs(float(np.nanmedian(lengths)) - 1) < 0.02:
            return Guess(Kind.NORMALS, (*named, "vectors of length 1"))
    return Guess(Kind.IMAGE, (*named, f"{first.channels} channels of {first.pixels.dtype}"))


def _one_channel(pattern: str, hint: Kind, named: tuple[str, ...], samples: list[Sample]) -> Guess:
    values = [sample.pixels for sample in samples]
    dtype = values[0].dtype
    distinct = max(np.unique(v[:: max(1, v.shape[0] // 200)]).size for v in values)
    if samples[0].kind == "palette":
        return Guess(Kind.LABEL, (*named, "a palette"))
    if dtype.kind == "f" and hint == Kind.MASK and distinct <= 2:
        return Guess(Kind.MASK, (*named, f"{distinct} values"))
    if dtype.kind == "f":
        kind = Kind.DISPARITY if _is_disparity(pattern, hint) else Kind.DEPTH
        return Guess(kind, (*named, f"one channel of {dtype}"))
    if dtype.itemsize > 1:
        few = distinct <= FEW and _blocky(values)
        if hint in (Kind.LABEL, Kind.INSTANCES) or (
            few and hint not in (Kind.DEPTH, Kind.DISPARITY)
        ):
            kind = Kind.INSTANCES if hint == Kind.INSTANCES else Kind.LABEL
            return Guess(kind, (*named, f"{distinct} values"))
        if hint == Kind.THERMAL and not has_words(pattern, Kind.DEPTH):
            return Guess(Kind.THERMAL, (*named, f"one channel of {dtype}"))
        if hint == Kind.CONFIDENCE:
            return Guess(Kind.CONFIDENCE, named)
        kind = Kind.DISPARITY if _is_disparity(pattern, hint) else Kind.DEPTH
        return Guess(kind, (*named, f"one channel of {dtype}"))
    return _one_byte(pattern, hint, named, distinct, values)


def _is_disparity(pattern: str, hint: Kind) -> bool:
    return hint == Kind.DISPARITY or (hint != Kind.DEPTH and has_words(pattern, Kind.DISPARITY))


def _one_byte(
    pattern: str, hint: Kind, named: tuple[str, ...], distinct: int, values: list[npt.NDArray[Any]]
) -> Guess:
    if hint == Kind.DEPTH:
        if all(int(v.max()) == 255 for v in values):
            return Guess(Kind.DEPTH_PICTURE, (*named, "8 bits, every image stretched up to 255"))
        return Guess(Kind.DEPTH_PICTURE, (*named, "8 bits"))
    if _is_disparity(pattern, hint) and distinct > 8:
        return Guess(Kind.DISPARITY, (*named, "8 bits"))
    if hint in (Kind.CONFIDENCE, Kind.THERMAL):
        return Guess(hint, named)
    if hint == Kind.MASK and distinct <= 2:
        return Guess(Kind.MASK, (*named, "two values"))
    if distinct <= 2 and max(int(v.max()) for v in values) in (1, 255) and hint != Kind.LABEL:
        return Guess(Kind.MASK, (*named, "two values"))
    if distinct <= FEW and (hint in (Kind.LABEL, Kind.INSTANCES) or _blocky(values)):
        kind = Kind.INSTANCES if hint == Kind.INSTANCES else Kind.LABEL
        return Guess(kind, (*named, f"{distinct} values at most in an image"))
    if hint == Kind.INSTANCES:
        return Guess(Kind.INSTANCES, named)
    return Guess(Kind.GREY, (*named, "8-bit grey"))


def _bytes(pattern: str, hint: Kind, named: tuple[str, ...], samples: list[Sample]) -> Guess:
    values = [sample.pixels for sample in samples]
    channels = values[0].shape[2]
    alpha = channels == 4 and any(int(v[..., 3].min()) != int(v[..., 3].max()) for v in values)
    packed = float_order(values)
    if packed:
        return Guess(Kind.DEPTH, (*named, f"{packed} are the bytes of float32 numbers"))
    order = byte_order(values)
    if order and (hint == Kind.DEPTH or not alpha):
        return Guess(Kind.DEPTH, (*named, f"{order} are bytes of one number: only it is smooth"))
    single = _single_channel(values)
    if single and single != "A" and hint != Kind.DEPTH:
        return Guess(Kind.LABEL, (*named, f"only {single} is not 0"), single)
    if hint == Kind.HHA:
        return Guess(Kind.HHA, named)
    if _unit_vectors(values):
        return Guess(Kind.NORMALS, (*named, "the channels are unit vectors"))
    if hint == Kind.DEPTH:
        return Guess(Kind.DEPTH_PICTURE, (*named, "8-bit colours"))
    colours = max(_colours(v[..., :3]) for v in values)
    if colours <= FEW and (
        hint in (Kind.LABEL, Kind.INSTANCES) or _blocky([v[..., 0] for v in values])
    ):
        if hint == Kind.INSTANCES:
            return Guess(Kind.INSTANCES, named)
        if hint != Kind.COLOUR or colours <= 30:
            return Guess(Kind.COLOUR_LABEL, (*named, f"{colours} colours at most in an image"))
    if hint == Kind.THERMAL:
        return Guess(Kind.THERMAL, named)
    if alpha:
        return Guess(
            Kind.COLOUR_AND_THERMAL, (*named, "a fourth channel that varies, so it is no alpha")
        )
    return Guess(Kind.COLOUR, named or ("8-bit RGB",))


def byte_order(values: list[npt.NDArray[Any]]) -> str:
    """Return the channels whose bytes make one smooth number, lowest first; "" where none do.

    In such images the low byte is noise while the whole is smooth. A picture's channels are all
    equally rough.
    """
    for order in ("RGB", "BGR"):
        places = ["RGBA".index(name) for name in order]
        if all(_bytes_of_one(v[..., places].astype(np.int64)) for v in values):
            return order
    return ""


def float_order(values: list[npt.NDArray[Any]]) -> str:
    """Return the channels whose bytes make float32 numbers that may be metres; "" = none do."""
    if values[0].shape[2] != 4:
        return ""
    for order in ("BGRA", "RGBA"):
        planes = [floats_of(v, order) for v in values]
        if all(_may_be_metres(plane) for plane in planes):
            return order
    return ""


def floats_of(pixels: npt.NDArray[Any], order: str) -> npt.NDArray[np.float32]:
    """Return the float32 numbers whose bytes lie in the channels, the lowest first."""
    places = ["RGBA".index(name) for name in order]
    return np.ascontiguousarray(pixels[..., places]).view("<f4")[..., 0]


def _may_be_metres(plane: npt.NDArray[np.float32]) -> bool:
    with np.errstate(invalid="ignore"):
        fits = (plane == 0) | ((plane > 1e-3) & (plane < 1e5))
        calm = float(np.median(np.abs(np.diff(np.log(np.maximum(plane, 1e-3)), axis=1)))) < 0.2
    return bool(fits.mean() > 0.97 and (plane > 0).mean() > 0.05 and calm)


def _bytes_of_one(low_first: npt.NDArray[Any]) -> bool:
    low, middle, high = (low_first[..., k] for k in range(3))
    whole = low + 256 * middle + 65536 * high
    if np.unique(low).size < 16 or roughness(low) < 0.05:
        return False
    # Where the high byte is the same, the middle one goes on smoothly too.
    same = np.diff(high, axis=1) == 0
    rough = np.abs(np.diff(middle, axis=1))[same]
    calm = rough.size > 0 and float(np.median(rough)) < 0.5 * float(
        np.median(np.abs(np.diff(low, axis=1))) + 4
    )
    few = np.unique(high).size <= max(64, np.unique(low).size // 2)
    return bool(calm and few and roughness(whole) < 0.35 * roughness(low))


def _single_channel(values: list[npt.NDArray[Any]]) -> str:
    used = [name for k, name in enumerate("RGB") if any(v[..., k].any() for v in values)]
    return used[0] if len(used) == 1 else ""


def _equal_channels(pixels: npt.NDArray[Any]) -> bool:
    return bool((pixels[..., :1] == pixels).all())


def _colours(pixels: npt.NDArray[Any]) -> int:
    some = pixels[:: max(1, pixels.shape[0] // 200)].reshape(-1, 3).astype(np.int64)
    return int(np.unique(some @ np.array([65536, 256, 1])).size)


def _blocky(values: list[npt.NDArray[Any]]) -> bool:
    """Tell whether most neighbours are equal, as in labels."""
    return all(float((np.diff(v, axis=axis) == 0).mean()) > 0.85 for v in values for axis in (0, 1))


def _unit_vectors(values: list[npt.NDArray[Any]]) -> bool:
    for pixels in values:
        some = pixels[..., :3].reshape(-1, 3)[::7].astype(np.float64)
        some = some[(some != some[:, :1]).any(axis=1)]
        if some.shape[0] < 100:
            return False
        lengths = np.linalg.norm(some / 127.5 - 1, axis=1)
        if float((np.abs(lengths - 1) < 0.04).mean()) < 0.8:
            return False
    return True
