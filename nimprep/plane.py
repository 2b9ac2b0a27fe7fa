"""Planes: kinds of images that a dataset describes itself, such as thermal or confidence."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, Modality, Resize

DTYPES = ("uint8", "int8", "uint16", "int16")
"""What the integers of a plane can be."""

_NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")

_IN_STORES = (
    "frame_id split group image_size intrinsics baseline cam_to_road gravity channel_sums "
    "class_pixels chunk_crc32c packed frame y x channel size row column road_column axis "
    "sum_channel sum class_or_ignored modality"
)
_IN_FRAMES = "id camera depth_m baseline_m others absent signs depth_u16"
_IN_SAMPLES = "inputs generator planes u v inside mask depth3"

TAKEN = frozenset(f"{_IN_STORES} {_IN_FRAMES} {_IN_SAMPLES}".split())
"""Names that no plane may have, as something else of a frame or a store has them."""

_RESIZE: dict[tuple[str, bool], Resize] = {
    ("nearest", True): "nearest",
    ("nearest", False): "nearest",
    ("linear", True): "linear where some",
    ("linear", False): "linear",
}


def plane_from(name: str, definition: Mapping[str, Any]) -> Modality:
    """Return the record of a plane: one number per pixel.

    Parameters
    ----------
    name : str
        Of its array in a store: lower-case letters, digits and underscores.
    definition : mapping
        ``dtype`` of the stored integers; ``scale`` (1) and ``offset`` (0): a value is an integer
        times the one plus the other, as in CF; ``units``, ``long_name`` (""); ``fill``, the integer
        that means none (none does); ``resize``, "nearest" or "linear" ("nearest"). Other names are
        passed over.

    Raises
    ------
    ArrayError
        The name is taken or none, or the definition describes no plane that float32, which frames
        and tensors have, can tell the steps of.
    """
    if not _NAME.fullmatch(name) or name in MODALITIES or name in TAKEN:
        raise ArrayError(
            f"plane {name!r}: expected a name of lower-case letters, digits and underscores that "
            f"nothing else of a frame has, found {name!r}; choose another"
        )
    dtype, resize = definition.get("dtype"), definition.get("resize", "nearest")
    if dtype not in DTYPES:
        raise ArrayError(
            f"plane {name!r}: expected a dtype of {', '.join(DTYPES)}, found {dtype!r}; choose "
            "among those"
        )
    if resize not in ("nearest", "linear"):
        raise ArrayError(
            f"plane {name!r}: expected resize 'nearest' or 'linear', found {resize!r}; choose one"
        )
    for key, most in (("units", 32), ("long_name", 128)):
        if len(str(definition.get(key) or "")) > most:
            raise ArrayError(
                f"plane {name!r}: expected {key} of at most {most} characters, found "
                f"{len(str(definition[key]))}; shorten it"
            )
    fill, limits = definition.get("fill"), np.iinfo(dtype)
    if fill is not None and not (type(fill) is int and limits.min <= fill <= limits.max):
        raise ArrayError(
            f"plane {name!r}: expected a fill from {limits.min} to {limits.max}, which {dtype} "
            f"holds, found {fill!r}; give another, or a wider dtype"
        )
    scale, offset = _scale(name, definition, limits)
    return Modality(
        name=name,
        values="measures",
        long_name=str(definition.get("long_name") or name.replace("_", " ")),
        units=str(definition.get("units") or ""),
        dtype=dtype,
        scale=scale,
        offset=offset,
        fill=0 if fill is None else fill,
        has_none=fill is not None,
        resize=_RESIZE[resize, fill is not None],
        divisor=_divisor(limits, scale, offset),
    )


def _scale(name: str, definition: Mapping[str, Any], limits: Any) -> tuple[float, float]:
    found = [definition.get("scale", 1), definition.get("offset", 0)]
    numbers = [x for x in found if isinstance(x, (int, float)) and not isinstance(x, bool)]
    if len(numbers) < 2 or not all(abs(x) <= 1e9 for x in numbers) or numbers[0] < 1e-9:
        raise ArrayError(
            f"plane {name!r}: expected a scale from 1e-9 to 1e9 and an offset within 1e9, found "
            f"{found[0]!r} and {found[1]!r}; give other units"
        )
    scale, offset = (float(x) for x in numbers)
    # Half a unit in the last place of float32 must be less than half a step of the integers.
    most = _divisor(limits, scale, offset)
    if most * 2.0**-24 >= scale / 2:
        raise ArrayError(
            f"plane {name!r}: expected steps that float32 can tell apart, found those of {scale:g} "
            f"in values up to {most:g}; give a smaller offset"
        )
    return scale, offset


def _divisor(limits: Any, scale: float, offset: float) -> float:
    """Return the largest value there can be, by its size."""
    return float(max(abs(int(n) * scale + offset) for n in (limits.min, limits.max)))


def definition_of(plane: Modality) -> dict[str, Any]:
    """Return what `plane_from` makes a plane of, as a store's attributes have it."""
    return {
        "dtype": plane.dtype,
        "scale": plane.scale,
        "offset": plane.offset,
        "units": plane.units,
        "long_name": plane.long_name,
        **({"fill": plane.fill} if plane.has_none else {}),
        "resize": "nearest" if plane.resize == "nearest" else "linear",
    }


def by_name(planes: Iterable[Modality]) -> dict[str, Modality]:
    """Return planes by their names, in the order in which they are listed everywhere: sorted.

    Raises
    ------
    ArrayError
        Two have one name.
    """
    found: dict[str, Modality] = {}
    for plane in planes:
        if plane.name in found:
            raise ArrayError(
                f"plane {plane.name!r}: expected it once, found it twice; name one otherwise"
            )
        found[plane.name] = plane
    return dict(sorted(found.items()))


@lru_cache(maxsize=32)
def values_of(plane: Modality) -> npt.NDArray[np.float32]:
    """Return the number that each of a plane's integers is, in their order, as unsigned ones.

    (256,) or (65536,) float32, each the nearest to its number; NaN = none.
    """
    bits = np.iinfo(plane.dtype).bits
    integers = np.arange(1 << bits, dtype=f"uint{bits}").view(plane.dtype)
    numbers = (integers.astype(np.float64) * plane.scale + plane.offset).astype(np.float32)
    if plane.has_none:
        numbers[integers == plane.fill] = np.nan
    numbers.flags.writeable = False
    return numbers


def from_plane(plane: Modality, stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a plane's integers, (H, W), as a frame has them: float32, or bytes that are plain."""
    if plane.is_plain:
        return stored
    unsigned = stored.view(f"uint{8 * stored.dtype.itemsize}")
    found: npt.NDArray[np.float32] = values_of(plane).take(unsigned)
    return found


def to_plane(plane: Modality, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image of numbers in a plane's units, (H, W), as its integers; NaN = none.

    A number that would be rounded to what means none takes the integer beside it.

    Raises
    ------
    ArrayError
        A number lies beyond what the integers say, or there is none where there must be one.
    """
    if image.ndim != 2 or image.dtype.kind not in "uif":
        raise ArrayError(
            f"{plane.name}: expected numbers, (H, W), found {image.dtype} {image.shape}; give one "
            "number per pixel"
        )
    if plane.is_plain and image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    steps = np.rint((image.astype(np.float64) - plane.offset) / plane.scale)
    none = np.isnan(steps)
    if not plane.has_none and none.any():
        raise ArrayError(
            f"{plane.name}: expected a number in every pixel, found {int(none.sum())} of NaN; give "
            "the plane a 'fill'"
        )
    limits = np.iinfo(plane.dtype)
    beyond = ~none & ~((steps >= limits.min) & (steps <= limits.max))
    if beyond.any():
        ends = [n * plane.scale + plane.offset for n in (limits.min, limits.max)]
        raise ArrayError(
            f"{plane.name}: expected {ends[0]:g} to {ends[1]:g}, which {plane.dtype} holds by its "
            f"scale and offset, found {image[beyond][0]:g}; give others"
        )
    if plane.has_none:
        beside = plane.fill - 1 if plane.fill == limits.max else plane.fill + 1
        steps[steps == plane.fill] = beside
        steps[none] = plane.fill
    return steps.astype(plane.dtype)
