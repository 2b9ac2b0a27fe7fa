"""Raw numbers of depth to metres along the optical axis, whatever they count.

Source: Hartley and Zisserman, Multiple View Geometry, 2nd ed.: Z = f B / d of a rectified pair
(11.12); Z = distance / |ray|, the ray through a pixel being ((u - cx) / fx, (v - cy) / fy, 1)
(6.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.depth import checked_depth
from nimprep.errors import ArrayError, CameraError, DecodeError
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.description import DepthSource, metres_per_unit

PLAUSIBLE_MEDIAN_M = (0.05, 100.0)
"""A frame whose median depth lies outside this range, metres, is in another unit."""

MISTAKEN_SCALE_M = 10.0
"""From so many metres per unit on, a scale rather counts units per metre."""


@dataclass(frozen=True)
class Unit:
    """Say what a depth image's raw numbers count, and where it was taken.

    Attributes
    ----------
    source : DepthSource
    scale : float
        The source's, or the user's in its place.
    camera : GivenCamera
        Of the depth image as it is.
    path : Path
        The image's, for messages.
    """

    source: DepthSource
    scale: float
    camera: GivenCamera
    path: Path

    def metres(self, raw: npt.NDArray[Any]) -> npt.NDArray[np.floating[Any]]:
        """Return depth of raw numbers that mean some; infinity = too far for any.

        Raises
        ------
        CameraError
            What it depends on is not known: the baseline, the focal length or the rays.
        """
        of = {
            "depth": lambda values: values,
            "distance": self._from_distance,
            "disparity": self._from_disparity,
            "inverse": lambda values: 1 / values,
        }
        convert: Callable[[npt.NDArray[Any]], npt.NDArray[Any]] = of[self.source.values]
        with np.errstate(all="ignore"):
            return convert(scaled(raw, self.scale, self.source.offset))

    def _from_distance(self, distance_m: npt.NDArray[Any]) -> npt.NDArray[Any]:
        height, width = distance_m.shape
        self._refuse_nominal("distance along the ray", "intrinsics")
        z: npt.NDArray[Any] = distance_m / self.camera.ray_lengths(height, width, self.path.stem)
        return z

    def _from_disparity(self, disparity_px: npt.NDArray[Any]) -> npt.NDArray[Any]:
        baseline_m = self.source.baseline_m or self.camera.baseline_m
        if not (math.isfinite(baseline_m) and baseline_m > 0):
            raise CameraError(
                f"{self.path}: expected the stereo baseline of disparity, found none; give it as "
                "'baseline_m' in the description's depth, or in the camera file"
            )
        if self.camera.distortion is not None:
            raise CameraError(
                f"{self.path}: expected disparity of rectified images, found a camera with "
                f'{self.camera.distortion}; say "distortion": "rectified" of it, or give '
                "--distortion rectified"
            )
        fx = self.source.fx
        if fx is None:
            self._refuse_nominal("disparity", "fx")
            height, width = disparity_px.shape
            fx = self.camera.camera(height, width, self.path.stem).fx
        # Points at infinity have none, and matchers mark what they could not match below 0.
        return np.where(disparity_px > 0, fx * baseline_m / disparity_px, 0)

    def _refuse_nominal(self, what: str, needed: str) -> None:
        if self.camera.origin == "nominal":
            raise CameraError(
                f"{self.path}: expected a calibrated camera for {what}, which depends on its "
                f"{needed}, found a nominal one; give --intrinsics fx,fy,cx,cy or 'camera'"
            )

    def told(self) -> str:
        """Return by what numbers depth was reckoned, for messages."""
        per = {"disparity": "px per unit of disparity", "inverse": "1/m per unit"}
        return f"{self.scale:g} {per.get(self.source.values, 'm per unit')}"

    def step(self) -> str:
        """Return what to do where the unit is plainly another."""
        plain = self.source.in_metres
        if plain and self.scale >= MISTAKEN_SCALE_M:
            return f"{metres_per_unit(self.scale)}, with --depth-scale"
        if plain and self.source.bytes is not None:
            return "turn 'bytes' around in the description, or give the right unit there"
        if plain:
            return "give the right one with --depth-scale"
        return "mend the description's depth"


def scaled(raw: npt.NDArray[Any], scale: float, offset: float) -> npt.NDArray[np.floating[Any]]:
    """Return ``scale * raw + offset``: float32 where that is exact, else float64.

    Dividing by a whole number keeps 1500 mm at exactly 1.5 m; multiplying by 0.001 does not.
    """
    per_unit = round(1 / scale)
    whole = per_unit > 0 and abs(1 / scale - per_unit) < 1e-6 * per_unit
    small = raw.dtype in (np.uint8, np.int8, np.uint16, np.int16, np.float16, np.float32)
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        if whole and small and offset == 0 and per_unit < 1 << 24:
            return raw / np.float32(per_unit)
        numbers = raw.astype(np.float64)
        return (numbers / per_unit if whole else numbers * scale) + offset


def checked_metres(
    metres: npt.NDArray[Any], unit: Unit, *, check_unit: bool
) -> npt.NDArray[np.float32]:
    """Return depth as float32 metres, 0 = none, once it can be depth.

    Parameters
    ----------
    metres : (H, W) floating
        0, NaN and infinity are none, as is what is below 0.1 mm.
    check_unit : bool
        Refuse a median outside `PLAUSIBLE_MEDIAN_M`, and not only where the scale is a mistake.

    Raises
    ------
    DecodeError
        No pixel has depth, one is negative, or the unit is plainly another.
    """
    try:
        depth_m = checked_depth(metres)
    except ArrayError as error:
        step = "or name what means none as 'invalid' in the description"
        raise DecodeError(f"{unit.path}: {error}, {step}") from error
    # Some 20,000 pixels tell the unit as well as all of them, at a hundredth of the time.
    some = depth_m.reshape(-1)[:: max(1, depth_m.size // 20_000)]
    valid = some[some > 0] if some.any() else depth_m[depth_m > 0]
    if valid.size == 0:
        raise DecodeError(f"{unit.path}: expected depth, found no pixel that has any")
    low, high = PLAUSIBLE_MEDIAN_M
    # In float64: the mean of the two in the middle may be beyond float32.
    median = float(np.median(valid.astype(np.float64)))
    check_unit |= unit.scale >= MISTAKEN_SCALE_M
    if check_unit and not low <= median <= high:
        raise DecodeError(
            f"{unit.path}: expected a median depth of {low:g} to {high:g} m, found {median:g} m "
            f"at {unit.told()}; {unit.step()}"
        )
    return depth_m
