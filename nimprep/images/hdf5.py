"""HDF5 files, MATLAB's of version 7.3 among them, through h5py (the extra `hdf5`).

A file is opened for each read and closed after it, so that no handle lives across a fork; h5py has
a lock of its own, so that threads take turns. Links to other files are not followed, nor is data
taken from them. What a file claims is checked before memory is taken for it, as far as h5py tells;
the HDF5 library below it is not made for files that somebody wrote to deceive.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import open_plain
from nimprep.images.archive import missing_key
from nimprep.images.array import ArrayHeader, checked_count
from nimprep.images.header import MAX_BYTES, broken

SIGNATURE = b"\x89HDF\r\n\x1a\n"
MATLAB = b"MATLAB 7.3 MAT-file"
"""MATLAB's own text comes first, HDF5's signature 512 bytes later."""

_MOST_NAMES = 10_000
_DEEPEST = 4


def is_hdf5(start: bytes) -> bool:
    """Tell whether a file's first 520 bytes are those of HDF5, or of MATLAB 7.3."""
    return start.startswith((SIGNATURE, MATLAB)) or start[512:].startswith(SIGNATURE)


def read_hdf5_header(path: Path, key: str | None) -> ArrayHeader:
    """Return what an array in an HDF5 file says of itself.

    Raises
    ------
    DecodeError
        It cannot be read, the array is not in it, holds other things than numbers or lies in
        another file.
    """
    with _dataset(path, key) as array:
        return _header(array, path)


def read_hdf5_part(
    path: Path, key: str | None, axis: int | None, index: int | None
) -> npt.NDArray[Any]:
    """Return an array in an HDF5 file, or its part at an index of an axis.

    Raises
    ------
    DecodeError
        As for the header; or it is damaged, or packed by a filter that is not there.
    """
    with _dataset(path, key) as array:
        header = _header(array, path)
        part = header.shape if axis is None else header.shape[:axis] + header.shape[axis + 1 :]
        checked_count(ArrayHeader(part, header.dtype), None, path)
        where = tuple(index if i == axis else slice(None) for i in range(len(header.shape)))
        found = np.asarray(array[where])
    return np.ascontiguousarray(found.astype(found.dtype.newbyteorder("="), copy=False))


def read_hdf5_cell(path: Path, key: str, number: int) -> npt.NDArray[Any]:
    """Return the array in a place of a MATLAB cell array, or of a field of a struct array.

    Parameters
    ----------
    key : str
        Of the references, by columns as MATLAB counts them.
    number : int
        The place, from 0.

    Raises
    ------
    DecodeError
        As for `read_hdf5_part`; or there is no such place.
    """
    with _opened(path) as file:
        cells = _at(file, [part for part in key.split("/") if part])
        if not _is_cells(cells) or not 0 <= number < cells.size:
            found = f"{cells.size} of them" if _is_cells(cells) else "no references"
            raise DecodeError(
                f"{path}: expected a cell {number} of {key!r}, found {found}; give the file as it "
                "was published"
            )
        array = file[cells[()].ravel()[number]]
        header = _header(array, path)
        checked_count(header, None, path)
        return np.ascontiguousarray(np.asarray(array[()]))


def hdf5_cell_count(path: Path, key: str) -> int:
    """Return how many cells there are under a key; 0 = it is no cell array.

    Raises
    ------
    DecodeError
        The file cannot be read.
    """
    with _opened(path) as file:
        cells = _at(file, [part for part in key.split("/") if part])
        return int(cells.size) if _is_cells(cells) else 0


def read_hdf5_values(path: Path, key: str, fields: Collection[str] | None = None) -> Any:
    """Return a variable of MATLAB 7.3, its cells with it: see `nimprep.readers.matlab`.

    Raises
    ------
    DecodeError
        The file cannot be read, or has none under this key.
    """
    with _opened(path) as file:
        item = _at(file, [part for part in key.split("/") if part])
        if item is None:
            raise DecodeError(missing_key(path, key, _arrays(file)))
        return _values(file, item, path, fields, 0)


def _is_cells(item: Any) -> bool:
    import h5py

    return isinstance(item, h5py.Dataset) and h5py.check_ref_dtype(item.dtype) is h5py.Reference


def _values(file: Any, item: Any, path: Path, fields: Collection[str] | None, depth: int) -> Any:
    import h5py

    if depth > _DEEPEST:
        return None
    if isinstance(item, h5py.Group):
        # A struct array has a list of cells under each field; a single struct its values.
        names = [n for n in _names(item) if fields is None or n in fields]
        columns = {n: _values(file, _at(item, [n]), path, fields, depth + 1) for n in names}
        if columns and all(isinstance(column, list) for column in columns.values()):
            rows = zip(*columns.values(), strict=False)
            return [dict(zip(columns, row, strict=True)) for row in rows]
        return [columns]
    if not isinstance(item, h5py.Dataset):
        return None
    if _is_cells(item):
        cells = item[()].ravel().tolist()
        return [
            _values(file, file[each], path, fields, depth + 1) if each else None for each in cells
        ]
    if item.dtype.kind not in "biuf":
        return None
    checked_count(_header(item, path), None, path)
    array = np.asarray(item[()]).T
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, array.ravel(order="F").tolist()))
    return array


def hdf5_shapes(path: Path, most: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of at most so many arrays of numbers in an HDF5 file, by their paths.

    Raises
    ------
    DecodeError
        It is no HDF5 file, cannot be read, or h5py is not there.
    """
    found: dict[str, tuple[int, ...]] = {}
    with _opened(path) as file:
        import h5py

        def visit(name: str, item: object) -> bool | None:
            if isinstance(item, h5py.Dataset) and item.shape and item.dtype.kind in "biuf":
                found[name] = tuple(item.shape)
            return True if len(found) >= most else None

        file.visititems(visit)
    return found


@contextmanager
def _dataset(path: Path, key: str | None) -> Iterator[Any]:
    with _opened(path) as file:
        yield _found(file, key, path)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        import h5py
    except ImportError as error:
        raise DecodeError(
            f"{path}: expected h5py for an HDF5 file, found none; "
            "install the extra: pip install 'nimprep[hdf5]'"
        ) from error
    with open_plain(path, "an HDF5 file"):
        pass
    try:
        # Nothing is written, and many file systems that datasets lie on know no locks.
        with h5py.File(path, "r", locking=False) as file:
            yield file
    except (DecodeError, MemoryError):
        raise
    except Exception as error:  # h5py raises whatever fits HDF5's own errors
        reason = str(error).replace("\n", " ") or type(error).__name__
        if "filter" in reason or "plugin" in reason:
            reason += "; pack it anew by h5repack -f GZIP=4"
        raise broken(path, "HDF5 file", f"one that cannot be read: {reason:.300}") from error


def _found(file: Any, key: str | None, path: Path) -> Any:
    """Return the dataset under a key, or the only one at the root."""
    import h5py

    if key is None:
        names = [n for n in _names(file) if isinstance(_at(file, [n]), h5py.Dataset)]
        if len(names) != 1:
            raise DecodeError(missing_key(path, None, names or _arrays(file)))
        key = names[0]
    array = _at(file, [part for part in key.split("/") if part])
    if not isinstance(array, h5py.Dataset):
        raise DecodeError(missing_key(path, key, _arrays(file)))
    return array


def _names(file: Any) -> list[str]:
    return [name for name, _ in zip(file, range(_MOST_NAMES), strict=False)]


def _arrays(file: Any) -> list[str]:
    """Return the keys of the arrays in a file, in its groups too, that `_found` would find."""
    import h5py

    names: list[str] = []
    # Not deeper than anybody's groups are: hard links can lead round in a circle.
    level: list[tuple[str, ...]] = [(name,) for name in _names(file)]
    for _ in range(_DEEPEST):
        below: list[tuple[str, ...]] = []
        for parts in level[:_MOST_NAMES]:
            there = _at(file, list(parts))
            if isinstance(there, h5py.Dataset):
                names.append("/".join(parts))
            elif isinstance(there, h5py.Group) and len(below) < _MOST_NAMES:
                below += [(*parts, name) for name in _names(there)]
        level = below
    return names


def _at(group: Any, parts: list[str]) -> Any:
    """Return what lies below a group, by hard links alone: others lead elsewhere."""
    import h5py

    for part in parts:
        if not isinstance(group, h5py.Group) or part == "." or part not in group:
            return None
        if not isinstance(group.get(part, getlink=True), h5py.HardLink):
            return None
        group = group[part]
    return group


def _header(array: Any, path: Path) -> ArrayHeader:
    shape, dtype = array.shape, array.dtype
    if shape is None or dtype.kind not in "biuf":
        found = "nothing" if shape is None else f"{shape} of {dtype}"
        raise broken(path, "HDF5 array of numbers", f"{found:.200}")
    if array.external or array.is_virtual:
        raise broken(path, "HDF5 array", "one whose numbers lie in other files")
    # A chunk is unpacked as a whole, however little of it is wanted.
    if math.prod(array.chunks or ()) * dtype.itemsize > MAX_BYTES:
        raise broken(path, "HDF5 array", f"chunks of {array.chunks}, more than is read at once")
    return ArrayHeader(shape, dtype)
