"""NumPy files of plain numbers, and bare numbers whose shape is described.

The header is matched, not evaluated as Python, and the file must hold what the header claims before
memory is taken for it. Arrays are read, not mapped: a mapped file that is cut meanwhile ends the
process.

Source: numpy.lib.format, versions 1.0 and 2.0.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import open_plain
from nimprep.images.header import MAX_BYTES
from nimprep.images.layout import Layout, Raw

SIGNATURE = b"\x93NUMPY"
_LONGEST_HEADER = 1 << 16
_DTYPE = re.compile(r"'descr' *: *'([<>|=]?[?biufc]\d{0,2})'")
_ORDER = re.compile(r"'fortran_order' *: *(True|False)")
_SHAPE = re.compile(r"'shape' *: *\(([\d, ]*)\)")


@dataclass(frozen=True)
class ArrayHeader:
    """Tell what a file's array is.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
    by_columns : bool
        Whether the first index changes fastest.
    start : int
        Where its numbers begin, bytes.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    by_columns: bool = False
    start: int = 0

    def part(self, axis: int | None) -> tuple[tuple[int, ...], bool]:
        """Return the shape of what is read for one frame, and whether it lies in one piece."""
        slowest = len(self.shape) - 1 if self.by_columns else 0
        if axis is None or axis != slowest:
            return self.shape, False
        return self.shape[:axis] + self.shape[axis + 1 :], True


def read_array_header(path: Path) -> ArrayHeader:
    """Return what a .npy file says of itself.

    Raises
    ------
    DecodeError
        It is none, holds other things than numbers, or less than it claims.
    """
    with open_plain(path, "a NumPy array file") as (file, size):
        return parse_header(file, size, path)


def read_array(path: Path) -> npt.NDArray[Any]:
    """Return the array of a .npy file, C-contiguous, in the machine's byte order.

    Raises
    ------
    DecodeError
        It is none, holds other things than numbers, or is cut short.
    """
    with open_plain(path, "a NumPy array file") as (file, size):
        return read_part(file, parse_header(file, size, path), path)


def read_array_part(path: Path, axis: int | None, index: int | None) -> npt.NDArray[Any]:
    """Return an array of a .npy file at an index of an axis, like `read_array`."""
    with open_plain(path, "a NumPy array file") as (file, size):
        return read_part(file, parse_header(file, size, path), path, axis, index)


def read_part(
    file: BinaryIO,
    header: ArrayHeader,
    path: Path,
    axis: int | None = None,
    index: int | None = None,
) -> npt.NDArray[Any]:
    """Return numbers that lie in a plain file: all, or those at an index of an axis.

    Raises
    ------
    DecodeError
        They are more than memory should be spent on, or not all there.
    """
    shape, in_place = header.part(axis)
    count = checked_count(header, axis, path)
    file.seek(header.start + (index or 0) * count * header.dtype.itemsize * in_place)
    flat = np.fromfile(file, header.dtype, count)
    if flat.size != count:
        raise wrong(path, f"one truncated after {flat.size} of {count} numbers")
    return ordered(flat, header, shape, None if in_place else axis, index)


def checked_count(header: ArrayHeader, axis: int | None, path: Path) -> int:
    """Return how many numbers are read for a frame.

    Raises
    ------
    DecodeError
        They are more than memory should be spent on.
    """
    count = math.prod(header.part(axis)[0])
    if count * header.dtype.itemsize > MAX_BYTES:
        raise wrong(path, f"{header.shape} of {header.dtype}, more than is read at once")
    return count


def ordered(
    flat: npt.NDArray[Any],
    header: ArrayHeader,
    shape: tuple[int, ...],
    axis: int | None,
    index: int | None,
) -> npt.NDArray[Any]:
    """Return numbers as they lie in a file as an array in the machine's order, or a part of it."""
    flat = flat.astype(header.dtype.newbyteorder("="), copy=False)
    array = flat.reshape(shape[::-1]).T if header.by_columns else flat.reshape(shape)
    if axis is not None and index is not None:
        array = array.take(index, axis)
    return np.ascontiguousarray(array)


def parse_header(file: BinaryIO, size: int, path: Path) -> ArrayHeader:
    """Return what the next bytes of a file say of the array after them.

    Parameters
    ----------
    size : int
        Of header and numbers, bytes.
    """
    start = file.read(12)
    if start[:6] != SIGNATURE or len(start) < 12 or start[6] not in (1, 2):
        raise wrong(path, "another kind of file")
    wide = 2 if start[6] == 1 else 4
    length = int.from_bytes(start[8 : 8 + wide], "little")
    rest = 12 - 8 - wide
    more = file.read(max(min(length, _LONGEST_HEADER) - rest, 0))
    text = (start[8 + wide :] + more)[:length].decode("latin-1")
    found = [pattern.search(text) for pattern in (_DTYPE, _ORDER, _SHAPE)]
    if len(text) != length or not all(found):
        raise wrong(path, "objects, records or a header that is none")
    descr, order, shape_text = (match[1] for match in found if match)
    try:
        dtype = np.dtype(descr)
    except TypeError as error:
        raise wrong(path, f"numbers of type {descr!r}") from error
    shape = tuple(int(n) for n in shape_text.replace(",", " ").split())
    begin = 8 + wide + length
    if len(shape) > 8 or math.prod(shape) * dtype.itemsize > size - begin:
        raise wrong(path, f"{shape} of {dtype}, more than its {size} bytes")
    return ArrayHeader(shape, dtype, order == "True", begin)


def read_raw_header(path: Path, raw: Raw, layout: Layout) -> ArrayHeader:
    """Return what a file of bare numbers holds by its description.

    Raises
    ------
    DecodeError
        It has another size.
    """
    with open_plain(path, "a file of bare numbers") as (_, size):
        return _described(size, raw, layout, path)


def read_raw_part(
    path: Path, raw: Raw, layout: Layout, axis: int | None, index: int | None
) -> npt.NDArray[Any]:
    """Return bare numbers as an array, or those at an index of an axis.

    Raises
    ------
    DecodeError
        The file has another size than described.
    """
    with open_plain(path, "a file of bare numbers") as (file, size):
        return read_part(file, _described(size, raw, layout, path), path, axis, index)


def raw_axes(raw: Raw, axes: str | None) -> str:
    """Return the axes of bare numbers: by default row by row, a pixel's channels together."""
    return axes or ("HW" if raw.channels == 1 else "HWC")


def _described(size: int, raw: Raw, layout: Layout, path: Path) -> ArrayHeader:
    turned = layout.byte_order in ("big", "swapped")
    dtype = np.dtype(raw.dtype).newbyteorder(">" if turned else "<")
    one = raw.width * raw.height * raw.channels * dtype.itemsize
    axes, there = raw_axes(raw, layout.axes), size - raw.header_bytes
    if raw.channels > 1 and "C" not in axes:
        raise DecodeError(
            f"{path}: expected axes with C for {raw.channels} channels, found {axes}; mend 'axes'"
        )
    frames = there // one if "N" in axes else 1
    if frames < 1 or there != frames * one:
        each = " for each frame" if "N" in axes else ""
        before = f" after {raw.header_bytes}" if raw.header_bytes else ""
        raise DecodeError(
            f"{path}: expected {one} bytes{before}{each} "
            f"({raw.width}x{raw.height}, {raw.channels} of {raw.dtype}), found {size} in all; "
            "mend 'raw' in the description"
        )
    sizes = {"N": frames, "H": raw.height, "W": raw.width, "C": raw.channels}
    return ArrayHeader(tuple(sizes[a] for a in axes), dtype, False, raw.header_bytes)


def wrong(path: Path, found: str) -> DecodeError:
    """Return the error for a file that is no array of numbers."""
    return DecodeError(f"{path}: expected a NumPy array file of numbers, found {found}")
