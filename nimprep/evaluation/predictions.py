"""Predictions on disk: one file per frame, found by the frame's id and read as class ids."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError, LayoutError
from nimprep.frame import MAX_PIXELS
from nimprep.images import read_array, read_label
from nimprep.kitti.names import PREDICTED
from nimprep.store.reader import Store

SUFFIXES = (".png", ".npy")
"""What a prediction's file may be."""

ABOUT, SCORES = PREDICTED, "scores"
"""What `nimprep predict` puts beside labels: what they are of, and a folder of scores."""

NAMED_AT_MOST = 10
"""Messages name this many frames and count the rest."""


def prediction_files(folder: Path) -> dict[str, Path]:
    """Return each prediction's file by frame id; an id with "/" lies in subfolders.

    Scores that `nimprep predict` wrote beside its labels are predictions of their own.

    Raises
    ------
    LayoutError
        There is no folder, nothing in it, or two predictions of one frame.
    """
    if not folder.is_dir():
        raise LayoutError(f"{folder}: expected a folder of predictions, found none")
    files: dict[str, Path] = {}
    beside = folder / SCORES if (folder / ABOUT).is_file() else None
    for path in sorted(folder.rglob("*")):
        if beside in path.parents:
            continue
        if path.suffix in SUFFIXES and path.is_file():
            frame_id = path.relative_to(folder).as_posix().removesuffix(path.suffix)
            if frame_id in files:
                raise LayoutError(
                    f"{path}: expected one prediction of frame {frame_id!r}, "
                    f"found {files[frame_id].name} too; remove one"
                )
            files[frame_id] = path
    if not files:
        raise LayoutError(f"{folder}: expected predictions (.png or .npy), found none")
    return files


def split_of(store: Store, files: Collection[str]) -> str | None:
    """Return the one split that the predictions are of; None where they are of several."""
    found = {name for frame_id, name in store.splits.items() if frame_id in files}
    only = found.pop() if len(found) == 1 else None
    return None if only == "none" else only


def check_names(
    folder: Path, files: Collection[str], ids: Sequence[str], split: str | None
) -> None:
    """Raise `LayoutError` where a frame has no prediction or a prediction no frame."""
    of = "the store" if split is None else f"split {split!r}"
    advice = "; name the split that they are of" if split is None else ""
    missing = [i for i in ids if i not in files]
    if missing:
        raise LayoutError(
            f"{folder}: expected a prediction for each of {len(ids)} frames of {of}, "
            f"found none for {listed(missing)}{advice}"
        )
    extra = sorted(set(files) - set(ids))
    if extra:
        raise LayoutError(
            f"{folder}: expected predictions of the {len(ids)} frames of {of} only, "
            f"found {listed(extra)} too{advice}"
        )


def listed(names: Sequence[str]) -> str:
    """Return names joined by commas, the first few of many."""
    more = len(names) - NAMED_AT_MOST
    return ", ".join(names[:NAMED_AT_MOST]) + (f" and {more} more" if more > 0 else "")


def read_prediction(path: Path, ids: Sequence[int]) -> npt.NDArray[np.integer]:
    """Return the predicted class ids, (H, W), of a file.

    Parameters
    ----------
    path : path
        .png: (H, W) class ids of 8 bits. .npy: (C, H, W) floating scores.
    ids : sequence of int
        The class of each of the C scores.

    Raises
    ------
    DecodeError
        It is damaged, of another type or shape, or has scores that are NaN.
    """
    if path.suffix == ".npy":
        best: npt.NDArray[np.intp] = np.argmax(_read_scores(path, len(ids)), axis=0)
        return np.array(ids, dtype=np.uint8)[best]
    image = read_label(path)
    if image.ndim != 2 or image.dtype != np.uint8:
        found = f"{8 * image.dtype.itemsize}-bit {'colour' if image.ndim == 3 else 'grey'}"
        raise DecodeError(f"{path}: expected class ids as 8-bit grey, found {found}")
    return np.asarray(image)


def _read_scores(path: Path, classes: int) -> npt.NDArray[np.floating]:
    scores = read_array(path)
    if not np.issubdtype(scores.dtype, np.floating):
        raise DecodeError(f"{path}: expected floating scores, found {scores.dtype}")
    if scores.ndim != 3 or scores.shape[0] != classes:
        road = "; nimprep kitti evaluate scores maps of the road alone" if scores.ndim == 2 else ""
        raise DecodeError(
            f"{path}: expected scores ({classes}, H, W), one per class, found {scores.shape}{road}"
        )
    if not 0 < scores.shape[1] * scores.shape[2] <= MAX_PIXELS:
        raise DecodeError(
            f"{path}: expected scores of 1 to {MAX_PIXELS} pixels, found {scores.shape}"
        )
    if np.isnan(scores).any():
        raise DecodeError(f"{path}: expected numbers for scores, found NaN")
    return scores
