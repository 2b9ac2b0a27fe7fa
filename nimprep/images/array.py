"""NumPy files of plain numbers.

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

_SIGNATURE = b"\x93NUMPY"
_LONGEST_HEADER = 1 << 16
_DTYPE = re.compile(r"'descr' *: *'([<>|=]?[?biufc]\d{0,2})'")
_ORDER = re.compile(r"'fortran_order' *: *(True|False)")
_SHAPE = re.compile(r"'shape' *: *\(([\d, ]*)\)")


@dataclass(frozen=True)
class ArrayHeader:
    """Tell what a .npy file holds.

    Attributes
    ----------
    shape : tuple of int
    dtype : dtype
    by_columns : bool
        Whether the first index changes fastest.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    by_columns: bool


def read_array_header(path: Path) -> ArrayHeader:
    """Return what a .npy file says of itself.

    Raises
    ------
    DecodeError
        It is none, holds other things than numbers, or less or more than it can.
    """
    with open_plain(path, "a NumPy array file") as (file, size):
        return _header(file, size, path)


def read_array(path: Path) -> npt.NDArray[Any]:
    """Return the array of a .npy file, C-contiguous, in the machine's byte order.

    Raises
    ------
    DecodeError
        It is none, holds other things than numbers, or is cut short.
    """
    with open_plain(path, "a NumPy array file") as (file, size):
        header = _header(file, size, path)
        count = math.prod(header.shape)
        flat = np.fromfile(file, header.dtype, count)
    if flat.size != count:
        raise _wrong(path, f"one truncated after {flat.size} of {count} numbers")
    flat = flat.astype(header.dtype.newbyteorder("="), copy=False)
    if header.by_columns:
        return np.ascontiguousarray(flat.reshape(header.shape[::-1]).T)
    return flat.reshape(header.shape)


def _header(file: BinaryIO, size: int, path: Path) -> ArrayHeader:
    start = file.read(12)
    if start[:6] != _SIGNATURE or len(start) < 12 or start[6] not in (1, 2):
        raise _wrong(path, "another kind of file")
    wide = 2 if start[6] == 1 else 4
    length = int.from_bytes(start[8 : 8 + wide], "little")
    file.seek(8 + wide)
    text = file.read(min(length, _LONGEST_HEADER)).decode("latin-1")
    found = [pattern.search(text) for pattern in (_DTYPE, _ORDER, _SHAPE)]
    if len(text) != length or not all(found):
        raise _wrong(path, "objects, records or a header that is none")
    descr, order, shape_text = (match[1] for match in found if match)
    try:
        dtype = np.dtype(descr)
    except TypeError as error:
        raise _wrong(path, f"numbers of type {descr!r}") from error
    shape = tuple(int(n) for n in shape_text.replace(",", " ").split())
    claimed = math.prod(shape) * dtype.itemsize
    if len(shape) > 8 or claimed > min(MAX_BYTES, size - 8 - wide - length):
        raise _wrong(path, f"{shape} of {dtype}, more than its {size} bytes or than is read")
    return ArrayHeader(shape, dtype, order == "True")


def _wrong(path: Path, found: str) -> DecodeError:
    return DecodeError(f"{path}: expected a NumPy array file of numbers, found {found}")
