"""Taking a lens's distortion out of images, with the camera's matrix as it is.

The distorted place of a pinhole's pixel is that of OpenCV's models: Brown-Conrady with rational,
prism and tilt terms (``cv2.projectPoints``), and Kannala-Brandt (``cv2.fisheye.projectPoints``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.readers.distortion import Distortion

_KEPT_PIXELS = 1 << 22
"""Maps of images up to so many pixels are kept: 36 MiB each, two of them."""

_STEPS = 4096


@dataclass(frozen=True, eq=False)
class PixelMap:
    """Say where in a distorted image each pixel of the undistorted one is.

    Attributes
    ----------
    u, v : (H, W) float32, pixels
    inside : (H, W) bool
        False where the distorted image has no such place.
    """

    u: npt.NDArray[np.float32]
    v: npt.NDArray[np.float32]
    inside: npt.NDArray[np.bool_]


def pixel_map(camera: Camera, lens: Distortion) -> PixelMap:
    """Return where each of a pinhole's pixels is in the image through a lens, of the same size."""
    if camera.width * camera.height > _KEPT_PIXELS:
        return _pixel_map(camera, lens)
    return _kept(camera, lens)


@lru_cache(maxsize=2)
def _kept(camera: Camera, lens: Distortion) -> PixelMap:
    return _pixel_map(camera, lens)


def _pixel_map(camera: Camera, lens: Distortion) -> PixelMap:
    import cv2

    k, numbers = camera.matrix, np.array(lens.coefficients)
    size = (camera.width, camera.height)
    models: Any = cv2.fisheye if lens.model == "fisheye" else cv2
    u, v = models.initUndistortRectifyMap(k, numbers, np.eye(3), k, size, cv2.CV_32FC1)
    inside = (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)
    rows, columns = np.ogrid[: camera.height, : camera.width]
    x, y = (columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy
    # Beyond where the polynomial turns back, a lens shows nothing of what it says.
    squared = (x * x + y * y).astype(np.float32)
    inside &= squared < _turning_radius(lens, float(np.sqrt(squared.max()))) ** 2
    for array in (u, v, inside):
        array.flags.writeable = False
    return PixelMap(u, v, inside)


def _turning_radius(lens: Distortion, most: float) -> float:
    """Return the least radius at which points no longer move outwards; infinity = none up to most.

    By the radial terms, at z = 1.
    """
    r = np.linspace(0, most * 1.01, _STEPS)
    d = (*lens.coefficients, *[0.0] * 8)
    with np.errstate(all="ignore"):
        if lens.model == "fisheye":
            t = np.arctan(r)
            moved = t * (1 + t**2 * (d[0] + t**2 * (d[1] + t**2 * (d[2] + t**2 * d[3]))))
        else:
            s = r * r
            up = 1 + s * (d[0] + s * (d[1] + s * d[4]))
            moved = r * up / (1 + s * (d[5] + s * (d[6] + s * d[7])))
    back = ~(np.diff(moved) > 0)
    return float(r[int(np.argmax(back))]) if back.any() else float("inf")


def rays(
    camera: Camera, lens: Distortion | None
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return x and y at z = 1, each (H, W), of what an image's pixels show through a lens."""
    import cv2

    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    if lens is None:
        return (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    points = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    numbers = np.array(lens.coefficients)
    models: Any = cv2.fisheye if lens.model == "fisheye" else cv2
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    found = models.undistortPoints(points, camera.matrix, numbers, criteria=stop)
    x, y = found.reshape(camera.height, camera.width, 2).transpose(2, 0, 1)
    return x, y


def ray_lengths(camera: Camera, lens: Distortion | None) -> npt.NDArray[np.float64]:
    """Return how much longer than its depth the ray of each pixel is, (H, W), not to be written."""
    if camera.width * camera.height > _KEPT_PIXELS:
        return _ray_lengths(camera, lens)
    return _kept_lengths(camera, lens)


@lru_cache(maxsize=2)
def _kept_lengths(camera: Camera, lens: Distortion | None) -> npt.NDArray[np.float64]:
    lengths = _ray_lengths(camera, lens)
    lengths.flags.writeable = False
    return lengths


def _ray_lengths(camera: Camera, lens: Distortion | None) -> npt.NDArray[np.float64]:
    x, y = rays(camera, lens)
    return np.sqrt(1 + x * x + y * y)


def without_border(camera: Camera, lens: Distortion) -> float:
    """Return the share of an undistorted image's pixels that the distorted one does not show."""
    return 1 - float(np.mean(pixel_map(camera, lens).inside))


def undistorted_colors(image: npt.NDArray[Any], where: PixelMap) -> npt.NDArray[Any]:
    """Return a colour image without distortion, linear between pixels, 0 where there is none."""
    import cv2

    found: npt.NDArray[Any] = cv2.remap(
        np.ascontiguousarray(image), where.u, where.v, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE
    )
    found[~where.inside] = 0
    return found


def nearest_through(image: npt.NDArray[Any], where: PixelMap, fill: float) -> npt.NDArray[Any]:
    """Return an image without distortion by the nearest pixel, `fill` where there is none.

    The image may be of another size than the map: their outer edges are then aligned, so that it is
    resized and undistorted in one step.
    """
    height, width = image.shape[:2]
    rows, columns = where.inside.shape
    u, v = ((where.u + 0.5) * (width / columns), (where.v + 0.5) * (height / rows))
    # What lies beyond is replaced; until then it must be a number that a place can be.
    at_u = np.clip(u, 0, width - 1).astype(np.intp)
    at_v = np.clip(v, 0, height - 1).astype(np.intp)
    found: npt.NDArray[Any] = image[at_v, at_u]
    found[~where.inside] = fill
    return found
