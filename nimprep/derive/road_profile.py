"""The disparity transformation: the road's own disparity taken out, so that it becomes flat."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.arrays import unmasked
from nimprep.depth import checked_plane
from nimprep.derive.disparity import baseline_parameters, disparity_of
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.derive.road import find_road, grid_points
from nimprep.errors import ArrayError
from nimprep.kernels.planes import over_profile, under_profile
from nimprep.parallel import run_rows


@dataclass(frozen=True)
class RoadProfile:
    """Describe the disparity that the road alone would have at every pixel (u, v).

    With s = v cos(roll) + u sin(roll), counted from pixel (0, 0), the road's disparity is
    c0 + c1 s + c2 s² within the span, goes on along the tangents beyond it, and is 0 where that
    would be negative: above the road's horizon. A plane has c2 = 0.

    Attributes
    ----------
    roll_deg : float
        Angle of the lines of equal road disparity in the image; positive where the camera's right
        side is the lower one.
    coefficients : (float, float, float)
        c0, c1, c2: pixels of disparity, per pixel, per pixel².
    span : (float, float)
        Least and largest s at which the road was seen, pixels.

    Raises
    ------
    ArrayError
        A number is not finite.
    """

    roll_deg: float
    coefficients: tuple[float, float, float]
    span: tuple[float, float]

    def __post_init__(self) -> None:
        numbers = (self.roll_deg, *self.coefficients, *self.span)
        if len(numbers) != 6 or not all(math.isfinite(n) for n in numbers):
            raise ArrayError(f"profile: expected 6 finite numbers, found {numbers}")

    def road_disparity(self, height: int, width: int) -> npt.NDArray[np.float32]:
        """Return the road's disparity at every pixel, (height, width) float32, pixels."""
        return restore_disparity(np.zeros((height, width), np.float32), self)


def estimate_road_profile(disparity: npt.ArrayLike) -> RoadProfile:
    """Estimate the camera's roll against the road, and the road's disparity along s.

    Parameters
    ----------
    disparity : (H, W) floating array, pixels
        0, NaN, infinity and what is masked = none.

    Returns
    -------
    RoadProfile
        The same for the same image, on any machine up to rounding.

    Raises
    ------
    ArrayError
        No floating (H, W) array; negative values; or no road in it: no plane that
        comes nearer downwards, is rolled by 30 degrees at most and has its horizon at most two
        image heights above the image's middle gets a tenth of the votes.

    Notes
    -----
    A road that is a plane has a disparity linear in u and v; a hill or a dip bends it along s. Of
    1000 planes through three pixels the one is taken that most of about 2000 pixels vote for (see
    `nimprep.kernels.road_fit.best_plane`), where pixels below a plane count against it: no
    road is seen through. Roll and profile are then fitted to some 10000 pixels by least squares,
    over and over to those within 3 standard deviations, estimated by the median deviation. The
    outer quarters of the image count a quarter: the road lies ahead.

    The references search for the roll by golden section over the whole image's squared error, and
    for the profile by dynamic programming in the v-disparity map. Both follow what covers more of
    a row than the road does; the vote does not.

    References
    ----------
    Fan, Ozgunalp, Hosking, Liu and Pitas, "Pothole detection based on disparity transformation and
    road surface modeling", IEEE Transactions on Image Processing 29, 2020.
    Fan, Ozgunalp, Wang, Liu and Pitas, "Rethinking road surface 3-D reconstruction and pothole
    detection: from perspective transformation to disparity map segmentation", IEEE Transactions on
    Cybernetics 52, 2022.
    """
    profile = find_road_profile(checked_plane(disparity, "disparity", "pixels"))
    if profile is None:
        raise ArrayError(
            "disparity: expected a road in it, found none; give a profile where it is known"
        )
    return profile


def find_road_profile(disparity: npt.NDArray[np.float32]) -> RoadProfile | None:
    """Estimate as `estimate_road_profile` does from checked disparity; None = no road."""
    points = grid_points(disparity)
    road = find_road(points, curved=True)
    if road is None:
        return None
    # From the fit's coordinates, in units around the middle, to pixels: s_fit = scale s + shift.
    cosine = 1 / math.hypot(1, road.tilt)
    scale = 1 / (cosine * points.unit)
    shift = -(points.middle[1] + road.tilt * points.middle[0]) / points.unit
    r0, r1, r2 = (float(r) for r in road.levels)
    return RoadProfile(
        roll_deg=math.degrees(math.atan(road.tilt)),
        coefficients=(r0 + (r1 + r2 * shift) * shift, scale * road.slope(shift), scale**2 * r2),
        span=((road.span[0] - shift) / scale, (road.span[1] - shift) / scale),
    )


def transform_disparity(
    disparity: npt.ArrayLike,
    profile: RoadProfile | None = None,
    num_threads: int | None = None,
) -> tuple[npt.NDArray[np.float32], RoadProfile]:
    """Take the road's roll and profile out of disparity, so that the road becomes flat.

    Parameters
    ----------
    disparity : (H, W) floating array, pixels
        0, NaN, infinity and what is masked = none.
    profile : RoadProfile, optional
        None = estimated by `estimate_road_profile`.
    num_threads : int, optional
        None = all cores; 1 = the calling thread alone. The result is the same.

    Returns
    -------
    transformed : (H, W) float32, pixels
        Disparity less the road's: 0 on the road, positive for what is nearer than the road at that
        pixel and so stands above it, negative for potholes; NaN = none. At a height e over a plane
        road it is the disparity times e over the camera's height. The references add a constant to
        make all of it positive; here the road is at 0.
    profile : RoadProfile
        With it `restore_disparity` gives the disparity back.

    Raises
    ------
    ArrayError
        As `estimate_road_profile`.

    References
    ----------
    As `estimate_road_profile`; as an input of networks: Wang, Fan, Sun and Liu, "Dynamic fusion
    module evolves drivable area and road anomaly detection: a benchmark and algorithms", IEEE
    Transactions on Cybernetics 52, 2022.
    """
    values = checked_plane(disparity, "disparity", "pixels")
    found = estimate_road_profile(values) if profile is None else profile
    out = np.empty(values.shape, np.float32)
    turn = _turn(found)

    def run(first: int, last: int) -> None:
        over_profile(values, first, last, turn, found.coefficients, found.span, out)

    run_rows(run, values.shape, num_threads)
    return out, found


def restore_disparity(
    transformed: npt.ArrayLike, profile: RoadProfile, num_threads: int | None = None
) -> npt.NDArray[np.float32]:
    """Put the road's disparity back: the inverse of `transform_disparity`.

    Parameters
    ----------
    transformed : (H, W) floating array, pixels
        NaN, infinity and what is masked = none.
    profile : RoadProfile
        What was taken out.
    num_threads : int, optional
        As there.

    Returns
    -------
    (H, W) float32, pixels
        0 = none, and where less than nothing would be left.

    Raises
    ------
    ArrayError
        No floating (H, W) array.
    """
    values = np.asarray(transformed)
    if values.ndim != 2 or values.size == 0 or not np.issubdtype(values.dtype, np.floating):
        raise ArrayError(
            "transformed: expected a non-empty floating (H, W) array, "
            f"found {values.dtype} {values.shape}"
        )
    # What is beyond float32 becomes infinite there, which is none.
    with np.errstate(over="ignore", under="ignore"):
        values = np.ascontiguousarray(unmasked(transformed, np.nan), dtype=np.float32)
    out = np.empty(values.shape, np.float32)
    turn = _turn(profile)

    def run(first: int, last: int) -> None:
        under_profile(values, first, last, turn, profile.coefficients, profile.span, out)

    run_rows(run, values.shape, num_threads)
    return out


def _turn(profile: RoadProfile) -> tuple[float, float]:
    roll = math.radians(profile.roll_deg)
    return math.cos(roll), math.sin(roll)


def make_transformed_disparity(given: Given) -> Made:
    """Make a frame's transformed disparity; none where it shows no road."""
    disparity = disparity_of(given)
    profile = find_road_profile(disparity)
    if profile is None:
        return Made(None)
    return Made(transform_disparity(disparity, profile, num_threads=1)[0])


def describe_transformed_disparity(recipe: Recipe) -> dict[str, Any]:
    """Return what a store's attributes say of its transformed disparity."""
    meaning = "disparity less that of the road's fitted profile; 0 = on the road"
    parameters = {**baseline_parameters(recipe), "transformed_disparity": meaning}
    return {"method": "road-profile", "parameters": parameters}
