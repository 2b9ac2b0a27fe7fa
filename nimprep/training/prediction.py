"""Predict a store's frames: labels and scores as files that `evaluate` and `kitti` take.

PREDICTIONS/<frame id>.png         class ids, 8-bit grey
PREDICTIONS/scores/<frame id>.npy  (C, H, W) float32, a plane for each of the store's classes
PREDICTIONS/predictions.json       what was predicted, and by what
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import numpy.typing as npt
import torch

from nimprep import __version__
from nimprep.errors import ArrayError, StoreError
from nimprep.evaluation.predictions import ABOUT, SCORES, listed
from nimprep.frame import LabelClass
from nimprep.kitti.images import png_bytes
from nimprep.networks import RunModel, load_run
from nimprep.parallel import Progress, map_in_order, no_progress
from nimprep.store.reader import Store, open_store
from nimprep.training.distributed import device_from
from nimprep.training.predict_options import PredictKeywords, PredictOptions
from nimprep.training.prediction_folder import default_folder, predictions_folder
from nimprep.training.store_frames import Seen, StoreFrames

_FORMAT = "nimprep-predictions"


@dataclass(frozen=True)
class Predicted:
    """Say what was predicted.

    Attributes
    ----------
    folder : Path
        Of the label PNGs: `nimprep evaluate` takes it.
    scores : Path, optional
        The folder of scores within it, which `nimprep evaluate` and `nimprep kitti` take.
    ids : tuple of str
        The frames'.
    """

    folder: Path
    scores: Path | None
    ids: tuple[str, ...]


def predict(
    store: Store | Path | str,
    run: RunModel | Path | str,
    out: Path | str | None = None,
    options: PredictOptions | None = None,
    *,
    progress: Progress | None = None,
    **changes: Unpack[PredictKeywords],
) -> Predicted:
    """Predict the frames of a store's split by a trained network.

    Labels are the store's class ids; the run's classes are found among the store's by name. Files
    are of each frame's own size, and all there or none.

    Parameters
    ----------
    store : Store, path or URL
        Any that has what the setup needs, or the depth that it is derived from.
    run : path or RunModel
        The folder of a run of `nimprep train`, its best.pt, or what `load_run` made of it.
    out : path, optional
        A new or empty folder; None = beside the run, by its name and the split's.
    options : PredictOptions, optional
        Or by name, one by one.
    progress : callable, optional
        Called with the step and its frames; gives what is called after each.
    **changes
        Options by name.

    Raises
    ------
    StoreError
        There is no store or no frame in the split, it lacks what the setup needs, or a class of
        the run.
    ArrayError
        The run cannot be read, there is no such device, or no memory is left on it.
    LayoutError
        The folder is not new or empty, or cannot be written.
    """
    if options is not None and changes:
        raise ArrayError("options: expected them or others by name, found both; give one")
    given = options if options is not None else PredictOptions(**changes)
    model = run if isinstance(run, RunModel) else load_run(run)
    if out is None:
        if isinstance(run, RunModel):
            raise ArrayError("out: expected a folder for what load_run gave, found none; give one")
        out = default_folder(Path(run), given.split)
    opened = store if isinstance(store, Store) else open_store(store)
    numbers = _numbers(opened, given.split)
    classes = _Classes.of(opened, model)
    frames = StoreFrames(opened, model)
    if not isinstance(run, RunModel):
        model.to(device_from(given.device))
    ids = tuple(opened.ids[number] for number in numbers)
    if given.save_scores and any(i.partition("/")[0] == SCORES for i in ids):
        raise StoreError(
            f"{opened.path}: expected ids outside of {SCORES}/, which scores are written to, "
            "found some in it; leave --save-scores"
        )
    sources = [opened.storage.root] if opened.storage.root is not None else []
    with predictions_folder(Path(out), *sources, overwrite=given.overwrite) as folder:
        writer = _Writer(folder, classes, given.save_scores)
        done = (progress or no_progress)("predict", len(numbers))
        blank = _predict(model, frames, numbers, given.batch, writer, done)
        about = _about(run, model, opened, given, classes, len(ids))
        (folder / ABOUT).write_text(json.dumps(about, indent=2) + "\n")
    _say_blank(opened, blank)
    folder = Path(out)
    return Predicted(folder, folder / SCORES if given.save_scores else None, ids)


def _numbers(store: Store, split: str) -> list[int]:
    """Return the frames of a split."""
    found = store.indices(None if split == "all" else split).tolist()
    if not found:
        names = [*store.splits.values()]
        there = ", ".join(f"{names.count(name)} in {name}" for name in dict.fromkeys(names))
        raise StoreError(
            f"{store.path}: expected frames in split {split!r}, found {there or 'none at all'}; "
            "give another --split, or --split all"
        )
    return [int(number) for number in found]


@dataclass(frozen=True)
class _Classes:
    """Say what the run's classes are in a store.

    Attributes
    ----------
    classes : tuple of LabelClass
        The store's, or the run's where the store has none.
    places : list of int
        The run's, by their places among them.
    """

    classes: tuple[LabelClass, ...]
    places: list[int]

    @classmethod
    def of(cls, store: Store, model: RunModel) -> _Classes:
        """Find a run's classes among a store's.

        Raises
        ------
        StoreError
            One is not there.
        """
        if not store.classes:
            return cls(model.classes, [*range(len(model.classes))])
        names = [entry.name for entry in store.classes]
        own = [entry.name for entry in model.classes]
        if unknown := [name for name in own if name not in names]:
            raise StoreError(
                f"{store.path}: expected the classes that the network tells apart, "
                f"{', '.join(own)}, found none called {unknown[0]!r} among {', '.join(names)}; "
                "predict a store of the training's classes"
            )
        if more := [name for name in names if name not in own]:
            warnings.warn(
                f"{store.path}: expected the network's classes {', '.join(own)}, found "
                f"{', '.join(more)} too, which it never predicts",
                stacklevel=4,
            )
        return cls(store.classes, [names.index(name) for name in own])

    def planes(self, scores: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return scores of the store's classes, in its order; 0 of those that the run has not."""
        planes = np.zeros((len(self.classes), *scores.shape[1:]), np.float32)
        planes[self.places] = scores
        return planes

    def labels(self, planes: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
        """Return the class ids, (H, W), of such planes."""
        ids = np.array([self.classes[place].id for place in self.places], np.uint8)
        labels: npt.NDArray[np.uint8] = ids[planes[self.places].argmax(axis=0)]
        return labels


class _Writer:
    """Write a frame's files."""

    def __init__(self, folder: Path, classes: _Classes, save_scores: bool) -> None:
        self._folder, self._classes, self._save_scores = folder, classes, save_scores

    def write(self, frame_id: str, scores: npt.NDArray[np.float32]) -> None:
        """Write labels, and scores where they are asked for."""
        planes = self._classes.planes(scores)
        place = self._folder / f"{frame_id}.png"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(png_bytes(self._classes.labels(planes)))
        if self._save_scores:
            place = self._folder / SCORES / f"{frame_id}.npy"
            place.parent.mkdir(parents=True, exist_ok=True)
            np.save(place, planes)


def _predict(
    model: RunModel,
    frames: StoreFrames,
    numbers: Sequence[int],
    batch: int,
    writer: _Writer,
    done: Callable[[], None],
) -> dict[str, list[str]]:
    """Predict frames in order; return the ids of those that have nothing, by modality."""
    blank: dict[str, list[str]] = {}
    ids = frames.store.ids
    with closing(map_in_order(lambda n: (n, frames.read(n)), numbers)) as read:
        for some in _batches(read, batch):
            images = [
                torch.stack(parts) for parts in zip(*(s.images for _, s in some), strict=True)
            ]
            beside = [seen.depth for _, seen in some if seen.depth is not None]
            found = model.scores(images, torch.stack(beside) if beside else None).cpu().numpy()
            for (number, seen), scores in zip(some, found, strict=True):
                writer.write(ids[number], scores)
                for name in seen.blank:
                    blank.setdefault(name, []).append(ids[number])
                done()
    return blank


def _batches(read: Iterator[tuple[int, Seen]], most: int) -> Iterator[list[tuple[int, Seen]]]:
    """Yield frames that follow each other and are of one size, so many at most."""
    some: list[tuple[int, Seen]] = []
    for number, seen in read:
        if some and (len(some) == most or some[0][1].size != seen.size):
            yield some
            some = []
        some.append((number, seen))
    if some:
        yield some


def _say_blank(store: Store, blank: dict[str, list[str]]) -> None:
    for name, ids in blank.items():
        warnings.warn(
            f"{store.path}: expected {name} in every frame, found none anywhere in {len(ids)} "
            f"({listed(ids)}); they are predicted without it",
            stacklevel=3,
        )


def _about(
    run: RunModel | Path | str,
    model: RunModel,
    store: Store,
    options: PredictOptions,
    classes: _Classes,
    frames: int,
) -> dict[str, Any]:
    found = model.checkpoint
    setup = found.setup if isinstance(found.setup, str) else list(found.setup)
    return {
        "format": _FORMAT,
        "version": "1.0",
        "nimprep": __version__,
        "store": str(store.path),
        "run": None if isinstance(run, RunModel) else str(run),
        "network": found.network,
        "setup": setup,
        "split": options.split,
        "frames": frames,
        "classes": [{"id": entry.id, "name": entry.name} for entry in classes.classes],
        "scores": options.save_scores,
    }
