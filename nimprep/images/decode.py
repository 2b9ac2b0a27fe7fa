"""Image files to arrays: colour, depth and labels."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_file, read_start
from nimprep.frame import MAX_PIXELS
from nimprep.images import jpeg, pillow, png
from nimprep.images.array import ArrayHeader, read_array, read_array_header
from nimprep.images.header import MAX_BYTES, ImageHeader, broken, check_header
from nimprep.images.orientation import (
    OrientationRule,
    checked_orientation,
    orientation_of,
    read_orientation,
    turned,
    upright_tiff,
)
from nimprep.images.signatures import NEEDED, unread_format

_FORMATS: dict[bytes, Callable[[bytes, Path], ImageHeader]] = {
    png.SIGNATURE: png.png_header,
    jpeg.SIGNATURE: lambda data, path: jpeg.jpeg_outline(data, path).header,
    **dict.fromkeys(pillow.SIGNATURES, pillow.pillow_header),
}


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes.

    Raises
    ------
    DecodeError
        It cannot be read, is empty, or larger than any image.
    """
    data = read_file(path, MAX_BYTES)
    if not data:
        raise DecodeError(f"{path}: expected an image, found an empty file")
    return data


def image_header(path: Path, orientation: OrientationRule = "apply") -> ImageHeader:
    """Return an image file's size, as it is turned, and kind; a PNG is not read for it.

    Raises
    ------
    DecodeError
        It is no image, is cut short, or claims more than `MAX_PIXELS` pixels.
    """
    start = read_start(path, png.HEADER_BYTES)
    header = _header(start if start.startswith(png.SIGNATURE) else read_bytes(path), path)
    by = checked_orientation(read_orientation(path), orientation, path)
    return header if by < 5 else replace(header, height=header.width, width=header.height)


def _check_shape(header: ArrayHeader, path: Path) -> ArrayHeader:
    shape = header.shape
    if len(shape) not in (2, 3) or not 0 < shape[0] * shape[1] <= MAX_PIXELS:
        raise DecodeError(
            f"{path}: expected an image of 1 to {MAX_PIXELS} pixels, found shape {shape}"
        )
    return header


def _header(data: bytes, path: Path) -> ImageHeader:
    for signature, parse in _FORMATS.items():
        # RIFF holds videos and sounds too.
        if data.startswith(signature) and data[8:12] not in (b"AVI ", b"WAVE"):
            header = parse(data, path)
            check_header(header, path)
            return header
    raise no_image(path, data)


def no_image(path: Path, data: bytes) -> DecodeError:
    """Return the error for a file of another kind; it names the kind where that is known."""
    known = unread_format(data[:NEEDED])
    expected = f"{path}: expected an image (PNG, JPEG, TIFF, BMP, WebP, PNM or .npy), found"
    if known is None:
        return DecodeError(
            f"{expected} {len(data)} bytes that are none; "
            "describe bare numbers by 'raw', or mend the pattern"
        )
    return DecodeError(f"{expected} {known[0]}, which is not read here; {known[1]}")


def read_image(
    path: Path, *, color: bool = False, orientation: OrientationRule = "apply"
) -> npt.NDArray[Any]:
    """Decode an image file as OpenCV does, channels B, G, R, A, or with `color` R, G, B.

    Parameters
    ----------
    orientation : {"apply", "ignore", "refuse"}
        What becomes of an EXIF orientation other than 1.

    Raises
    ------
    DecodeError
        It is damaged, or with `color` has other than 8 bits.
    """
    if path.suffix == ".npy":
        _check_shape(read_array_header(path), path)
        return read_array(path)
    data = read_bytes(path)
    header = _header(data, path)
    if color and header.bits > 8:
        raise DecodeError(f"{path}: expected an 8-bit colour image, found {header}")
    by = checked_orientation(orientation_of(data), orientation, path)
    data = upright_tiff(data)
    if data.startswith(png.SIGNATURE):
        data = png.checked_png(data, path)
    image = _decode(data, path, color=color)
    if image.shape[:2] != (header.height, header.width):
        raise broken(path, "image", f"a header of {header} before pixels of {image.shape[:2]}")
    if data.startswith(jpeg.SIGNATURE) and jpeg.may_be_cut(image):
        _check_jpeg_end(data, image, path, color=color)
    # OpenCV spreads the values of 1, 2 and 4 bits over 0-255.
    few = header.bits < 8 and image.ndim == 2 and image.dtype == np.uint8
    image = image // np.uint8(255 // ((1 << header.bits) - 1)) if few else image
    return turned(image, by)


def _decode(data: bytes, path: Path, *, color: bool) -> npt.NDArray[Any]:
    # OpenCV reads both when it is first imported. Its own log would come before our line.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_PIXELS))
    os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
    import cv2

    # All kinds of file are turned in one way, by `turned`.
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION if color else cv2.IMREAD_UNCHANGED
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise DecodeError(f"{path}: expected an image, found {error.err}") from error
    if image is None:
        raise DecodeError(f"{path}: expected an image, found {len(data)} bytes that are none")
    return np.asarray(image)


def _check_jpeg_end(data: bytes, image: npt.NDArray[Any], path: Path, *, color: bool) -> None:
    longer = jpeg.with_filler(data, jpeg.jpeg_outline(data, path))
    if not np.array_equal(_decode(longer, path, color=color), image):
        raise broken(path, "JPEG", "one whose pixels end before the image does; it was cut")


def read_rgb(path: Path, orientation: OrientationRule = "apply") -> npt.NDArray[np.uint8]:
    """Return a colour image as (H, W, 3) uint8, channels R, G, B.

    Parameters
    ----------
    orientation : {"apply", "ignore", "refuse"}
        What becomes of an EXIF orientation other than 1.

    Raises
    ------
    DecodeError
        It is no 8-bit image, is truncated or damaged.
    """
    return read_image(path, color=True, orientation=orientation)


def read_depth(path: Path) -> npt.NDArray[Any]:
    """Return a depth image's raw values as (H, W), uint16 or floating; NaN and infinity stay.

    PNG, TIFF, PGM and PFM through OpenCV; .npy through NumPy.

    Raises
    ------
    DecodeError
        It has 8 bits (a picture of depth, not depth), several channels, or is damaged.
    """
    image = read_image(path)
    if image.ndim != 2:
        raise DecodeError(
            f"{path}: expected depth of one channel, found {image.shape[2]} channels "
            f"of {image.dtype}; use the dataset's raw depth"
        )
    if image.dtype == np.uint8:
        raise DecodeError(
            f"{path}: expected 16-bit or floating-point depth, found 8-bit; "
            "8-bit depth images are for looking at only, use the raw ones"
        )
    if image.dtype != np.uint16 and not np.issubdtype(image.dtype, np.floating):
        raise DecodeError(
            f"{path}: expected 16-bit unsigned or floating-point depth, found {image.dtype}"
        )
    return image


def read_label(path: Path) -> npt.NDArray[Any]:
    """Return a label image's raw values: (H, W) uint8 or uint16, or (H, W, 3) uint8 R, G, B.

    Raises
    ------
    DecodeError
        It has other values than whole numbers of 8 or 16 bits, or is damaged.
    """
    image = read_image(path)
    if image.dtype not in (np.uint8, np.uint16):
        raise DecodeError(f"{path}: expected an 8-bit or 16-bit label, found {image.dtype}")
    if image.ndim == 3:
        if image.shape[2] < 3 or image.dtype != np.uint8:
            raise DecodeError(
                f"{path}: expected one channel, or three of 8 bits, "
                f"found {image.shape[2]} of {image.dtype}"
            )
        return np.ascontiguousarray(image[:, :, 2::-1])
    return image
