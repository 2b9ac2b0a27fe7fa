"""Steps that readers share: pairing files, checks on a frame as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy.typing as npt

from nimprep.errors import DecodeError, LayoutError
from nimprep.images import read_orientation


def match_frames(files: Mapping[str, Mapping[str, Path]], root: Path) -> tuple[str, ...]:
    """Return the sorted frame ids that every modality has.

    Parameters
    ----------
    files : mapping of modality (or folder) name to {frame id: file}

    Raises
    ------
    LayoutError
        There are no frames, or one lacks a modality; it is named.
    """
    ids = sorted(set().union(*files.values()))
    if not ids:
        raise LayoutError(f"{root}: expected images in {', '.join(files)}, found none")
    for name, by_id in files.items():
        missing = [i for i in ids if i not in by_id]
        if missing:
            have = next(by_id[missing[0]] for by_id in files.values() if missing[0] in by_id)
            raise LayoutError(
                f"{root}: expected {name} for every frame, found none for frame {missing[0]!r} "
                f"(which has {have.relative_to(root) if have.is_relative_to(root) else have}; "
                f"{len(missing)} of {len(ids)} frames lack {name})"
            )
    return tuple(ids)


def check_same_shape(images: Mapping[Path, npt.NDArray[Any]]) -> None:
    """Raise `DecodeError` where a frame's images differ in height or width."""
    first = next(iter(images))
    for path, image in images.items():
        if image.shape[:2] != images[first].shape[:2]:
            (h, w), (h0, w0) = image.shape[:2], images[first].shape[:2]
            raise DecodeError(
                f"{path}: expected {w0}x{h0} pixels like {first.name} in {first.parent.name}/, "
                f"found {w}x{h}{_turned_of(images)}"
            )


def _turned_of(paths: Iterable[Path]) -> str:
    """Return what orientations there are among files, for a message."""
    for path in paths:
        if (found := read_orientation(path)) != 1:
            return (
                f" (EXIF orientation {found} in {path.parent.name}/{path.name}; if the others "
                'were not made of the turned picture, say "orientation": "ignore")'
            )
    return ""
