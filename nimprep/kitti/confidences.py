"""A folder of confidence maps: which file predicts what, and what its numbers mean."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from nimprep.errors import LayoutError
from nimprep.kitti.images import read_confidence, read_grey
from nimprep.kitti.names import (
    FRAME_GRAMMAR,
    GRAMMAR,
    PREDICTED,
    PredictionName,
    Target,
    plain_files,
    prediction_name,
)

SUFFIXES = (".png", ".npy")
"""8-bit or 16-bit confidences, and floating probabilities."""

NAMED_AT_MOST = 10
"""Messages name this many files and count the rest."""

Half = Literal["training", "testing"]


@dataclass(frozen=True)
class Confidences:
    """Hold where a folder's confidence maps are.

    Attributes
    ----------
    files : dict of PredictionName to Path
        Sorted by name.
    """

    files: dict[PredictionName, Path]

    @cached_property
    def masks(self) -> bool:
        """Whether the PNGs are masks of 0 and 1: then 1 is surely road, as 255 is otherwise."""
        pictures = [path for path in self.files.values() if path.suffix.lower() == ".png"]
        return bool(pictures) and all(_is_mask(path) for path in pictures)

    def read(self, name: PredictionName) -> npt.NDArray[np.uint8]:
        """Return a confidence map, (H, W) uint8, 255 = surely road.

        Raises
        ------
        DecodeError
            As `nimprep.kitti.images.read_confidence`.
        """
        return read_confidence(self.files[name], mask=self.masks)

    def warn_of_masks(self, flat: Iterable[PredictionName], folder: Path) -> None:
        """Warn of maps of 0 and 1 alone among others that hold more, which tell what 1 means."""
        names = [] if self.masks else [self.files[name].name for name in flat]
        if names:
            warnings.warn(
                f"{folder}: expected confidences of one scale, found 0 and 1 alone in {len(names)} "
                f"of {len(self.files)} predictions ({listed(names)}), where 1 was read as 1/255; "
                "masks are taken for 0 and 255 where all are",
                stacklevel=3,
            )


def _is_mask(path: Path) -> bool:
    image = read_grey(path)
    return image is not None and int(image.max()) <= 1


def confidence_files(folder: Path, half: Half | None) -> list[Path]:
    """Return the files that may be a folder's predictions.

    They lie in the folder itself or, named by frame id (``testing/um_000000``), in its subfolders
    training and testing: a folder may hold predictions of both halves, each for its own step.

    Parameters
    ----------
    half : {"training", "testing"} or None
        Which of the subfolders counts; None = the one that is there.

    Raises
    ------
    LayoutError
        There is no folder, it holds the other half alone, or both where either counts.
    """
    if not folder.is_dir():
        raise LayoutError(
            f"{folder}: expected a folder of {GRAMMAR} or {FRAME_GRAMMAR}.png, found none; "
            "give the predictions' folder"
        )
    halves = {h: files for h in get_args(Half) if (files := _files_of(folder / h))}
    if half is None and len(halves) > 1:
        raise LayoutError(
            f"{folder}: expected predictions of training or of testing frames, found both; "
            "give the one of its subfolders that is meant"
        )
    own = [path for path in plain_files(folder) if path.name != PREDICTED]
    taken = own + [p for h, files in halves.items() if half in (None, h) for p in files]
    for other, files in halves.items():
        if not taken:
            raise LayoutError(
                f"{folder}: expected predictions of {half} frames, found {len(files)} of "
                f"{other} frames only; predict the {half} frames"
            )
    return taken


def _files_of(folder: Path) -> list[Path]:
    return plain_files(folder) if folder.is_dir() else []


def find_confidences(
    folder: Path, half: Half | None = None, target: Target = "road"
) -> Confidences:
    """Find a folder's predictions: ``um_road_000000`` or ``um_000000``, .png or .npy.

    Hidden files, other sub-folders and files with other endings are left alone.

    Parameters
    ----------
    half : {"training", "testing"}, optional
        As for `confidence_files`.
    target : {"road", "lane"}
        What a frame's own name predicts.

    Raises
    ------
    LayoutError
        The folder is missing or holds none, a name breaks the grammar, or two files have one name.
    """
    found: dict[PredictionName, Path] = {}
    for path in confidence_files(folder, half):
        if path.suffix.lower() not in SUFFIXES:
            continue
        name = prediction_name(path, target)
        if name in found:
            raise LayoutError(
                f"{path}: expected one file per prediction, found {found[name].name} too; "
                "take one away"
            )
        found[name] = path
    if not found:
        raise LayoutError(
            f"{folder}: expected files {GRAMMAR} or {FRAME_GRAMMAR} with {' or '.join(SUFFIXES)}, "
            "found none; give the predictions' folder"
        )
    return Confidences(dict(sorted(found.items())))


def listed(names: Sequence[str]) -> str:
    """Return names joined by commas, the first few of many."""
    more = len(names) - NAMED_AT_MOST
    return ", ".join(names[:NAMED_AT_MOST]) + (f" and {more} more" if more > 0 else "")
