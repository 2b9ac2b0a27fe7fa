"""The images of one frame brought to one size and one camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.images import read_header
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.description import Description
from nimprep.readers.frames import check_same_shape
from nimprep.readers.matching import Place


@dataclass(frozen=True)
class Registered:
    """Hold a frame's images of one size, and the camera of them all.

    Attributes
    ----------
    images : mapping of kind of image to array
        Depth in metres.
    camera : Camera
    """

    images: Mapping[str, npt.NDArray[Any]]
    camera: Camera


def registered(
    frame_id: str,
    images: Mapping[str, npt.NDArray[Any]],
    places: Mapping[str, Place],
    camera: GivenCamera,
    description: Description,
) -> Registered:
    """Bring a frame's images to one size and one camera.

    Raises
    ------
    DecodeError
        They differ in size, and the description does not say that they are registered.
    """
    check_same_shape({places[name].path: image for name, image in images.items()})
    height, width = next(iter(images.values())).shape[:2]
    return Registered(images, camera.camera(height, width, frame_id))


def registered_shape(places: Mapping[str, Place], description: Description) -> tuple[int, int]:
    """Return the (height, width) that a frame's images are brought to, from headers alone."""
    name = "depth" if "depth" in places else "rgb"
    header = read_header(places[name].path, dict(description.sources())[name].layout)
    return header.height, header.width
