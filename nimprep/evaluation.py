"""Score a folder of predictions against a store's labels."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError, DecodeError, LayoutError, StoreError
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.images import read_label
from nimprep.metrics import (
    Counts,
    Scores,
    confusion_matrix,
    f_score_per_class,
    iou_per_class,
    pixel_accuracy,
    precision_per_class,
    recall_per_class,
)
from nimprep.store.reader import Store, open_store

BACKGROUND = 0
"""Id of the class that the mean leaves out, as the paper's average does."""

SUFFIXES = (".png", ".npy")
"""What a prediction's file may be."""

NAMED_AT_MOST = 10
"""Messages name this many frames and count the rest."""

MEASURES: dict[str, Callable[[Counts], Scores]] = {
    "f_score": f_score_per_class,
    "iou": iou_per_class,
    "precision": precision_per_class,
    "recall": recall_per_class,
}
"""The scores of a class, as functions of the confusion matrix."""


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Hold what predictions are worth.

    Attributes
    ----------
    classes : tuple of LabelClass
        The store's.
    split : str or None
        Whose frames they are; None = the whole store's.
    frames : dict of str to (C, C) int64
        Each frame's confusion matrix by frame id, rows the label, columns the prediction, both in
        the order of `classes`. Pixels labelled 255 are left out.
    """

    classes: tuple[LabelClass, ...]
    split: str | None
    frames: dict[str, Counts]

    @property
    def confusion(self) -> Counts:
        """(C, C) int64 of all frames together."""
        number = len(self.classes)
        return sum(self.frames.values(), np.zeros((number, number), np.int64))

    @property
    def scores(self) -> dict[str, Scores]:
        """(C,) float64 per measure, 0 to 1; NaN where it is undefined."""
        return {name: measure(self.confusion) for name, measure in MEASURES.items()}

    @property
    def mean(self) -> dict[str, float]:
        """Each measure's mean over the classes that are not background.

        A class that neither labels nor predictions have is left out; where one of the two has it,
        an undefined precision or recall counts as 0. NaN where no class is left.
        """
        confusion = self.confusion
        seen = (confusion.sum(axis=0) + confusion.sum(axis=1)) > 0
        counted = seen & np.array([c.id != BACKGROUND for c in self.classes], dtype=bool)
        if not counted.any():
            return dict.fromkeys(MEASURES, math.nan)
        return {
            name: float(np.nan_to_num(values[counted]).mean())
            for name, values in self.scores.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """Return what `nimprep evaluate --json` prints (schemas/evaluation.schema.json)."""
        confusion, scores = self.confusion, self.scores
        return {
            "split": self.split,
            "frames": len(self.frames),
            "pixels": int(confusion.sum()),
            "classes": [
                {
                    "id": c.id,
                    "name": c.name,
                    "pixels": int(confusion[i].sum()),
                    **{name: _or_none(values[i]) for name, values in scores.items()},
                }
                for i, c in enumerate(self.classes)
            ],
            "mean": {name: _or_none(value) for name, value in self.mean.items()},
            "accuracy": _or_none(pixel_accuracy(confusion)),
            "confusion": confusion.tolist(),
        }


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def evaluate_predictions(
    store: Store | Path | str,
    predictions: Path | str,
    split: str | None = None,
    progress: Callable[[str, int], Callable[[], None]] | None = None,
) -> Evaluation:
    """Score a folder of predictions against a store's labels.

    Parameters
    ----------
    store : Store or path
        It must have labels.
    predictions : folder
        ``<frame id>.png``, (H, W) class ids of 8 bits, or ``<frame id>.npy``, (C, H, W) floating
        scores of the store's classes, the highest of which wins. An id with "/" lies in
        subfolders. H and W are the frame's own.
    split : str, optional
        Each of its frames needs a prediction, and no other may have one. None = the split that
        all predictions are of, or the whole store where they are of several.
    progress : callable, optional
        Called with the step and its frames; gives what is called after each.

    Raises
    ------
    StoreError
        There is no store or no such split, or it has no labels.
    LayoutError
        There is no folder, a prediction is missing, twice there or of no frame.
    DecodeError
        A prediction is damaged, or of another size or type.
    """
    if not isinstance(store, Store):
        store = open_store(store)
    if "label" not in store.modalities or not store.classes:
        raise StoreError(f"{store.path}: expected labels, found none; convert with labels")
    folder = Path(predictions)
    files = _prediction_files(folder)
    split = split or _split_of(store, files)
    wanted = store.indices(split)
    if not wanted.size:
        raise StoreError(f"{store.path}: expected frames in split {split!r}, found none")
    ids = [store.ids[i] for i in wanted]
    _check_names(folder, files, ids, split)
    done = progress("evaluate", len(ids)) if progress else lambda: None
    frames = {}
    for number, frame_id in zip(wanted, ids, strict=True):
        frames[frame_id] = _count_frame(store, int(number), files[frame_id])
        done()
    return Evaluation(store.classes, split, frames)


def _prediction_files(folder: Path) -> dict[str, Path]:
    """Return each prediction's file by frame id."""
    if not folder.is_dir():
        raise LayoutError(f"{folder}: expected a folder of predictions, found none")
    files: dict[str, Path] = {}
    for path in sorted(folder.rglob("*")):
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


def _split_of(store: Store, files: Collection[str]) -> str | None:
    """Return the one split that the predictions are of; None where they are of several."""
    found = {name for frame_id, name in store.splits.items() if frame_id in files}
    only = found.pop() if len(found) == 1 else None
    return None if only == "none" else only


def _check_names(
    folder: Path, files: Collection[str], ids: Sequence[str], split: str | None
) -> None:
    """Raise where a frame has no prediction or a prediction no frame."""
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


def _count_frame(store: Store, number: int, path: Path) -> Counts:
    """Return a frame's confusion matrix in the order of the store's classes."""
    label = store[number].label
    if label is None:
        raise StoreError(f"{store.path}: expected a label of {store.ids[number]}, found none")
    ids = [c.id for c in store.classes]
    guess = read_prediction(path, ids)
    if guess.shape != label.shape:
        (high, wide), (height, width) = label.shape, guess.shape
        raise DecodeError(
            f"{path}: expected the frame's {wide}x{high} pixels, found {width}x{height}"
        )
    unknown = np.setdiff1d(guess[label != IGNORE_LABEL], ids)
    if unknown.size:
        raise DecodeError(f"{path}: expected class ids {ids}, found {unknown[0]}")
    try:
        counts = confusion_matrix(label, guess, max(ids) + 1)
    except ArrayError as error:
        raise StoreError(f"{store.path}: frame {store.ids[number]}: {error}") from error
    return counts[np.ix_(ids, ids)]


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
    try:
        scores: object = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise DecodeError(f"{path}: expected a NumPy array file, found {error}") from error
    if not isinstance(scores, np.ndarray) or not np.issubdtype(scores.dtype, np.floating):
        found = getattr(scores, "dtype", type(scores).__name__)
        raise DecodeError(f"{path}: expected floating scores, found {found}")
    if scores.ndim != 3 or scores.shape[0] != classes:
        raise DecodeError(
            f"{path}: expected scores ({classes}, H, W), one per class, found {scores.shape}"
        )
    if np.isnan(scores).any():
        raise DecodeError(f"{path}: expected numbers for scores, found NaN")
    return scores
