"""Depth images of a described dataset, whatever their numbers mean, in metres."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.depth_unit import MILLIMETRE, DepthNumbers
from nimprep.doubts.raw import check_byte_order, raw_signs
from nimprep.errors import DecodeError, NimprepError, OptionError
from nimprep.images import read_plane
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.depth_units import Unit, checked_metres
from nimprep.readers.description import DepthSource, PlaneSource
from nimprep.readers.matching import Place
from nimprep.readers.raw_values import named_none, unpacked_depth


def check_scale_option(scale_m: float | None, source: DepthSource | None) -> None:
    """Raise `OptionError` where metres per unit are given for depth that does not count metres."""
    if scale_m is not None and source is not None and not source.in_metres:
        raise OptionError(
            f"--depth-scale: expected depth in metres per unit, found {source.values}; "
            "scale it in the description"
        )


def raw_depth(place: Place, source: DepthSource) -> npt.NDArray[Any]:
    """Read a depth image's raw values as (H, W): unpacked, but neither scaled nor cleared.

    Raises
    ------
    DecodeError
        It is damaged, a picture of depth, or not what the description says.
    """
    layout = source.layout if source.bytes is None else replace(source.layout, channel=None)
    return unpacked_depth(read_plane(place.path, layout, place.index), source, place.path)


_LOOKED_AT = 8
"""Files that are opened, at most, to see whether depth has whole numbers: bad ones tell nothing."""


def depth_numbers(
    source: DepthSource, places: Iterable[Place], scale_m: float | None = None
) -> DepthNumbers:
    """Return what steps described depth comes in, and how far it is said to go.

    Parameters
    ----------
    places : iterable of Place
        Of the frames' depth, in order; the first that is whole tells the type of the numbers.
    scale_m : float, optional
        In place of the description's.
    """
    bounds = [m for m in (source.range_m[1], source.clip_m) if m is not None]
    most_m = min(bounds) if bounds else None
    scale = scale_m or source.scale
    if not source.in_metres or (scale <= MILLIMETRE and most_m is None):
        return DepthNumbers(most_m=most_m)
    dtype = _dtype(source, places)
    if dtype is None or dtype.kind not in "iu":
        return DepthNumbers(most_m=most_m)
    if dtype.itemsize <= 2 and most_m is not None:
        # A bound that the numbers cannot reach asks for nothing.
        most_m = min(most_m, scale * int(np.iinfo(dtype).max) + source.offset)
    straight = source.along_axis and source.camera is None
    offset = source.offset / scale
    return DepthNumbers(scale, straight and abs(offset - round(offset)) < 1e-6, most_m)


def _dtype(source: DepthSource, places: Iterable[Place]) -> np.dtype[Any] | None:
    """Return the type of depth's raw numbers, by the first whole file; None = there is none."""
    for place in islice(places, _LOOKED_AT):
        # What is wrong with it, or with what reads it, is said when the frame is read.
        with suppress(NimprepError):
            return raw_depth(place, source).dtype
    return None


_OF_METRES = frozenset({"multiples_of_8", "largest_raw", "at_most_raw"})
"""Signs that disparity may well have: sixteenths of a pixel, and small or saturated values."""


def checked_raw_signs(
    raw: npt.NDArray[Any],
    place: Place,
    source: DepthSource,
    root: Path,
    scale_m: float | None = None,
) -> dict[str, float]:
    """Return the signs of raw values (`nimprep.doubts.raw`): the certain ones are refused.

    Parameters
    ----------
    root : Path
        The dataset's folder.
    scale_m : float, optional
        In place of the description's.

    Raises
    ------
    DecodeError
        The bytes are swapped: values are far smoother the other way.
    """
    below = place.path.relative_to(root) if place.path.is_relative_to(root) else place.path
    # Of disparity that is described as such its name is no sign.
    name = below.as_posix() if source.in_metres else ""
    signs = raw_signs(raw, source.invalid, name)
    swapped, packed = source.byte_order == "swapped", source.bytes is not None
    check_byte_order(signs, place.path, swapped=swapped, packed=packed)
    if not source.in_metres:
        return {name: value for name, value in signs.items() if name not in _OF_METRES}
    if "at_most_raw" in signs and _bounded(np.iinfo(raw.dtype).max, source, scale_m):
        del signs["at_most_raw"]
    return signs


def _bounded(largest: int, source: DepthSource, scale_m: float | None) -> bool:
    """Tell whether the description says what becomes of the largest raw value as metres."""
    most = source.clip_m if source.range_m[1] is None else source.range_m[1]
    return most is not None and largest * (scale_m or source.scale) + source.offset > most


def depth_image(
    place: Place,
    source: DepthSource,
    raw: npt.NDArray[Any],
    camera: GivenCamera,
    *,
    scale_m: float | None = None,
    confidence: Place | None = None,
) -> npt.NDArray[np.float32]:
    """Return depth along the optical axis of raw values.

    Parameters
    ----------
    camera : GivenCamera
        Of the depth image as it is: distance along the ray and disparity depend on it.
    scale_m : float, optional
        In place of the description's; depth is then taken as it comes, while without it
        implausible depth is refused.
    confidence : Place, optional
        Of the plane that the description calls so.

    Returns
    -------
    (H, W) float32, metres
        0 = none.

    Raises
    ------
    DecodeError
        No pixel has depth, one is negative, or the unit is plainly another.
    CameraError
        The camera does not say what the values depend on, or is one of another size.
    """
    unit = Unit(source, scale_m or source.scale, camera, place.path)
    metres = unit.metres(raw)
    none = named_none(raw, source)
    if source.confidence is not None and confidence is not None:
        none |= _unsure(confidence, source, source.confidence, raw.shape)
    np.copyto(metres, 0, where=none)
    _check_clip(metres, source, unit)
    return checked_metres(_limited(metres, source), unit, check_unit=scale_m is None)


def _check_clip(metres: npt.NDArray[Any], source: DepthSource, unit: Unit) -> None:
    """Refuse depth that would all be the clip's: in another unit, it would look like a wall."""
    if source.clip_m is None:
        return
    some = np.isfinite(metres) & (metres > 0)
    if some.any() and not (metres[some] < source.clip_m).any():
        raise DecodeError(
            f"{unit.path}: expected depth nearer than 'clip_m' of {source.clip_m:g} m, found "
            f"{metres[some].min():g} m and more at {unit.told()}; {unit.step()}"
        )


def _unsure(
    place: Place, depth: DepthSource, source: PlaneSource, shape: tuple[int, ...]
) -> npt.NDArray[np.bool_]:
    """Return where the confidence is below the least that counts, or none."""
    plane = read_plane(place.path, source.layout, place.index)
    if plane.shape != shape:
        raise DecodeError(
            f"{place.path}: expected a confidence of depth's shape {shape}, found {plane.shape}; "
            "name the plane that counts as 'channel', or leave 'confidence' out"
        )
    sure: npt.NDArray[np.bool_] = plane >= depth.least_confidence
    return ~sure


def _limited(metres: npt.NDArray[Any], source: DepthSource) -> npt.NDArray[Any]:
    """Return depth without what lies outside the described range, cut to what it is clipped at."""
    low, high = source.range_m
    if low is not None:
        metres = np.where(metres < low, 0, metres)
    if high is not None:
        metres = np.where(metres > high, 0, metres)
    if source.clip_m is not None:
        far = np.isfinite(metres) & (metres > source.clip_m)
        metres = np.where(far, metres.dtype.type(source.clip_m), metres)
    return metres
