"""NumPy's archives, .npz: a zip file of .npy members.

A member must hold what it claims, and must have been packed no tighter than deflate can, before
memory is taken for it. Of a member with many frames only the wanted one is kept: at once where it
is not packed, as `numpy.savez` writes it; after unpacking those before it where it is.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import open_plain
from nimprep.images.array import (
    ArrayHeader,
    checked_count,
    ordered,
    parse_header,
    read_part,
    wrong,
)
from nimprep.images.header import broken

SIGNATURE = b"PK\3\4"
_BEST_RATIO = 1032
"""Deflate makes at most so many bytes of one: 258 of two bits."""

_LOCAL_HEADER = 30
_NAMES_SHOWN = 8
_PIECE = 1 << 20


def read_archive_header(path: Path, key: str | None) -> ArrayHeader:
    """Return what an array in a .npz file says of itself; `start` counts from its member's start.

    Raises
    ------
    DecodeError
        It is no such archive, the array is not in it, or it holds less than it claims.
    """
    with _opened(path) as (file, archive):
        return _member(file, archive, key, path)[1]


def read_archive_part(
    path: Path, key: str | None, axis: int | None, index: int | None
) -> npt.NDArray[Any]:
    """Return an array in a .npz file, or its part at an index of an axis.

    Raises
    ------
    DecodeError
        As for the header; or it is damaged.
    """
    with _opened(path) as (file, archive):
        member, header = _member(file, archive, key, path)
        if member.compress_type == zipfile.ZIP_STORED:
            place = _data_place(file, member, path)
            header = replace(header, start=place + header.start)
            return read_part(file, header, path, axis, index)
        return _unpacked(archive, member, header, path, axis, index)


def archive_shapes(path: Path, most: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of at most so many arrays of numbers in a .npz file, by their headers.

    Raises
    ------
    DecodeError
        It is no such archive.
    """
    found = {}
    with _opened(path) as (file, archive):
        for member in archive.infolist()[:most]:
            name = member.filename.removesuffix(".npy")
            with suppress(DecodeError):
                found[name] = _member(file, archive, name, path)[1].shape
    return found


@contextmanager
def _opened(path: Path) -> Iterator[tuple[BinaryIO, zipfile.ZipFile]]:
    with open_plain(path, "a NumPy archive") as (file, _):
        try:
            with zipfile.ZipFile(file) as archive:
                yield file, archive
        except (DecodeError, MemoryError):
            raise
        except Exception as error:  # in files made to deceive, zipfile trips over anything
            reason = str(error) or type(error).__name__
            raise broken(path, "NumPy archive", f"one that cannot be read: {reason}") from error


def _member(
    file: BinaryIO, archive: zipfile.ZipFile, key: str | None, path: Path
) -> tuple[zipfile.ZipInfo, ArrayHeader]:
    """Return the array's member and header, once what they claim is possible."""
    members = {m.filename.removesuffix(".npy"): m for m in archive.infolist()}
    names = [name for name, m in members.items() if m.filename.endswith(".npy")]
    if (key is None and len(names) != 1) or (key is not None and key not in names):
        raise DecodeError(missing_key(path, key, names))
    member = members[names[0] if key is None else key]
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise wrong(path, f"{member.filename} packed by method {member.compress_type}")
    if member.file_size > _BEST_RATIO * member.compress_size:
        raise broken(path, "NumPy archive", f"{member.file_size} bytes of {member.compress_size}")
    with archive.open(member) as stream:
        return member, parse_header(stream, member.file_size, path)  # type: ignore[arg-type]


def missing_key(path: Path, key: str | None, names: list[str]) -> str:
    """Return the message for a container in which the key does not tell one array."""
    shown = ", ".join(f"{name!r:.80}" for name in sorted(names)[:_NAMES_SHOWN])
    more = f" and {len(names) - _NAMES_SHOWN} more" if len(names) > _NAMES_SHOWN else ""
    wanted = "one array" if key is None else f"an array {key!r}"
    return (
        f"{path}: expected {wanted} in it, found {shown or 'none'}{more}; "
        "name the one that counts as 'key' in the description"
    )


def _data_place(file: BinaryIO, member: zipfile.ZipInfo, path: Path) -> int:
    """Return where a member's bytes begin: after its local header, whose length is its own."""
    file.seek(member.header_offset)
    start = file.read(_LOCAL_HEADER)
    if len(start) != _LOCAL_HEADER or not start.startswith(SIGNATURE):
        raise broken(path, "NumPy archive", "a member that is not where it should be")
    lengths = int.from_bytes(start[26:28], "little") + int.from_bytes(start[28:30], "little")
    return member.header_offset + _LOCAL_HEADER + lengths


def _unpacked(
    archive: zipfile.ZipFile,
    member: zipfile.ZipInfo,
    header: ArrayHeader,
    path: Path,
    axis: int | None,
    index: int | None,
) -> npt.NDArray[Any]:
    shape, in_place = header.part(axis)
    size = checked_count(header, axis, path) * header.dtype.itemsize
    skipped = header.start + (index or 0) * size * in_place
    with archive.open(member) as stream:
        while skipped > 0:
            piece = stream.read(min(skipped, _PIECE))
            if not piece:
                break
            skipped -= len(piece)
        data = stream.read(size)
    if len(data) != size:
        raise wrong(path, f"{member.filename} truncated after {len(data)} of {size} bytes")
    flat = np.frombuffer(data, header.dtype)
    return ordered(flat, header, shape, None if in_place else axis, index)
