"""Scores as the KITTI road benchmark gives them, in either view."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError, DecodeError, LayoutError
from nimprep.kitti.bev import bring_to_bev, check_size, frame_calibration
from nimprep.kitti.confidences import Confidences, find_confidences, listed
from nimprep.kitti.images import GroundTruth, read_ground_truth
from nimprep.kitti.names import PredictionName, Target, truths_by_name
from nimprep.metrics import LEVELS, Counts, count_confidences, precision_recall_curve
from nimprep.parallel import Progress, map_frames

View = Literal["bev", "perspective"]

TABLES = ("um_road", "umm_road", "uu_road", "um_lane", "urban")
"""Every table there can be, in order; "urban" pools the road categories."""


@dataclass(frozen=True)
class RoadScore:
    """Hold one table's row.

    Attributes
    ----------
    MaxF, AP, PRE, REC, FPR, FNR : float
        Percent: the highest F-score; average precision; and, at the highest F-score's threshold,
        precision, recall, false positive and false negative rate.
    best_threshold : float
        Confidence, 0 to 1, at or above which a pixel counts as road for the highest F-score;
        `best_threshold_percent` is the same in the scores' unit.
    positives, negatives : int
        Evaluated pixels by truth.
    """

    MaxF: float
    AP: float
    PRE: float
    REC: float
    FPR: float
    FNR: float
    best_threshold: float
    positives: int
    negatives: int

    @property
    def best_threshold_percent(self) -> float:
        """Confidence, 0 to 100, at or above which a pixel counts as road."""
        return 100 * self.best_threshold


@dataclass(frozen=True)
class Evaluation:
    """Hold the scores of a folder of predictions.

    Attributes
    ----------
    scores : dict of str to RoadScore
        By table, in the order of `TABLES`; those there are predictions for.
    frames : dict of str to int
        How many were scored, by table.
    """

    scores: dict[str, RoadScore]
    frames: dict[str, int]

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Return the scores as `nimprep kitti evaluate --json` prints them."""
        return {
            table: {
                "unit": "percent",
                **asdict(score),
                "best_threshold_percent": score.best_threshold_percent,
                "frames": self.frames[table],
            }
            for table, score in self.scores.items()
        }


def score_counts(counts: Counts) -> RoadScore:
    """Score counts of confidences, (2, 256), summed over a table's frames.

    Raises
    ------
    ArrayError
        No positive was counted.
    """
    curve = precision_recall_curve(counts)
    best = curve.best
    recall = float(curve.recall[best])
    return RoadScore(
        MaxF=100 * float(curve.f_score[best]),
        AP=100 * curve.average_precision,
        PRE=100 * float(curve.precision[best]),
        REC=100 * recall,
        FPR=100 * float(curve.false_positive_rate[best]),
        FNR=100 * (1 - recall),
        best_threshold=float(curve.thresholds[best]),
        positives=curve.positives,
        negatives=curve.negatives,
    )


def evaluate_predictions(
    predictions: Path | str,
    ground_truth: Path | str,
    calib: Path | str | None = None,
    view: View = "bev",
    progress: Progress | None = None,
    *,
    target: Target = "road",
    partial: bool = False,
) -> Evaluation:
    """Score a folder of predictions against a folder of ground truths.

    Parameters
    ----------
    predictions : folder
        ``<cat>_<type>_<number>`` or the frame's id (``um_000000``, ``training/um_000000``), as .png
        (confidences of 8 or 16 bits; where all are 0 and 1, masks) or .npy (probabilities in
        [0, 1]).
    ground_truth : folder
        The benchmark's ``gt_image_2``, or a part of it. For each type (road, lane) among the
        predictions, every ground truth needs a prediction.
    calib : folder, optional
        Calibrations; needed where an image has to be transformed.
    view : {"bev", "perspective"}
        In the bird's-eye view, images of other sizes than 400x800 are transformed first.
    target : {"road", "lane"}
        What predictions named by frame id predict.
    partial : bool
        Score those frames alone that have a prediction.

    Warns
    -----
    UserWarning
        Predictions without a ground truth are left out; some hold 0 and 1 alone, others more.

    Raises
    ------
    LayoutError
        A folder or a calibration is missing, a name is wrong, or a prediction is missing.
    DecodeError
        An image or a calibration is bad, sizes differ, or nothing is evaluated.
    """
    predictions, ground_truth = Path(predictions), Path(ground_truth)
    guesses = find_confidences(predictions, "training", target)
    truths = truths_by_name(ground_truth)
    wanted = _wanted_names(set(guesses.files), truths, predictions, ground_truth, partial)
    _warn_of_unscored(guesses, truths, predictions)
    pairs = Pairs(guesses, truths, None if calib is None else Path(calib), view)
    counted = dict(zip(wanted, map_frames("evaluate", pairs.count, wanted, progress), strict=True))
    flat = [name for name, counts in counted.items() if counts[:, 1].any() and _is_flat(counts)]
    guesses.warn_of_masks(flat, predictions)
    scores = _score_tables(counted, ground_truth)
    frames = Counter(table for name in counted for table in _tables_of(name))
    return Evaluation(scores, {table: frames[table] for table in scores})


def _tables_of(name: PredictionName) -> tuple[str, ...]:
    return (name.table, "urban") if name.target == "road" else (name.table,)


def _is_flat(counts: Counts) -> bool:
    return not counts[:, 2:].any()


def _score_tables(
    counted: Mapping[PredictionName, Counts], ground_truth: Path
) -> dict[str, RoadScore]:
    tables: dict[str, Counts] = {}
    for name, counts in counted.items():
        for table in _tables_of(name):
            tables[table] = tables.get(table, np.zeros((2, LEVELS), np.int64)) + counts
    scores = {}
    for table in TABLES:
        if table in tables:
            try:
                scores[table] = score_counts(tables[table])
            except ArrayError as error:
                raise DecodeError(
                    f"{ground_truth}: expected positive pixels in the evaluated area of {table}, "
                    "found none"
                ) from error
    return scores


def _wanted_names(
    guesses: Collection[PredictionName],
    truths: Mapping[PredictionName, Path],
    predictions: Path,
    ground_truth: Path,
    partial: bool,
) -> list[PredictionName]:
    targets = {name.target for name in guesses}
    wanted = [name for name in truths if name.target in targets]
    if not wanted:
        raise LayoutError(
            f"{ground_truth}: expected ground truth of type {' or '.join(sorted(targets))} "
            f"for the predictions in {predictions}, found none"
        )
    missing = [name.png for name in wanted if name not in guesses]
    if missing and not partial:
        raise LayoutError(
            f"{predictions}: expected a prediction for each of {len(wanted)} ground truths, found "
            f"{len(wanted) - len(missing)}; missing {listed(missing)}; "
            "--partial scores the frames that have one"
        )
    if len(missing) == len(wanted):
        names = sorted(name.frame for name in guesses)
        raise LayoutError(
            f"{predictions}: expected predictions of frames with a ground truth in {ground_truth}, "
            f"found {listed(names)}, which have none; predict training frames"
        )
    return [name for name in wanted if name in guesses]


def _warn_of_unscored(
    guesses: Confidences, truths: Mapping[PredictionName, Path], predictions: Path
) -> None:
    unscored = [path.name for name, path in guesses.files.items() if name not in truths]
    if unscored:
        warnings.warn(
            f"{predictions}: expected a ground truth for each prediction, found none for "
            f"{len(unscored)}, which are left out: {listed(unscored)}",
            stacklevel=3,
        )


@dataclass(frozen=True)
class Pairs:
    """Bring predictions and their ground truths together in one view.

    Attributes
    ----------
    guesses : Confidences
    truths : mapping of PredictionName to Path
    calib : Path or None
        Calibrations; needed where an image has to be transformed.
    view : {"bev", "perspective"}
    """

    guesses: Confidences
    truths: Mapping[PredictionName, Path]
    calib: Path | None
    view: View

    def count(self, name: PredictionName) -> Counts:
        """Count a frame's confidences, (2, 256)."""
        confidence, truth = self.read(name)
        return count_confidences(confidence, truth.positive, truth.evaluated)

    def read(self, name: PredictionName) -> tuple[npt.NDArray[np.uint8], GroundTruth]:
        """Return a prediction, (H, W) uint8, and its ground truth, both in one view.

        Raises
        ------
        LayoutError
            A calibration is needed and missing.
        DecodeError
            A file is bad, sizes differ, or nothing is evaluated.
        """
        guess_path, truth_path, calib = self.guesses.files[name], self.truths[name], self.calib
        confidence = self.guesses.read(name)
        truth = read_ground_truth(truth_path)
        if self.view == "bev":
            confidence = bring_to_bev(confidence, guess_path, calib, name.frame)
            truth = _truth_in_bev(truth, truth_path, calib, name.frame)
        elif calib is not None and (calib / f"{name.frame}.txt").is_file():
            calibration = frame_calibration(calib, name.frame, guess_path)
            check_size(confidence.shape, guess_path, calibration)
        if confidence.shape != truth.evaluated.shape:
            (height, width), (high, wide) = confidence.shape, truth.evaluated.shape
            raise DecodeError(
                f"{guess_path}: expected its ground truth's {wide}x{high} pixels, "
                f"found {width}x{height}"
            )
        return confidence, truth


def _truth_in_bev(truth: GroundTruth, path: Path, calib: Path | None, frame: str) -> GroundTruth:
    truth = GroundTruth(
        positive=bring_to_bev(truth.positive, path, calib, frame),
        evaluated=bring_to_bev(truth.evaluated, path, calib, frame),
    )
    if not truth.evaluated.any():
        raise DecodeError(f"{path}: expected evaluated pixels in the bird's-eye view, found none")
    return truth
