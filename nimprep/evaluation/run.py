"""Score folders of predictions against a store's labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError, DecodeError, LayoutError, StoreError
from nimprep.evaluation.comparison import Comparison, Method, method_names
from nimprep.evaluation.predictions import (
    check_names,
    prediction_files,
    read_prediction,
    split_of,
)
from nimprep.evaluation.scores import Evaluation
from nimprep.frame import IGNORE_LABEL
from nimprep.metrics import Counts, confusion_matrix
from nimprep.parallel import Progress, map_frames
from nimprep.store.reader import Store, open_store


def evaluate_predictions(
    store: Store | Path | str,
    predictions: Path | str,
    split: str | None = None,
    progress: Progress | None = None,
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
    found = compare_predictions(store, [predictions], split, progress=progress)
    return found.methods[0].evaluation


def compare_predictions(
    store: Store | Path | str,
    predictions: Sequence[Path | str] | Mapping[str, Path | str],
    split: str | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Score several methods' predictions of the same frames.

    Parameters
    ----------
    store : Store or path
    predictions : sequence of folders, or mapping of a method's name to its folder
        As for `evaluate_predictions`. Without names, the folders' own tell the methods apart.
    split, progress
        As for `evaluate_predictions`.

    Raises
    ------
    NimprepError
        As for `evaluate_predictions`; a folder is given twice, or they are of several splits.
    """
    store = _with_labels(store)
    if isinstance(predictions, Mapping):
        names, folders = list(predictions), [Path(p) for p in predictions.values()]
    else:
        folders = [Path(p) for p in predictions]
        names = method_names(folders)
    if not folders or len(set(names)) < len(names):
        found = ", ".join(map(str, folders)) or "none"
        raise LayoutError(f"predictions: expected different folders, found {found}")
    files = [prediction_files(folder) for folder in folders]
    split = split or _common_split(store, folders, files)
    wanted = store.indices(split)
    if not wanted.size:
        raise StoreError(f"{store.path}: expected frames in split {split!r}, found none")
    ids = [store.ids[i] for i in wanted]
    for folder, by_id in zip(folders, files, strict=True):
        check_names(folder, by_id, ids, split)

    def count(number: np.integer) -> list[Counts]:
        label = read_label_of(store, int(number))
        paths = [by_id[store.ids[number]] for by_id in files]
        return [_count_frame(store, int(number), label, path) for path in paths]

    counted = list(map_frames("evaluate", count, wanted.tolist(), progress))
    groups = {store.ids[i]: store.tables.group[i] for i in wanted}
    return Comparison(
        tuple(
            Method(
                name,
                folder,
                Evaluation(
                    store.classes,
                    split,
                    {i: c[n] for i, c in zip(ids, counted, strict=True)},
                    groups,
                ),
            )
            for n, (name, folder) in enumerate(zip(names, folders, strict=True))
        )
    )


def _with_labels(store: Store | Path | str) -> Store:
    if not isinstance(store, Store):
        store = open_store(store)
    if "label" not in store.modalities or not store.classes:
        raise StoreError(f"{store.path}: expected labels, found none; convert with labels")
    return store


def _common_split(
    store: Store, folders: Sequence[Path], files: Sequence[Mapping[str, Path]]
) -> str | None:
    """Return the split that all folders are of; None = the whole store."""
    splits = [split_of(store, list(by_id)) for by_id in files]
    for folder, split in zip(folders, splits, strict=True):
        if split != splits[0]:
            first, other = (f"split {s!r}" if s else "the store" for s in (splits[0], split))
            raise LayoutError(
                f"{folder}: expected predictions of {first} like {folders[0]}, "
                f"found predictions of {other}; name the split with --split"
            )
    return splits[0]


def read_label_of(store: Store, index: int) -> npt.NDArray[np.uint8]:
    """Return a frame's label, (H, W), without reading its other images."""
    height, width = store.camera(index).shape
    label: npt.NDArray[Any] = store.arrays["label"].read(index)[:height, :width]
    return label


def read_guess(store: Store, shape: tuple[int, ...], path: Path) -> npt.NDArray[np.integer]:
    """Return the class ids a file predicts for a frame of this shape.

    Raises
    ------
    DecodeError
        The file is bad, or of another size.
    """
    guess = read_prediction(path, [c.id for c in store.classes])
    if guess.shape != shape:
        (high, wide), (height, width) = shape, guess.shape
        raise DecodeError(
            f"{path}: expected the frame's {wide}x{high} pixels, found {width}x{height}"
        )
    return guess


def _count_frame(store: Store, index: int, label: npt.NDArray[np.uint8], path: Path) -> Counts:
    """Return a frame's confusion matrix in the order of the store's classes."""
    ids = [c.id for c in store.classes]
    guess = read_guess(store, label.shape, path)
    unknown = np.setdiff1d(guess[label != IGNORE_LABEL], ids)
    if unknown.size:
        raise DecodeError(f"{path}: expected class ids {ids}, found {unknown[0]}")
    try:
        counts = confusion_matrix(label, guess, max(ids) + 1)
    except ArrayError as error:
        raise StoreError(f"{store.path}: frame {store.ids[index]}: {error}") from error
    known = counts[np.ix_(ids, ids)]
    if known.sum() != counts.sum():
        raise StoreError(
            f"{store.path}: frame {store.ids[index]}: expected labels {ids} and {IGNORE_LABEL}, "
            "found others; nimprep validate --deep says more"
        )
    return known
