"""Decode one image file, with every doubt about it turned into a `DecodeError`."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.frame import MAX_PIXELS

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_KINDS = {0: "grey", 2: "RGB", 3: "palette", 4: "grey with alpha", 6: "RGBA"}


@dataclass(frozen=True)
class ImageHeader:
    """Tell what an image file says of itself, before any pixel is decoded."""

    height: int
    width: int
    bits: int
    kind: str

    def __str__(self) -> str:
        return f"{self.width}x{self.height} {self.bits}-bit {self.kind}"


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes.

    Raises
    ------
    DecodeError
        It cannot be read, or is empty.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DecodeError(f"{path}: expected a readable file, found {error.strerror}") from error
    if not data:
        raise DecodeError(f"{path}: expected an image, found an empty file")
    return data


def read_header(path: Path) -> ImageHeader:
    """Return an image file's size and kind; for PNG and .npy from its first bytes alone.

    Raises
    ------
    DecodeError
        It is no image, or claims more than `MAX_PIXELS` pixels.
    """
    try:
        with path.open("rb") as file:
            start = file.read(33)
    except OSError as error:
        raise DecodeError(f"{path}: expected a readable file, found {error.strerror}") from error
    if start.startswith(_PNG_SIGNATURE):
        return _png_header(start, path)
    if path.suffix == ".npy":
        array = _load_npy(path)
        return ImageHeader(array.shape[0], array.shape[1], 8 * array.dtype.itemsize, "array")
    image = _decode(read_bytes(path), path, color=False)
    kind = "grey" if image.ndim == 2 else f"{image.shape[2]}-channel"
    return ImageHeader(image.shape[0], image.shape[1], 8 * image.dtype.itemsize, kind)


def _png_header(data: bytes, path: Path) -> ImageHeader:
    if len(data) < 29 or data[12:16] != b"IHDR":
        raise DecodeError(f"{path}: expected a PNG with a header, found a truncated file")
    width, height, bits, kind = struct.unpack(">IIBB", data[16:26])
    header = ImageHeader(height, width, bits, _PNG_KINDS.get(kind, f"kind {kind}"))
    if kind not in _PNG_KINDS or not 0 < width * height <= MAX_PIXELS:
        raise DecodeError(
            f"{path}: expected an image of 1 to {MAX_PIXELS} pixels, found a header of {header}"
        )
    return header


def _check_png_chunks(data: bytes, path: Path) -> None:
    """Walk the chunks to IEND: a cut or damaged file is told apart before libpng complains."""
    view, position = memoryview(data), len(_PNG_SIGNATURE)
    while True:
        if position + 12 > len(view):
            raise DecodeError(
                f"{path}: expected a whole PNG, found it truncated after {len(data)} bytes"
            )
        (length,) = struct.unpack_from(">I", view, position)
        body = view[position + 4 : position + 8 + length]
        check = view[position + 8 + length : position + 12 + length]
        if len(check) < 4:
            raise DecodeError(
                f"{path}: expected a whole PNG, found it truncated after {len(data)} bytes"
            )
        if zlib.crc32(body) != int.from_bytes(check, "big"):
            raise DecodeError(
                f"{path}: expected an undamaged PNG, found a wrong checksum at byte {position}"
            )
        if bytes(body[:4]) == b"IEND":
            return
        position += 12 + length


def _load_npy(path: Path) -> npt.NDArray[Any]:
    try:
        array: npt.NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    # NumPy parses the header as Python and raises what the parser raises.
    except (OSError, ValueError, EOFError, SyntaxError, TypeError, OverflowError, TokenError) as e:
        raise DecodeError(f"{path}: expected a NumPy array file, found {e}") from e
    if not isinstance(array, np.ndarray):
        raise DecodeError(f"{path}: expected a NumPy array file, found an archive of several")
    if array.ndim < 2 or not 0 < array.shape[0] * array.shape[1] <= MAX_PIXELS:
        raise DecodeError(
            f"{path}: expected an image of 1 to {MAX_PIXELS} pixels, found shape {array.shape}"
        )
    return array


def _decode(data: bytes, path: Path, *, color: bool) -> npt.NDArray[Any]:
    # Read when OpenCV is first imported: formats whose header is not parsed here obey it too.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_PIXELS))
    import cv2

    if data.startswith(_PNG_SIGNATURE):
        _png_header(data, path)
        _check_png_chunks(data, path)
    elif data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-64:]:
        raise DecodeError(
            f"{path}: expected a whole JPEG, found it truncated after {len(data)} bytes"
        )
    # The camera belongs to the stored pixels, so an orientation tag must not turn them.
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION if color else cv2.IMREAD_UNCHANGED
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise DecodeError(f"{path}: expected an image, found {error.err}") from error
    if image is None:
        raise DecodeError(f"{path}: expected an image, found {len(data)} bytes that are none")
    return np.asarray(image)


def read_rgb(path: Path) -> npt.NDArray[np.uint8]:
    """Return a colour image as (H, W, 3) uint8, channels R, G, B.

    Raises
    ------
    DecodeError
        It is no 8-bit image, is truncated or damaged.
    """
    data = read_bytes(path)
    if data.startswith(_PNG_SIGNATURE):
        header = _png_header(data[:33], path)
        if header.bits != 8:
            raise DecodeError(f"{path}: expected an 8-bit colour image, found {header}")
    return _decode(data, path, color=True)


def read_depth(path: Path) -> npt.NDArray[Any]:
    """Return a depth image's raw values as (H, W), uint16 or floating.

    PNG and TIFF through OpenCV; .npy through NumPy.

    Raises
    ------
    DecodeError
        It has 8 bits (a picture of depth, not depth), several channels, or is damaged.
    """
    if path.suffix == ".npy":
        image = np.ascontiguousarray(_load_npy(path))
    else:
        image = _decode(read_bytes(path), path, color=False)
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
    if path.suffix == ".npy":
        image = np.ascontiguousarray(_load_npy(path))
    else:
        image = _decode(read_bytes(path), path, color=False)
    if image.dtype not in (np.uint8, np.uint16):
        raise DecodeError(f"{path}: expected an 8-bit or 16-bit label, found {image.dtype}")
    if image.ndim == 3:
        if image.shape[2] < 3 or image.dtype != np.uint8:
            raise DecodeError(
                f"{path}: expected one channel, or three of 8 bits, "
                f"found {image.shape[2]} of {image.dtype}"
            )
        return np.ascontiguousarray(image[:, :, 2::-1])
    return _unscaled(image, path)


def _unscaled(image: npt.NDArray[Any], path: Path) -> npt.NDArray[Any]:
    """Return the values of a PNG of 1, 2 or 4 bits, which OpenCV spreads over 0-255."""
    if path.suffix == ".npy":
        return image
    bits = read_header(path).bits
    return image // np.uint8(255 // ((1 << bits) - 1)) if bits < 8 else image
