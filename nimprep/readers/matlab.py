"""Variables of MATLAB files: splits, maps of classes, names; not images.

Of both formats that MATLAB writes: version 5, which is read here, and 7.3, which is HDF5. A number
is an array as MATLAB has it, a text a str, a cell array a list, a struct array a list of dicts,
both by columns, as MATLAB counts them.

Source: MAT-File Format, The MathWorks, chapter 1 (level 5): tags, array flags, sub-elements.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nimprep.errors import DecodeError
from nimprep.files import read_file, read_start
from nimprep.images.hdf5 import is_hdf5, read_hdf5_values

MAX_BYTES = 1 << 30
"""A variable of more bytes is no list of frames or classes."""

_DEEPEST = 16
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    16: "u1",
    17: "u2",
    18: "u4",
}
"""NumPy's types by the codes of data; 16 to 18 are UTF."""

_LAST_LETTER = 0x10FFFF
_CELL, _STRUCT, _TEXT = 1, 2, 4
_NUMERIC = range(6, 16)


def matlab_variable(path: Path, name: str, fields: Collection[str] | None = None) -> Any:
    """Return a variable of a MATLAB file.

    Parameters
    ----------
    name : str
        The variable's.
    fields : collection of str, optional
        Of structs, those that are wanted; the others cost nothing.

    Returns
    -------
    (...) array, str, list, or list of dict
        None in the place of what is none of these.

    Raises
    ------
    DecodeError
        It cannot be read, is no MATLAB file, or has no such variable.
    """
    start = read_start(path, 520)
    if is_hdf5(start):
        return read_hdf5_values(path, name, fields)
    try:
        found = _of_level_5(path, name, fields)
    except (struct.error, zlib.error, ValueError) as error:
        raise DecodeError(f"{path}: expected a whole MATLAB file, found {error}") from error
    if found is None:
        raise DecodeError(
            f"{path}: expected the variable {name!r} in a MATLAB file, found none; "
            "give the file as it was published"
        )
    return found.value


def numbers_of(value: Any, path: Path, name: str) -> list[int]:
    """Return a variable's whole numbers, by columns.

    Raises
    ------
    DecodeError
        It holds others.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in "iuf":
        flat = value.ravel(order="F")
        if np.isfinite(flat).all() and (flat == np.floor(flat)).all():
            return [int(number) for number in flat]
    raise DecodeError(f"{path}: expected whole numbers as {name!r}, found others; give the file")


def texts_of(value: Any, path: Path, name: str) -> list[str]:
    """Return a cell array's texts; those that a writer left as numbers are read as letters.

    Raises
    ------
    DecodeError
        It holds others.
    """
    made = [_text(each) for each in value] if isinstance(value, list) else []
    if not made or any(text is None for text in made):
        raise DecodeError(
            f"{path}: expected a cell array of texts as {name!r}, found others; give the file as "
            "it was published"
        )
    return [text for text in made if text is not None]


def _text(value: Any) -> str | None:
    if isinstance(value, list) and len(value) == 1:
        return _text(value[0])
    if isinstance(value, np.ndarray) and value.dtype.kind == "u":
        return "".join(map(chr, value.ravel(order="F").tolist()))
    return value if isinstance(value, str) else None


class _Variable(NamedTuple):
    name: str
    value: Any


class _Element(NamedTuple):
    kind: int
    data: memoryview


def _of_level_5(path: Path, name: str, fields: Collection[str] | None) -> _Variable | None:
    data = memoryview(read_file(path, MAX_BYTES, "a readable MATLAB file"))
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]))
    if order is None:
        raise DecodeError(
            f"{path}: expected a MATLAB file of version 5 or 7.3, found another; save it with -v7"
        )
    for element in _elements(data[_HEADER:], order, padded=False):
        if element.kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            plain = unpacking.decompress(element.data, MAX_BYTES)
            if unpacking.unconsumed_tail:
                raise ValueError(f"a variable of more than {MAX_BYTES} bytes")
            elements = _elements(memoryview(plain), order)
        else:
            elements = iter((element,))
        for inner in elements:
            if inner.kind == _MATRIX and _name(inner.data, order) == name:
                return _Variable(name, _value(inner.data, order, fields, 0))
    return None


def _elements(data: memoryview, order: str, *, padded: bool = True) -> Iterator[_Element]:
    """Yield the elements that some bytes are, each after its tag."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:
            # A small one: the size beside the kind, the data in the tag.
            kind, size = kind & 0xFFFF, kind >> 16
            yield _Element(kind, data[at + 4 : at + 4 + min(size, 4)])
            at += 8
            continue
        at += 8
        if at + size > len(data):
            raise ValueError("one that ends too early")
        yield _Element(kind, data[at : at + size])
        at += size
        if padded or kind != _COMPRESSED:
            at += -size % 8


def _next(elements: Iterator[_Element]) -> _Element:
    found = next(elements, None)
    if found is None:
        raise ValueError("one that lacks a part")
    return found


def _name(data: memoryview, order: str) -> str:
    elements = _elements(data, order)
    _, _, name = _next(elements), _next(elements), _next(elements)
    return bytes(name.data).decode("latin-1")


def _value(data: memoryview, order: str, fields: Collection[str] | None, depth: int) -> Any:
    """Return what a matrix element holds; None for what is not read."""
    if len(data) == 0 or depth > _DEEPEST:
        return None
    elements = _elements(data, order)
    flags, sizes, _ = _next(elements), _next(elements), _next(elements)
    kind = struct.unpack_from(f"{order}I", flags.data)[0] & 0xFF
    shape = np.frombuffer(sizes.data, f"{order}i4").tolist()
    count = math.prod(shape)
    if kind in _NUMERIC:
        return _array(_next(elements), order, shape)
    if kind == _TEXT:
        codes = next(elements, None)
        return "" if codes is None else _letters(codes, order)
    if kind == _CELL:
        return [_value(each.data, order, fields, depth + 1) for each in elements][:count]
    if kind == _STRUCT:
        return _structs(elements, order, count, fields, depth)
    return None


def _array(element: _Element, order: str, shape: list[int]) -> Any:
    numbers = np.frombuffer(element.data, _type(element, order))
    return numbers.astype(numbers.dtype.newbyteorder("=")).reshape(shape, order="F")


def _letters(element: _Element, order: str) -> str:
    if element.kind == 16:
        return bytes(element.data).decode("utf-8", "replace")
    codes = np.frombuffer(element.data, _type(element, order))
    if codes.dtype.kind != "u" or (codes.size > 0 and codes.max() > _LAST_LETTER):
        raise ValueError("a text that is none")
    return "".join(map(chr, codes.tolist()))


def _type(element: _Element, order: str) -> str:
    if element.kind not in _NUMBERS:
        raise ValueError(f"data of the kind {element.kind}")
    return order + _NUMBERS[element.kind]


def _structs(
    elements: Iterator[_Element],
    order: str,
    count: int,
    fields: Collection[str] | None,
    depth: int,
) -> list[dict[str, Any]]:
    length = struct.unpack_from(f"{order}i", _next(elements).data)[0]
    packed = bytes(_next(elements).data)
    cut = [packed[i : i + length] for i in range(0, len(packed), length)] if length > 0 else []
    names = [each.partition(b"\0")[0].decode("latin-1") for each in cut]
    made: list[dict[str, Any]] = [{} for _ in range(count if names else 0)]
    for each in made:
        for name in names:
            element = _next(elements)
            if fields is None or name in fields:
                each[name] = _value(element.data, order, fields, depth + 1)
    return made
