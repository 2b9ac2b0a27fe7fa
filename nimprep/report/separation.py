"""How well each modality alone tells the road from other classes, on a sample of a store."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.recipe import recipe_from
from nimprep.errors import ArrayError
from nimprep.frame import IGNORE_LABEL, Frame, LabelClass
from nimprep.metrics import roc_auc
from nimprep.parallel import Progress, map_in_order, no_progress
from nimprep.report.features import Source, image_of, numbers_of, sources
from nimprep.splits import hash_order
from nimprep.store.reader import Store

FRAMES = 24
"""At most so many frames are looked at."""

PIXELS = 10_000
"""And at most so many pixels of a class in a frame."""

LEAST = 20
"""Of fewer pixels of a class a frame tells nothing."""

COLUMNS = 6
"""So many classes, those of most pixels, are held against the road."""

_ROAD_SHARE = 0.05
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Score:
    """Say how well a number tells the road from a class.

    Attributes
    ----------
    auc : float
        Area under the ROC curve, its mean over frames, whichever side is the higher: 0.5 to 1.
    higher : bool
        Whether the road has the higher numbers.
    low, high : float
        The least and the greatest of a frame, that side being the higher: may be below 0.5.
    frames : int
    """

    auc: float
    higher: bool
    low: float
    high: float
    frames: int


@dataclass(frozen=True)
class Row:
    """Hold the scores of one number.

    Attributes
    ----------
    name : str
        The modality's title, how it is made, and which number of it.
    modality : str
    stored : bool
    added, options : str
        What `convert` has to be given to store it: a further name for `--modalities`, and other
        options; "" = none.
    scores : tuple of Score or None
        Per class; None = no frame has enough pixels of both with a value.
    missing : float
        Share of the sampled pixels, which have depth where the store has some, without a value.
    """

    name: str
    modality: str
    stored: bool
    added: str
    options: str
    scores: tuple[Score | None, ...]
    missing: float

    @property
    def rank(self) -> float:
        """The mean of the scores; 0 without any."""
        known = [score.auc for score in self.scores if score is not None]
        return sum(known) / len(known) if known else 0.0


@dataclass(frozen=True)
class Separation:
    """Hold what tells the road from other classes.

    Attributes
    ----------
    road : LabelClass
    others : tuple of LabelClass
        What it is told from, a column each.
    left_out : int
        Further classes.
    frames : int
        That were looked at.
    rows : tuple of Row
        The best first.
    modalities : tuple of str
        What the store has.
    reason : str
        Why there is nothing to say; "" = there is.
    """

    road: LabelClass | None
    others: tuple[LabelClass, ...] = ()
    left_out: int = 0
    frames: int = 0
    rows: tuple[Row, ...] = ()
    modalities: tuple[str, ...] = ()
    reason: str = ""

    def best(self, column: int) -> Row | None:
        """Return the row that tells a class best; None = none does."""
        known = [(row.scores[column], row) for row in self.rows]
        scored = [(score.auc, row) for score, row in known if score is not None]
        return max(scored, key=lambda pair: pair[0])[1] if scored else None


Areas = dict[tuple[int, str], dict[int, float]]
"""A frame's areas by source and number, and by class."""


def measure_separation(
    store: Store,
    class_pixels: npt.NDArray[np.int64],
    road: str | None = None,
    progress: Progress | None = None,
    num_threads: int | None = None,
) -> Separation:
    """Measure what tells a store's road from its other classes, on at most `FRAMES` frames.

    Parameters
    ----------
    store : Store
    class_pixels : (N, C) int64
        Pixels of each of the store's classes in each frame.
    road : str, optional
        The class to tell from the others; None = of those with 5 % of the labelled pixels the one
        that lies lowest in the images.
    num_threads : int, optional
        None = all cores. The result is the same.

    Raises
    ------
    ArrayError
        The store has no class of this name.
    StoreError
        The store is damaged.

    Notes
    -----
    Frames are drawn by a hash of their ids, in turn those of each class, and at most `PIXELS` of a
    class's pixels, those with depth where the store has some, spread evenly over it. The area is
    that of each frame by itself; their mean is then taken whichever side is the higher, once for
    all frames, so that chance in single frames does not look like knowledge.
    """
    classes = store.classes
    if road is not None and road not in [c.name for c in classes]:
        known = ", ".join(c.name for c in classes) or "none"
        raise ArrayError(f"{store.path}: expected a class of {known}, found {road!r}; name one")
    if "label" not in store.modalities or not class_pixels.sum():
        return Separation(None, reason="No pixel of this store has a label.")
    several = (class_pixels >= LEAST).sum(axis=1) > 1
    if not several.any():
        return Separation(None, reason="No frame has two classes that could be told apart.")
    chosen = _chosen(store, class_pixels, several)
    column = _road(store, class_pixels, chosen, road)
    others = [
        int(c)
        for c in np.argsort(-class_pixels.sum(axis=0), kind="stable")
        if c != column and class_pixels[:, c].sum()
    ]
    kept = others[:COLUMNS]
    ids = {c: classes[c].id for c in kept}
    looked = sources(
        {name: array.modality for name, array in store.arrays.items()},
        recipe_from(store.about.modalities),
        calibrated=bool(np.isfinite(store.tables.cam_to_road).all(axis=(1, 2)).any()),
    )
    done = (progress or no_progress)("comparing", len(chosen))

    def work(index: int) -> tuple[Areas, dict[tuple[int, str], npt.NDArray[np.int64]]]:
        found = frame_areas(store[index], looked, classes[column].id, list(ids.values()))
        done()
        return found

    rows = _rows(looked, list(map_in_order(work, chosen, num_threads)), list(ids.values()))
    return Separation(
        classes[column],
        tuple(classes[c] for c in kept),
        len(others) - len(kept),
        len(chosen),
        rows,
        store.modalities,
    )


def _chosen(
    store: Store, class_pixels: npt.NDArray[np.int64], several: npt.NDArray[np.bool_]
) -> list[int]:
    """Return the frames to look at, ascending: in turn one of each class, by a hash of the ids."""
    rank = {name: place for place, name in enumerate(hash_order(store.ids))}
    order = sorted(np.flatnonzero(several).tolist(), key=lambda i: rank[store.ids[i]])
    lists = [[i for i in order if column[i] >= LEAST] for column in class_pixels.T]
    found: dict[int, None] = {}
    for place in range(len(order)):
        found |= {of[place]: None for of in lists if place < len(of)}
        if len(found) >= FRAMES:
            break
    return sorted(list(found)[:FRAMES])


def _road(
    store: Store, class_pixels: npt.NDArray[np.int64], chosen: Sequence[int], road: str | None
) -> int:
    """Return the column of the class that is the road."""
    names = [c.name for c in store.classes]
    if road is not None:
        return names.index(road)
    share = class_pixels.sum(axis=0) / class_pixels.sum()
    heights = np.zeros((2, IGNORE_LABEL + 1))
    for index in chosen:
        height, width = (int(n) for n in store.tables.image_size[index])
        label = store.arrays["label"].read(index)[:height, :width].reshape(-1)
        rows = np.repeat((np.arange(height) + 0.5) / height, width)
        heights[0] += np.bincount(label, rows, IGNORE_LABEL + 1)
        heights[1] += np.bincount(label, minlength=IGNORE_LABEL + 1)
    mean = heights[0] / np.maximum(heights[1], 1)
    large = [c for c in range(len(names)) if share[c] >= min(_ROAD_SHARE, share.max())]
    return max(large, key=lambda c: mean[store.classes[c].id])


def spread(candidates: npt.NDArray[np.intp], count: int) -> npt.NDArray[np.intp]:
    """Return at most so many of the candidates, evenly spread, in no step with an image's rows."""
    if candidates.size <= count:
        return candidates
    places = (np.arange(count) * _GOLDEN % 1 * candidates.size).astype(np.intp)
    return candidates[np.unique(places)]


def frame_areas(
    frame: Frame, looked: Sequence[Source], road: int, others: Sequence[int]
) -> tuple[Areas, dict[tuple[int, str], npt.NDArray[np.int64]]]:
    """Return how well each number tells one frame's road from its other classes.

    Returns
    -------
    areas : dict
        By (place in `looked`, name of the number) and class: the probability that a pixel of the
        road has the higher number; a class is left out where it, or the road, has fewer than
        `LEAST` pixels with a value.
    counts : dict
        By the same: pixels without a value, and all that were looked at.
    """
    if frame.label is None:
        return {}, {}
    flat = frame.label.reshape(-1)
    usable = np.ones(flat.size, bool) if frame.depth_m is None else frame.depth_m.reshape(-1) > 0
    samples = {c: spread(np.flatnonzero((flat == c) & usable), PIXELS) for c in (road, *others)}
    places = np.concatenate(list(samples.values()))
    of = np.repeat(list(samples), [chosen.size for chosen in samples.values()])
    areas: Areas = {}
    counts: dict[tuple[int, str], npt.NDArray[np.int64]] = {}
    for number, source in enumerate(looked):
        for name, values in _numbers(source, frame, places, of == road).items():
            known = ~np.isnan(values)
            counts[number, name] = np.array([(~known).sum(), known.size])
            of_class = {c: values[(of == c) & known] for c in samples}
            areas[number, name] = {
                c: roc_auc(
                    np.concatenate([of_class[road], of_class[c]]),
                    np.arange(of_class[road].size + of_class[c].size) < of_class[road].size,
                )
                for c in others
                if min(of_class[road].size, of_class[c].size) >= LEAST
            }
    return areas, counts


def _numbers(
    source: Source, frame: Frame, places: npt.NDArray[np.intp], road: npt.NDArray[np.bool_]
) -> dict[str, npt.NDArray[np.float32]]:
    image = image_of(source, frame)
    if image is None:
        image = source.modality.blank(frame.camera.shape)
    pixels = image.reshape(frame.camera.width * frame.camera.height, -1)[places]
    return numbers_of(source.modality, pixels if source.modality.channels else pixels[:, 0], road)


def _rows(
    looked: Sequence[Source], frames: Sequence[Any], others: Sequence[int]
) -> tuple[Row, ...]:
    """Return the rows, the best first, of what `frame_areas` said of each frame."""
    found: dict[tuple[int, str], dict[int, list[float]]] = {}
    counts: dict[tuple[int, str], npt.NDArray[np.int64]] = {}
    for areas, counted in frames:
        for key, by_class in areas.items():
            lists = found.setdefault(key, defaultdict(list))
            counts[key] = counts.get(key, np.zeros(2, np.int64)) + counted[key]
            for of, area in by_class.items():
                lists[of].append(area)
    rows: dict[object, Row] = {}
    for (number, name), lists in found.items():
        row = _row(looked[number], name, lists, counts[number, name], others)
        first = rows.setdefault((row.modality, name, row.scores), row)
        if first is not row:
            # A choice that makes no difference here is none.
            same = replace(first, name=_named(looked[number].title, name), options="")
            rows[row.modality, name, row.scores] = same
    return tuple(sorted(rows.values(), key=lambda row: -row.rank))


def _named(label: str, number: str) -> str:
    return f"{label}: {number}" if number else label


def _row(
    source: Source,
    name: str,
    lists: Mapping[int, list[float]],
    counted: npt.NDArray[np.int64],
    others: Sequence[int],
) -> Row:
    return Row(
        _named(source.label, name),
        source.modality.name,
        source.recipe is None,
        source.added,
        source.options,
        tuple(_score(lists.get(c, [])) for c in others),
        float(counted[0] / max(counted[1], 1)),
    )


def _score(areas: Sequence[float]) -> Score | None:
    if not areas:
        return None
    mean = float(np.mean(areas))
    higher = mean >= 0.5
    sided = [a if higher else 1 - a for a in areas]
    return Score(mean if higher else 1 - mean, higher, min(sided), max(sided), len(areas))
