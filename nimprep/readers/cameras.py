"""Where a reader's camera comes from: a file, the user, or a data sheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nimprep.camera import D415_HORIZONTAL_FOV_DEG, Camera
from nimprep.errors import CameraError
from nimprep.readers.base import CalibrationOrigin
from nimprep.schema import check_json, read_json


@dataclass(frozen=True)
class GivenCamera:
    """Give the camera for an image size.

    Attributes
    ----------
    origin : {"file", "user", "nominal"}
    where : str
        The file, or what to call it in a message.
    intrinsics : (fx, fy, cx, cy), pixels, optional
        None = the nominal RealSense D415 colour camera at the image's size.
    size : (height, width), optional
        The only image size the intrinsics hold for; None = not said.
    baseline_m : float
        Stereo baseline, metres; NaN = none.
    """

    origin: CalibrationOrigin
    where: str
    intrinsics: tuple[float, float, float, float] | None = None
    size: tuple[int, int] | None = None
    baseline_m: float = float("nan")

    def camera(self, height: int, width: int, frame_id: str) -> Camera:
        """Return the camera of a frame of this size.

        Raises
        ------
        CameraError
            The intrinsics belong to another size.
        """
        if self.intrinsics is None:
            return Camera.from_fov(D415_HORIZONTAL_FOV_DEG, width, height)
        if self.size is not None and self.size != (height, width):
            raise CameraError(
                f"{self.where}: expected a camera of frame {frame_id!r}'s {width}x{height} pixels, "
                f"found one of {self.size[1]}x{self.size[0]}"
            )
        return Camera(*self.intrinsics, width=width, height=height)


def nominal_camera() -> GivenCamera:
    """Return the RealSense D415's data-sheet camera: 69.4 degrees wide, square pixels."""
    return GivenCamera("nominal", "nominal RealSense D415")


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


def camera_from(given: Path | str | tuple[float, float, float, float]) -> GivenCamera:
    """Return the camera that the user gave, by a file or by (fx, fy, cx, cy) in pixels."""
    if isinstance(given, (str, Path)):
        return camera_from_file(Path(given))
    Camera(*given, width=1, height=1)
    return GivenCamera("user", "--intrinsics", given)


def camera_from_file(path: Path, *, pipes: bool = True) -> GivenCamera:
    """Read a camera file (schemas/camera.schema.json).

    Parameters
    ----------
    pipes : bool
        Take a pipe too, as the user may name one.

    Raises
    ------
    CameraError
        It is missing, no JSON, or no camera.
    """
    return camera_from_document(read_json(path, CameraError, pipes=pipes), str(path))


def camera_from_document(document: Any, where: str) -> GivenCamera:
    """Return the camera of a JSON object (schemas/camera.schema.json).

    Raises
    ------
    CameraError
        It lacks fx, fy, cx or cy, or one is not a number that can be.
    """
    check_json(document, "camera", where, CameraError)
    # A calibration counted from 1 is brought to ours, where the top-left pixel's centre is (0, 0).
    origin = document.get("pixel_origin", 0)
    numbers = (
        float(document["fx"]),
        float(document["fy"]),
        float(document["cx"]) - origin,
        float(document["cy"]) - origin,
    )
    try:
        Camera(*numbers, width=1, height=1)
    except CameraError as error:
        raise CameraError(f"{where}: {error}") from error
    size = (int(document["height"]), int(document["width"])) if "width" in document else None
    return GivenCamera("file", where, numbers, size, float(document.get("baseline_m", "nan")))
