"""The files of one kind of image, and what a description's placeholders stand for in each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from nimprep.errors import LayoutError
from nimprep.images import read_header
from nimprep.readers.description import PlaneSource
from nimprep.readers.tree import found_files

ENDINGS = frozenset(
    f".{ending}"
    for ending in (
        *("bmp", "exr", "gif", "h5", "hdf5", "hdr", "jp2", "jpe", "jpeg", "jpg", "mat", "npy"),
        *("npz", "pbm", "pfm", "pgm", "png", "pnm", "ppm", "tif", "tiff", "webp"),
    )
)
"""Endings that ``.*`` stands for, in small letters: not those of notes beside an image."""


@dataclass(frozen=True)
class Place:
    """Name a file, and which of the frames in it, where it holds many; None = all of it is one."""

    path: Path
    index: int | None = None


class Found(NamedTuple):
    """Say where an image is, and what the pattern's placeholders stand for there."""

    values: Mapping[str, str]
    place: Place


def found_images(root: Path, source: PlaneSource) -> list[Found]:
    """Return every image of a kind, in order of path and, within a file of many, of number.

    The number is what {id} stands for there, "000012"; or what it ends with, after a slash, where
    the pattern has an {id} itself.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, or its folder is missing.
    DecodeError
        A file of many images is damaged.
    """
    files = list(found_files(root, source.files))
    if source.files.endswith(".*") and source.raw is None:
        files = [each for each in files if each[0].suffix.lower() in ENDINGS]
    if "N" not in (source.axes or ""):
        return [Found(values, Place(path)) for path, values in files]
    return [
        Found({**values, "id": _numbered(values.get("id"), number)}, Place(path, number))
        for path, values in files
        for number in range(read_header(path, source.layout).frames or 0)
    ]


def _numbered(file_id: str | None, number: int) -> str:
    return f"{number:06d}" if file_id is None else f"{file_id}/{number:06d}"


def by_placeholders(
    found: Sequence[Found], names: Sequence[str]
) -> dict[tuple[str, ...], list[Place]]:
    """Return images by what these placeholders stand for."""
    places: dict[tuple[str, ...], list[Place]] = {}
    for values, place in found:
        places.setdefault(tuple(values[name] for name in names), []).append(place)
    return places


def only(places: Sequence[Place], frame_id: str) -> Place:
    """Return a frame's image, the only one.

    Raises
    ------
    LayoutError
        There are several.
    """
    if len(places) > 1:
        raise LayoutError(
            f"{places[1].path}: expected one file per id {frame_id!r}, found {places[0].path} "
            "too; put more of the path into placeholders, or narrow the pattern"
        )
    return places[0]
