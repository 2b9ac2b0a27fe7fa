"""The images of one frame brought to one size and one camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import CameraError, DecodeError
from nimprep.images import read_header
from nimprep.modality import MODALITIES
from nimprep.readers.cameras import GivenCamera, same_shape
from nimprep.readers.depth_warp import warped_depth
from nimprep.readers.description import DepthSource, Description
from nimprep.readers.frames import check_same_shape
from nimprep.readers.matching import Place
from nimprep.readers.resizing import resized_colors, resized_linear, resized_nearest
from nimprep.readers.undistortion import (
    PixelMap,
    nearest_through,
    pixel_map,
    undistorted_colors,
)

Image = npt.NDArray[Any]


@dataclass(frozen=True)
class Registered:
    """Hold a frame's images of one size, and the camera of them all.

    Attributes
    ----------
    images : mapping of kind of image to array
        Depth in metres.
    camera : Camera
    """

    images: Mapping[str, Image]
    camera: Camera


@dataclass(frozen=True)
class Cameras:
    """Hold a frame's cameras.

    Attributes
    ----------
    camera : GivenCamera
        Of all its images, as `camera_of_sizes` returns it.
    depth : GivenCamera, optional
        Of depth, where it is another; depth is then warped.
    """

    camera: GivenCamera
    depth: GivenCamera | None = None


def registered(
    frame_id: str,
    images: Mapping[str, Image],
    places: Mapping[str, Place],
    cameras: Cameras,
    description: Description,
) -> Registered:
    """Bring a frame's images to one size and one camera, and take distortion out.

    Raises
    ------
    DecodeError
        They differ in size, and the description does not say that they are registered.
    CameraError
        The camera is of another size.
    """
    apart = {"depth"} & {*images} if cameras.depth is not None else set()
    together = {name: image for name, image in images.items() if name not in apart}
    if description.size is None and together:
        _check_one_size(together, places)
        height, width = next(iter(together.values())).shape[:2]
    else:
        height, width = registered_shape(places, description)
        for name, image in together.items():
            _check_aspect(image.shape[:2], (height, width), places[name])
    camera, lens = cameras.camera.camera(height, width, frame_id), cameras.camera.distortion
    where = pixel_map(camera, lens) if lens is not None and together else None
    shape = camera.shape
    found = {n: _brought(n, image, shape, where, description) for n, image in together.items()}
    if cameras.depth is not None and description.depth is not None:
        for name in apart:
            found[name] = _warped(images[name], cameras.depth, description.depth, camera, frame_id)
    return Registered(found, camera)


def _warped(
    depth_m: Image, given: GivenCamera, source: DepthSource, camera: Camera, frame_id: str
) -> Image:
    """Return depth of a camera of its own as colour's sees it, without either's distortion."""
    height, width = depth_m.shape
    own = given.camera(height, width, frame_id)
    if given.distortion is not None:
        depth_m = nearest_through(depth_m, pixel_map(own, given.distortion), 0)
    return warped_depth(depth_m, own, source.depth_to_rgb or (), camera)


def registered_shape(places: Mapping[str, Place], description: Description) -> tuple[int, int]:
    """Return the (height, width) that a frame's images are brought to, from headers alone.

    Raises
    ------
    DecodeError
        A header is damaged, or the frame lacks the image whose size is to be had.
    """
    if isinstance(description.size, tuple):
        return description.size[1], description.size[0]
    names = ["rgb"] if _is_apart(description) else ["depth", "rgb", *places]
    first: str = next((name for name in names if name in places), "rgb")
    wanted: str = first if description.size is None else description.size
    if wanted not in places:
        there = next(iter(places.values()))
        raise DecodeError(
            f"{there.path}: expected {wanted} beside it, to be brought to its size, found none; "
            "give --size WxH, or leave such frames out by 'missing' in the description"
        )
    return _size(wanted, places, description)


def _is_apart(description: Description) -> bool:
    """Return whether depth is no image of colour's camera: of another, or points."""
    depth = description.depth
    return depth is not None and (depth.camera is not None or depth.of_points)


def camera_of_sizes(
    camera: GivenCamera, places: Mapping[str, Place], description: Description
) -> GivenCamera:
    """Return a frame's camera, with the size that its numbers hold for where images are resized.

    Raises
    ------
    CameraError
        The images differ in size, and the camera does not say to which it belongs.
    """
    if description.size is None or camera.intrinsics is None:
        return camera
    if camera.size is not None:
        return replace(camera, scales=True)
    names = ("rgb",) if _is_apart(description) else ("rgb", "depth")
    sizes = {name: _size(name, places, description) for name in names if name in places}
    if len(set(sizes.values())) > 1:
        said = ", ".join(f"{name} of {w}x{h}" for name, (h, w) in sizes.items())
        raise CameraError(
            f"{camera.where}: expected a camera that says its width and height, found none with "
            f"{said} pixels; give them in the file, or as the description's camera.for_size"
        )
    if not sizes:
        return camera
    return replace(camera, size=next(iter(sizes.values())), scales=True)


def _size(name: str, places: Mapping[str, Place], description: Description) -> tuple[int, int]:
    header = read_header(places[name].path, dict(description.sources())[name].layout)
    return header.height, header.width


def _check_one_size(images: Mapping[str, Image], places: Mapping[str, Place]) -> None:
    try:
        check_same_shape({places[name].path: image for name, image in images.items()})
    except DecodeError as error:
        raise DecodeError(
            f"{error}; if they are registered, give --size rgb or --size depth"
        ) from error


def _check_aspect(found: tuple[int, int], wanted: tuple[int, int], place: Place) -> None:
    if not same_shape(found, wanted):
        (h, w), (height, width) = found, wanted
        raise DecodeError(
            f"{place.path}: expected pixels to bring to {width}x{height}, found {w}x{h}, which is "
            "of another aspect by more than a pixel; give depth.camera and depth_to_rgb in the "
            "description, or crop the images"
        )


def _brought(
    name: str, image: Image, shape: tuple[int, int], where: PixelMap | None, described: Description
) -> Image:
    """Return one image resized and undistorted, the way its kind is."""
    plane = described.planes.get(name)
    if plane is None and MODALITIES[name].values == "colors":
        made = resized_colors(image, *shape)
        return made if where is None else undistorted_colors(made, where)
    fill: float = 0 if plane is None else plane.fill or 0
    if plane is None:
        fill = MODALITIES[name].fill
    elif np.issubdtype(image.dtype, np.floating):
        fill = np.nan
    if where is not None:
        # From the image as large as it is: the nearest pixel of the nearest would be further away.
        return nearest_through(image, where, fill)
    if plane is not None and plane.resize == "linear":
        return resized_linear(image, *shape, None)
    return resized_nearest(image, *shape)
