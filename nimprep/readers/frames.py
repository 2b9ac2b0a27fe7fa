"""Steps that readers share: pairing files, raw depth to metres, checks on a frame as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.depth import checked_depth
from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.frame import IGNORE_LABEL, LabelClass

PLAUSIBLE_MEDIAN_M = (0.05, 100.0)
"""A frame whose median depth lies outside this range, metres, is in another unit."""


def match_frames(files: Mapping[str, Mapping[str, Path]], root: Path) -> tuple[str, ...]:
    """Return the sorted frame ids that every modality has.

    Parameters
    ----------
    files : mapping of modality (or folder) name to {frame id: file}

    Raises
    ------
    LayoutError
        There are no frames, or one lacks a modality; it is named.
    """
    ids = sorted(set().union(*files.values()))
    if not ids:
        raise LayoutError(f"{root}: expected images in {', '.join(files)}, found none")
    for name, by_id in files.items():
        missing = [i for i in ids if i not in by_id]
        if missing:
            have = next(by_id[missing[0]] for by_id in files.values() if missing[0] in by_id)
            raise LayoutError(
                f"{root}: expected {name} for every frame, found none for frame {missing[0]!r} "
                f"(which has {have.relative_to(root) if have.is_relative_to(root) else have}; "
                f"{len(missing)} of {len(ids)} frames lack {name})"
            )
    return tuple(ids)


def depth_in_metres(
    raw: npt.NDArray[Any],
    path: Path,
    *,
    scale_m: float,
    invalid: Sequence[float],
    check_unit: bool,
) -> npt.NDArray[np.float32]:
    """Return raw depth as float32 metres, 0 = none.

    Parameters
    ----------
    raw : (H, W) uint16 or floating
        As decoded; 0, NaN and infinity are none, as is what comes out below 0.1 mm.
    scale_m : float
        Metres per raw unit.
    invalid : sequence of float
        Raw values that mean "no depth".
    check_unit : bool
        Refuse a median outside `PLAUSIBLE_MEDIAN_M`.

    Raises
    ------
    DecodeError
        No pixel has depth, one is negative, or the unit is plainly another.
    """
    # Dividing by a whole number keeps 1500 mm at exactly 1.5 m; multiplying by 0.001 does not.
    per_metre = round(1 / scale_m)
    whole = abs(1 / scale_m - per_metre) < 1e-6 * per_metre
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        metres = raw / np.float32(per_metre) if whole else raw * np.float32(scale_m)
    for value in invalid:
        np.copyto(metres, 0, where=raw == value)
    try:
        depth_m = checked_depth(metres)
    except ArrayError as error:
        raise DecodeError(f"{path}: {error}") from error
    # Some 20,000 pixels tell the unit as well as all of them, at a hundredth of the time.
    some = depth_m.reshape(-1)[:: max(1, depth_m.size // 20_000)]
    valid = some[some > 0] if some.any() else depth_m[depth_m > 0]
    if valid.size == 0:
        raise DecodeError(f"{path}: expected depth, found no pixel that has any")
    low, high = PLAUSIBLE_MEDIAN_M
    # In float64: the mean of the two in the middle may be beyond float32.
    median = float(np.median(valid.astype(np.float64)))
    if check_unit and not low <= median <= high:
        raise DecodeError(
            f"{path}: expected a median depth of {low:g} to {high:g} m, found {median:g} m at "
            f"{scale_m:g} m per unit; give the right one with --depth-scale"
        )
    return depth_m


def check_label(
    label: npt.NDArray[Any], classes: Sequence[LabelClass], path: Path
) -> npt.NDArray[np.uint8]:
    """Return the label image after checking that it holds class ids and 255 only.

    Raises
    ------
    DecodeError
        It has colours, or another value.
    """
    if label.ndim != 2:
        raise DecodeError(f"{path}: expected class ids in one channel, found a colour image")
    known = [c.id for c in classes] + [IGNORE_LABEL]
    # Classes are mostly numbered from 0 on: one comparison for these, and one for each other id.
    first = next(i for i in range(len(known) + 1) if i not in known)
    unknown = label >= first
    for value in known:
        if value > first:
            unknown &= label != value
    if unknown.any():
        raise DecodeError(
            f"{path}: expected labels {known}, found {label[unknown].min()}; "
            "describe other classes with a folder description, or use --no-labels"
        )
    return label.astype(np.uint8, copy=False)


def check_same_shape(images: Mapping[Path, npt.NDArray[Any]]) -> None:
    """Raise `DecodeError` where a frame's images differ in height or width."""
    first = next(iter(images))
    for path, image in images.items():
        if image.shape[:2] != images[first].shape[:2]:
            (h, w), (h0, w0) = image.shape[:2], images[first].shape[:2]
            raise DecodeError(
                f"{path}: expected {w0}x{h0} pixels like {first.name} in {first.parent.name}/, "
                f"found {w}x{h}"
            )
