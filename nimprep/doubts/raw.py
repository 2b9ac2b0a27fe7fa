"""Signs in raw depth values, before anything is made of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError

CERTAINLY_SWAPPED = 1 / 8
"""Depth this many times rougher than with its bytes swapped is refused.

On nine real frames the swapped values were 51 to 299 times as rough as the right ones, and so a
swapped file is 1/299 to 1/51; noise without any depth in it is 1.
"""

_SAMPLED = 20_000
"""Values that signs are measured on, of some rows all of them: neighbours tell of each other."""

_LEAST_VALUES = 500
_LEAST_LEVELS = 3

_DISPARITY = re.compile(r"(?<![a-z])disp(?![a-z])|disparit", re.IGNORECASE)

Bounds = tuple[float | None, float | None]


def raw_signs(
    raw: npt.NDArray[Any], invalid: Iterable[float | Bounds] = (), name: str = ""
) -> dict[str, float]:
    """Measure what tells that raw depth values are not what they are taken for.

    Parameters
    ----------
    raw : (H, W) integer or floating
        As decoded, neither scaled nor cleared; 0 = none. Of others than integers nothing is known.
    invalid : iterable of numbers and (first, last), None = no bound
        Raw values that mean none.
    name : str
        The file's path below the data set's folder.

    Returns
    -------
    dict
        ``swapped_roughness``: the median difference of neighbouring values with their bytes
        swapped, as a multiple of that without; ``multiples_of_8``: the share of such values;
        ``largest_raw``; ``at_most_raw``: the share of those that are the type's largest;
        ``disparity_name``: whether the name says disparity. What cannot be measured is left out.
    """
    signs = {"disparity_name": float(_DISPARITY.search(name) is not None)}
    # Of images that have 8 bits and may, as disparity, these signs would be nothing new.
    if raw.dtype.kind not in "iu" or raw.dtype.itemsize == 1:
        return signs
    named = _valid_rows(raw, invalid)
    # Where it is a depth at all, it is one beside which no other can be measured.
    values = named[named != np.iinfo(raw.dtype).max]
    if named.size >= _LEAST_VALUES:
        signs["at_most_raw"] = 1 - values.size / named.size
    if values.size < _LEAST_VALUES:
        return signs
    signs["multiples_of_8"] = float(np.count_nonzero(values & 7 == 0) / values.size)
    signs["largest_raw"] = float(values.max())
    if raw.dtype.itemsize == 2:
        signs |= _byte_signs(values.astype(np.uint16, copy=False))
    return signs


def check_byte_order(
    signs: dict[str, float], where: object, *, swapped: bool = False, packed: bool = False
) -> None:
    """Refuse depth whose bytes are swapped beyond doubt.

    Parameters
    ----------
    signs : dict
        Of `raw_signs`.
    where : object
        The file, for the message.
    swapped : bool
        Whether its bytes have been swapped already, because a description says so.
    packed : bool
        Whether a description says which channels have the bytes.

    Raises
    ------
    DecodeError
        It is far smoother with its bytes swapped.
    """
    if signs.get("swapped_roughness", 1.0) < CERTAINLY_SWAPPED:
        step = 'give "byte_order": "swapped" under depth in a description, or write the file anew'
        if swapped:
            step = 'leave "byte_order" out of the description'
        elif packed:
            step = 'turn "bytes" around in the description'
        raise DecodeError(
            f"{where}: expected depth whose neighbouring values are alike, found it "
            f"{1 / signs['swapped_roughness']:.0f} times as smooth with the bytes of its values "
            f"swapped; {step}"
        )


def _valid_rows(raw: npt.NDArray[Any], invalid: Iterable[float | Bounds]) -> npt.NDArray[Any]:
    """Return the valid values of some rows, one row after the other."""
    height, width = raw.shape
    step = max(1, height * width // _SAMPLED)
    values = raw[step // 2 if step <= height else 0 :: step].reshape(-1)
    some = values != 0
    if raw.dtype.kind == "i":
        some &= values > 0
    for each in invalid:
        first, last = each if isinstance(each, tuple) else (each, each)
        some &= ~(
            (values >= (-np.inf if first is None else first))
            & (values <= (np.inf if last is None else last))
        )
    valid: npt.NDArray[Any] = values[some]
    return valid


def _byte_signs(values: npt.NDArray[np.uint16]) -> dict[str, float]:
    # Of steps of 256 alone nothing is known: with swapped bytes they are the smoother, too.
    for byte in (values & 0xFF, values >> 8):
        if np.unique(byte).size < _LEAST_LEVELS:
            return {}
    found, swapped = _roughness(values), _roughness(values.byteswap())
    return {"swapped_roughness": swapped / found}


def _roughness(values: npt.NDArray[np.uint16]) -> float:
    """Return the median of what neighbours differ by, where they do."""
    apart = np.abs(np.diff(values.astype(np.int32)))
    return float(np.median(apart[apart > 0]))
