"""The benchmark's bird's-eye view: the road's plane seen from above, 5 cm a pixel."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from nimprep.arrays import without_mask
from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.kitti.calibration import Calibration, frame_shape, read_calibration

BEV_SHAPE = (800, 400)
"""(height, width) of the view: z 46 m (top) to 6 m, x -10 m (left) to 10 m."""

METRES_PER_PIXEL = 0.05

_LEFT_M = -10.0
_TOP_M = 46.0

Pixel = TypeVar("Pixel", bound=np.generic)


def _pixel_centres() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return x (400,) and z (800,) of the pixel centres, metres.

    Through float32 and back: the official images are reproduced to the last pixel that way, where
    exact values would send 3 pixels of one frame to the neighbour.
    """
    rows, columns = BEV_SHAPE
    x = _LEFT_M + (np.arange(columns) + 0.5) * METRES_PER_PIXEL
    z = _TOP_M - (np.arange(rows) + 0.5) * METRES_PER_PIXEL
    return x.astype(np.float32).astype(np.float64), z.astype(np.float32).astype(np.float64)


_X_M, _Z_M = _pixel_centres()


def bev_lookup(
    road_to_image: npt.NDArray[np.float64], height: int, width: int
) -> npt.NDArray[np.int32]:
    """Return which image pixel each pixel of the bird's-eye view shows.

    The official transform counts image pixels from 1, takes those whose projection lies in
    [1, width] x [1, height], and cuts the fraction off.

    Parameters
    ----------
    road_to_image : (3, 3) float64
        From (x, z, 1) on the road, metres, to image pixels times w.
    height, width : int
        The image's size.

    Returns
    -------
    (800, 400) int32
        row * width + column, both from 0; -1 = outside the image.
    """
    h = np.asarray(road_to_image, dtype=np.float64)
    across = h[:, :1] * _X_M
    along = h[:, 1:2] * _Z_M + h[:, 2:]
    u, v, w = (across[i][None, :] + along[i][:, None] for i in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        u /= w
        v /= w
        inside = (w > 0) & (u >= 1) & (u <= width) & (v >= 1) & (v <= height)
    column = np.where(inside, u, 1).astype(np.int32) - 1
    row = np.where(inside, v, 1).astype(np.int32) - 1
    return np.where(inside, row * np.int32(width) + column, np.int32(-1))


@lru_cache(maxsize=8)
def _shared_lookup(road_to_image: bytes, height: int, width: int) -> npt.NDArray[np.int32]:
    """Keep the last few lookups: a prediction and its ground truth share one."""
    lookup = bev_lookup(np.frombuffer(road_to_image).reshape(3, 3), height, width)
    lookup.flags.writeable = False
    return lookup


def transform_to_bev(image: npt.NDArray[Pixel], calibration: Calibration) -> npt.NDArray[Pixel]:
    """Return an image of the image_2 camera as the benchmark's bird's-eye view.

    Equal to the official transform, pixel by pixel, nearest neighbour: good for confidence maps,
    ground truths and photographs alike.

    Parameters
    ----------
    image : (H, W) or (H, W, C)
        Any dtype.
    calibration : Calibration
        With P2, R0_rect and Tr_cam_to_road.

    Returns
    -------
    (800, 400) or (800, 400, C), dtype of the image
        Top row farthest; 0 where the camera does not see.

    Raises
    ------
    ArrayError
        The image has another number of axes, is empty, or has masked pixels.
    DecodeError
        The calibration lacks a matrix.
    """
    array: npt.NDArray[Any] = without_mask(image, "image")
    if array.ndim not in (2, 3) or array.size == 0:
        raise ArrayError(f"image: expected (H, W) or (H, W, C), found shape {array.shape}")
    height, width = array.shape[:2]
    lookup = _shared_lookup(calibration.road_to_image.tobytes(), height, width)
    pixels = array.reshape(height * width, *array.shape[2:])
    view = pixels[lookup]
    view[lookup < 0] = 0
    return view


def is_bev(shape: tuple[int, ...]) -> bool:
    """Tell whether an image of this shape is taken to be a bird's-eye view already."""
    return tuple(shape[:2]) == BEV_SHAPE


def bring_to_bev(
    image: npt.NDArray[Pixel], path: Path, calib: Path | None, frame: str
) -> npt.NDArray[Pixel]:
    """Return a file's image in the bird's-eye view; as it is where it is there already.

    Parameters
    ----------
    image : (H, W) or (H, W, C)
        What `path` holds.
    path : Path
        For messages.
    calib : Path or None
        The folder of calibrations; None = not given.
    frame : str
        ``um_000000``.

    Raises
    ------
    LayoutError
        It needs a calibration and there is none.
    DecodeError
        The calibration is bad, or the image has another size than its calibration's frame.
    """
    if is_bev(image.shape):
        return image
    calibration = frame_calibration(calib, frame, path)
    check_size(image.shape, path, calibration)
    return transform_to_bev(image, calibration)


def check_size(shape: tuple[int, ...], path: Path, calibration: Calibration) -> None:
    """Raise `DecodeError` where an image has another size than its calibration's frame."""
    expected = frame_shape(calibration)
    height, width = shape[:2]
    if expected is not None and expected != (height, width):
        raise DecodeError(
            f"{path}: expected {expected[1]}x{expected[0]} pixels, the size of "
            f"{calibration.path}'s frame, found {width}x{height}"
        )


def frame_calibration(calib: Path | None, frame: str, needed_by: Path) -> Calibration:
    """Read a frame's calibration from a folder of them.

    Raises
    ------
    LayoutError
        There is no folder, or no file of this frame in it.
    DecodeError
        The file is bad.
    """
    if calib is None:
        raise LayoutError(
            f"{needed_by}: expected a calibration to transform it to the bird's-eye view, "
            "found none; give --calib DIR"
        )
    path = calib / f"{frame}.txt"
    if not path.is_file():
        raise LayoutError(
            f"{path}: expected the calibration of {needed_by.name}, found none; "
            "--calib is the dataset's folder calib/"
        )
    return read_calibration(path)
