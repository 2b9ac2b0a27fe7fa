"""Depth images of a described dataset, whatever their numbers mean, in metres."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.images import read_depth
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.description import DepthSource
from nimprep.readers.frames import depth_in_metres
from nimprep.readers.matching import Place


def raw_depth(place: Place, source: DepthSource) -> npt.NDArray[Any]:
    """Read a depth image's raw values as (H, W): unpacked, but neither scaled nor cleared.

    Raises
    ------
    DecodeError
        It is damaged, a picture of depth, or not what the description says.
    """
    return read_depth(place.path)


def depth_image(
    place: Place,
    source: DepthSource,
    raw: npt.NDArray[Any],
    camera: GivenCamera,
    *,
    scale_m: float | None = None,
) -> npt.NDArray[np.float32]:
    """Return depth along the optical axis of raw values.

    Parameters
    ----------
    camera : GivenCamera
        Of the depth image as it is: distance along the ray and disparity depend on it.
    scale_m : float, optional
        In place of the description's; depth is then taken as it comes, while without it
        implausible depth is refused.

    Returns
    -------
    (H, W) float32, metres
        0 = none.

    Raises
    ------
    DecodeError
        No pixel has depth, one is negative, or the unit is plainly another.
    """
    return depth_in_metres(
        raw,
        place.path,
        scale_m=scale_m or source.scale,
        invalid=[value for value in source.invalid if not isinstance(value, tuple)],
        check_unit=scale_m is None,
    )
