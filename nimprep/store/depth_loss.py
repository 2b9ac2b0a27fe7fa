"""Depth of the source that a store's unit cannot say: how much it was, and from where on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NotRequired, TypedDict

import numpy as np
import numpy.typing as npt

from nimprep.depth_unit import MOST_STEPS, NAMED_UNITS, unit_for
from nimprep.modality import Modality


class DepthLost(TypedDict):
    """Say what a store's attributes say of depth that its source had and it has not.

    Attributes
    ----------
    pixels, frames : int
        So many pixels, in so many frames.
    share : float
        Of the pixels that had depth.
    beyond_m, farthest_m : float, metres
        What lies beyond is lost; the farthest that was lost. Absent where none was too far.
    nearer_m : float, metres
        What is nearer is lost, being less than half a unit. Absent where none was too near.
    """

    pixels: int
    frames: int
    share: float
    beyond_m: NotRequired[float]
    farthest_m: NotRequired[float]
    nearer_m: NotRequired[float]


def lost_depth(
    depth: Modality, measured: npt.NDArray[np.float32], stored: npt.NDArray[np.uint16]
) -> dict[str, float]:
    """Return what a store has not of a frame's depth, as a `DepthLost` without its share.

    Parameters
    ----------
    depth : Modality
        As the store holds it.
    measured, stored : (H, W) float32, metres, and uint16
        Some positive ones of the first are 0 in the second.
    """
    values = measured[(measured > 0) & (stored == 0)]
    found: dict[str, float] = {"pixels": values.size, "frames": 1}
    # Far and near are told apart by half the range: between the two there is nothing lost.
    middle_m = depth.most / 2
    if (farthest := float(values.max())) > middle_m:
        found |= {"beyond_m": depth.most, "farthest_m": farthest}
    if values.min() < middle_m:
        found |= {"nearer_m": depth.step / 2}
    return found


def joined_loss(parts: Iterable[Mapping[str, Any] | None], pixels: int) -> DepthLost | None:
    """Return what was lost of parts together; None = nothing.

    Parameters
    ----------
    parts : iterable of DepthLost or None
        Their shares do not count.
    pixels : int
        That have depth in all of them.
    """
    found = [part for part in parts if part is not None]
    if not found:
        return None
    lost = sum(part["pixels"] for part in found)
    joined = DepthLost(
        pixels=lost, frames=sum(part["frames"] for part in found), share=lost / (lost + pixels)
    )
    if beyond := _values(found, "beyond_m"):
        joined["beyond_m"] = min(beyond)
        joined["farthest_m"] = max(_values(found, "farthest_m"))
    if nearer := _values(found, "nearer_m"):
        joined["nearer_m"] = max(nearer)
    return joined


def _values(found: Sequence[Mapping[str, Any]], name: str) -> list[float]:
    return [part[name] for part in found if name in part]


def loss_text(lost: Mapping[str, Any]) -> str:
    """Return what was lost as one line, and what would keep it."""
    share = 100 * lost["share"]
    much = f"{share:.2g} %" if share >= 0.01 else "less than 0.01 %"
    frames = f"{lost['frames']} frame" + ("" if lost["frames"] == 1 else "s")
    text = f"{much} of the depth, in {frames}, is none in the store: it lies "
    places = []
    if "beyond_m" in lost:
        places.append(
            f"beyond {lost['beyond_m']:.6g} m, the farthest at {lost['farthest_m']:.6g} m"
        )
    if "nearer_m" in lost:
        places.append(f"nearer than {lost['nearer_m']:.3g} m")
    return text + " or ".join(places) + _way_out(lost)


def _way_out(lost: Mapping[str, Any]) -> str:
    if "beyond_m" not in lost:
        return "; a finer --depth-unit keeps it"
    most_m = MOST_STEPS * NAMED_UNITS["cm"]
    if lost["farthest_m"] <= most_m:
        return f"; --depth-unit {unit_for(lost['farthest_m']):g} keeps it, rounded to that"
    if lost["beyond_m"] < most_m:
        return f"; --depth-unit cm keeps it up to {most_m:g} m, rounded to that"
    return "; where a value means none, name it as such"
