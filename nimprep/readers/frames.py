"""Steps that readers share: pairing files, checks on a frame as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import IGNORE_LABEL, LabelClass


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


def check_label(
    label: npt.NDArray[Any], classes: Sequence[LabelClass], path: Path
) -> npt.NDArray[np.uint8]:
    """Return the label image after checking that it holds class ids and 255 only.

    Raises
    ------
    DecodeError
        It has colours, or another value.
    """
    if label.ndim != 2:
        raise DecodeError(f"{path}: expected class ids in one channel, found a colour image")
    known = [c.id for c in classes] + [IGNORE_LABEL]
    # Classes are mostly numbered from 0 on: one comparison for these, and one for each other id.
    first = next(i for i in range(len(known) + 1) if i not in known)
    unknown = label >= first
    for value in known:
        if value > first:
            unknown &= label != value
    if unknown.any():
        raise DecodeError(
            f"{path}: expected labels {known}, found {label[unknown].min()}; "
            "describe other classes with a folder description, or use --no-labels"
        )
    return label.astype(np.uint8, copy=False)


def check_same_shape(images: Mapping[Path, npt.NDArray[Any]]) -> None:
    """Raise `DecodeError` where a frame's images differ in height or width."""
    first = next(iter(images))
    for path, image in images.items():
        if image.shape[:2] != images[first].shape[:2]:
            (h, w), (h0, w0) = image.shape[:2], images[first].shape[:2]
            raise DecodeError(
                f"{path}: expected {w0}x{h0} pixels like {first.name} in {first.parent.name}/, "
                f"found {w}x{h}"
            )
