"""Where a reader's camera comes from: a file, the user, or a data sheet."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import D415_HORIZONTAL_FOV_DEG, MAX_BASELINE_M, Camera
from nimprep.errors import CameraError
from nimprep.readers.base import CalibrationOrigin
from nimprep.readers.camera_formats import (
    CameraNumbers,
    CameraTable,
    numbers_from_document,
    numbers_from_file,
)
from nimprep.readers.description import CameraSource, DistortionRule
from nimprep.readers.distortion import Distortion, distortion_from


@dataclass(frozen=True)
class GivenCamera:
    """Give the camera for an image size.

    Attributes
    ----------
    origin : {"file", "user", "nominal"}
    where : str
        The file, or what to call it in a message.
    intrinsics : (fx, fy, cx, cy), pixels, optional
        None = square pixels, the centre in the middle, and a view `fov_deg` wide.
    fov_deg : float, degrees
        The nominal RealSense D415 colour camera's, unless it is said.
    size : (height, width), optional
        The image size the intrinsics hold for; None = not said.
    baseline_m : float
        Stereo baseline, metres; NaN = none.
    distortion : Distortion, optional
        Of the images as they are; None = none.
    scales : bool
        Whether images of another size of the same shape have the intrinsics scaled.
    usual : bool
        Whether the size is no more than usual: images of another shape have the intrinsics as they
        are.
    cam_to_road : 12 numbers, optional
        Transform from the camera frame to the road frame, (3, 4) row by row, metres.
    gravity : 3 numbers, optional
        Direction in the camera frame, pointing down, of any length.
    """

    origin: CalibrationOrigin
    where: str
    intrinsics: tuple[float, float, float, float] | None = None
    size: tuple[int, int] | None = None
    baseline_m: float = math.nan
    distortion: Distortion | None = None
    scales: bool = False
    usual: bool = False
    fov_deg: float = D415_HORIZONTAL_FOV_DEG
    cam_to_road: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None

    def camera(self, height: int, width: int, frame_id: str) -> Camera:
        """Return the camera of a frame of this size.

        Raises
        ------
        CameraError
            The intrinsics belong to another size.
        """
        if self.intrinsics is None:
            return Camera.from_fov(self.fov_deg, width, height)
        if self.size is None or self.size == (height, width):
            return Camera(*self.intrinsics, width=width, height=height)
        alike = same_shape(self.size, (height, width))
        if self.usual and not alike:
            return Camera(*self.intrinsics, width=width, height=height)
        if not (self.scales and alike):
            step = "check the width and height, and the order of the two"
            if alike:
                step = "give --size rgb to have its numbers scaled"
            raise CameraError(
                f"{self.where}: expected a camera of frame {frame_id!r}'s {width}x{height} pixels, "
                f"found one of {self.size[1]}x{self.size[0]}; {step}"
            )
        return Camera(*self.intrinsics, width=self.size[1], height=self.size[0]).resize(
            height, width
        )

    def transform(self) -> npt.NDArray[np.float64] | None:
        """Return `cam_to_road` as (3, 4); None = none."""
        return None if self.cam_to_road is None else np.array(self.cam_to_road).reshape(3, 4)

    def ray_lengths(self, height: int, width: int, frame_id: str) -> npt.NDArray[np.float64]:
        """Return how much longer each pixel's ray is than its depth, as (H, W), read-only.

        Pixels are those of the image as it is, distorted where the lens distorts. Distance along
        the ray over this is depth.
        """
        from nimprep.readers.undistortion import ray_lengths

        return ray_lengths(self.camera(height, width, frame_id), self.distortion)


def same_shape(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether two sizes have one aspect, to a pixel of the smaller."""
    (h, w), (high, wide) = sorted((one, other))
    return abs(wide * h / high - w) <= 1 or abs(high * w / wide - h) <= 1


def nominal_camera() -> GivenCamera:
    """Return the RealSense D415's data-sheet camera: 69.4 degrees wide, square pixels."""
    return GivenCamera("nominal", "the nominal RealSense D415 colour camera (69.4 degrees wide)")


def numbers_of(given: Any) -> tuple[float, ...]:
    """Return (fx, fy, cx, cy) as Python has numbers.

    Raises
    ------
    CameraError
        They are not four numbers.
    """
    try:
        numbers = tuple(float(number) for number in given)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != 4:
        raise CameraError(
            f"camera: expected a file or four numbers, found {given!r}; give (fx, fy, cx, cy)"
        )
    return numbers


def camera_from(
    given: Path | str | tuple[float, float, float, float],
    distortion: DistortionRule | None = None,
) -> GivenCamera:
    """Return the camera that the user gave, by a file or by (fx, fy, cx, cy) in pixels."""
    if isinstance(given, (str, Path)):
        return camera_from_file(Path(given), CameraSource(distortion=distortion or "undistort"))
    Camera(*given, width=1, height=1)
    return GivenCamera("user", "--intrinsics", given)


def camera_from_file(
    path: Path, source: CameraSource | None = None, *, pipes: bool = True
) -> GivenCamera:
    """Read a camera file of any format that `nimprep.readers.camera_formats` knows.

    Parameters
    ----------
    source : CameraSource, optional
        What a description says of it.
    pipes : bool
        Take a pipe too, as the user may name one.

    Raises
    ------
    CameraError
        It is missing, no camera file, or has several cameras.
    """
    source = source or CameraSource()
    found = numbers_from_file(path, source, pipes=pipes)
    if isinstance(found, CameraTable):
        found = found.of({})
    return camera_from_numbers(found, str(path), source)


def camera_from_document(
    document: Any, where: str, source: CameraSource | None = None
) -> GivenCamera:
    """Return the camera of a JSON object, as a camera file would have it.

    Raises
    ------
    CameraError
        It lacks fx, fy, cx or cy, or one is not a number that can be.
    """
    source = source or CameraSource()
    return camera_from_numbers(numbers_from_document(document, where, source), where, source)


def camera_from_numbers(found: CameraNumbers, where: str, source: CameraSource) -> GivenCamera:
    """Return the camera of a file's numbers and what a description says of them.

    Raises
    ------
    CameraError
        A number cannot be, or the two contradict each other.
    """
    numbers = found.intrinsics
    if source.distortion == "rectified" and found.rectified is not None:
        numbers = found.rectified
    # A calibration counted from 1 is brought to ours, where the top-left pixel's centre is (0, 0).
    origin = max(source.pixel_origin, found.pixel_origin)
    numbers = (numbers[0], numbers[1], numbers[2] - origin, numbers[3] - origin)
    try:
        Camera(*numbers, width=1, height=1)
    except CameraError as error:
        raise CameraError(f"{where}: {error}; give the right number") from error
    baseline_m = found.baseline_m if source.baseline_m is None else source.baseline_m
    if baseline_m == 0:
        baseline_m = math.nan
    if not (math.isnan(baseline_m) or 0 < baseline_m <= MAX_BASELINE_M):
        raise CameraError(
            f"{where}: expected a baseline of more than 0 and at most {MAX_BASELINE_M:g} m, found "
            f"{baseline_m:g}; give it as baseline_m in the description"
        )
    size = found.size
    if source.for_size is not None:
        size = (source.for_size[1], source.for_size[0])
        if found.size not in (None, size):
            raise CameraError(
                f"{where}: expected a camera for {size[1]}x{size[0]} pixels as for_size says, "
                f"found one for {found.size[1]}x{found.size[0]}; leave for_size out"
            )
    lens = found.distortion or distortion_from(None, source.coefficients)
    given = GivenCamera(
        "file",
        where,
        numbers,
        size,
        baseline_m,
        lens,
        scales=source.for_size is not None,
        cam_to_road=found.cam_to_road,
        gravity=found.gravity,
    )
    return with_distortion(given, source.distortion)


def with_distortion(given: GivenCamera, what: DistortionRule) -> GivenCamera:
    """Return a camera whose distortion is taken out, refused, or said to be gone.

    Parameters
    ----------
    what : {"undistort", "refuse", "rectified"}

    Raises
    ------
    CameraError
        It is refused, or of a model that is not known.
    """
    if given.distortion is None or what == "rectified":
        return replace(given, distortion=None)
    if what == "refuse":
        raise CameraError(
            f"{given.where}: expected a camera without distortion, found {given.distortion}; "
            "give --distortion undistort, or rectified if the images have none left"
        )
    given.distortion.check(given.where)
    return given
