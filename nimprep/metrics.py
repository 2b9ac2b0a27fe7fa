"""Scores of a segmentation, from pure arrays.

Three families: a confusion matrix of class ids (IoU, F-score, precision and recall per class),
counts of confidences against a binary truth (precision-recall curve, MaxF, average precision), and
how well one number tells two classes apart, whatever the threshold (area under the ROC curve).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from nimprep.arrays import unmasked, without_mask
from nimprep.errors import ArrayError
from nimprep.frame import IGNORE_LABEL

Counts = npt.NDArray[np.int64]
Scores = npt.NDArray[np.float64]

LEVELS = 256
"""Confidences are counted at 0/255, 1/255 ... 255/255, which are also the thresholds tried."""

_SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")

_RECALLS = np.arange(11) * 0.1
"""0, 0.1 ... 1 as floating point gives them (0.3 is 0.30000000000000004): the official scores
compare recall with these, so a recall of exactly 3/10 does not reach the fourth point."""


def confusion_matrix(
    label: npt.NDArray[np.integer],
    prediction: npt.NDArray[np.integer],
    classes: int,
    ignore: int = IGNORE_LABEL,
) -> Counts:
    """Count pixels by true and predicted class; matrices of several frames add up.

    Parameters
    ----------
    label, prediction : integer arrays of one shape
        Class ids 0 to classes - 1. Pixels whose *label* is `ignore` or masked are left out.
    classes : int
        How many there are.

    Returns
    -------
    (classes, classes) int64
        Rows: the label; columns: the prediction.

    Raises
    ------
    ArrayError
        Shapes differ, the arrays hold no integers, an id outside the classes, or the prediction is
        masked where the label counts.
    """
    left_out, unsaid = np.ma.getmask(label), np.ma.getmask(prediction)
    label, prediction = np.asarray(label), np.asarray(prediction)
    if label.shape != prediction.shape:
        raise ArrayError(
            f"prediction: expected the label's shape {label.shape}, found {prediction.shape}"
        )
    for name, array in (("label", label), ("prediction", prediction)):
        if not np.issubdtype(array.dtype, np.integer):
            raise ArrayError(f"{name}: expected integer class ids, found {array.dtype}")
    kept = (label != ignore) & ~left_out
    if (kept & unsaid).any():
        raise ArrayError(
            "prediction: expected a class wherever the label has one, "
            f"found {(kept & unsaid).sum()} masked pixels; mask the label there"
        )
    truth, guess = label[kept].astype(np.int64), prediction[kept].astype(np.int64)
    for name, ids in (("label", truth), ("prediction", guess)):
        wrong = ids[(ids < 0) | (ids >= classes)]
        if wrong.size:
            raise ArrayError(f"{name}: expected class ids 0 to {classes - 1}, found {wrong[0]}")
    counts = np.bincount(truth * classes + guess, minlength=classes * classes)
    return counts.astype(np.int64, copy=False).reshape(classes, classes)


def _ratio(part: npt.NDArray[np.integer], whole: npt.NDArray[np.integer]) -> Scores:
    """Divide; where there is nothing to divide by, NaN."""
    result = np.full(np.shape(whole), np.nan)
    np.divide(part, whole, out=result, where=whole != 0)
    return result


def precision_per_class(confusion: Counts) -> Scores:
    """Return TP / (TP + FP) per class, (classes,); NaN where a class was never predicted."""
    confusion = without_mask(confusion, "confusion")
    return _ratio(np.diag(confusion), confusion.sum(axis=0))


def recall_per_class(confusion: Counts) -> Scores:
    """Return TP / (TP + FN) per class, (classes,); NaN where a class never occurs."""
    confusion = without_mask(confusion, "confusion")
    return _ratio(np.diag(confusion), confusion.sum(axis=1))


def f_score_per_class(confusion: Counts) -> Scores:
    """Return 2 TP / (2 TP + FP + FN) per class, (classes,); NaN where neither side has it."""
    confusion = without_mask(confusion, "confusion")
    return _ratio(2 * np.diag(confusion), confusion.sum(axis=0) + confusion.sum(axis=1))


def iou_per_class(confusion: Counts) -> Scores:
    """Return TP / (TP + FP + FN) per class, (classes,); NaN where neither side has it."""
    confusion = without_mask(confusion, "confusion")
    hits = np.diag(confusion)
    return _ratio(hits, confusion.sum(axis=0) + confusion.sum(axis=1) - hits)


def pixel_accuracy(confusion: Counts) -> float:
    """Return the share of pixels whose class is right; NaN where nothing was counted."""
    confusion = without_mask(confusion, "confusion")
    return float(_ratio(np.trace(confusion)[None], confusion.sum()[None])[0])


def count_confidences(
    confidence: npt.NDArray[np.uint8],
    positive: npt.NDArray[np.bool_],
    evaluated: npt.NDArray[np.bool_] | None = None,
) -> Counts:
    """Count pixels by truth and confidence; counts of several frames add up.

    Parameters
    ----------
    confidence : (H, W) uint8
        255 = surely positive.
    positive : (H, W) bool
        The truth; masked pixels are not counted.
    evaluated : (H, W) bool, optional
        Which pixels to count; None = all, masked = not.

    Returns
    -------
    (2, 256) int64
        Row 0 the negatives, row 1 the positives; columns by confidence.

    Raises
    ------
    ArrayError
        The shapes differ, or the confidences are not uint8 or masked.
    """
    confidence = without_mask(confidence, "confidence")
    if confidence.dtype != np.uint8:
        raise ArrayError(f"confidence: expected uint8, found {confidence.dtype}")
    for name, mask in (("positive", positive), ("evaluated", evaluated)):
        if mask is not None and np.shape(mask) != confidence.shape:
            raise ArrayError(
                f"{name}: expected the confidence's shape {confidence.shape}, "
                f"found {np.shape(mask)}"
            )
    cell = confidence + np.uint16(LEVELS) * np.asarray(positive, dtype=bool)
    unknown = np.ma.getmask(positive)
    if evaluated is not None or unknown is not np.ma.nomask:
        counted = True if evaluated is None else unmasked(evaluated, False).astype(bool)
        cell = cell[counted & ~unknown]
    counts = np.bincount(cell.reshape(-1), minlength=2 * LEVELS)
    return counts.astype(np.int64, copy=False).reshape(2, LEVELS)


@dataclass(frozen=True)
class PrecisionRecallCurve:
    """Hold what happens at each threshold; a pixel is called positive at or above it.

    Attributes
    ----------
    thresholds : (256,) float64
        k / 255, rising.
    true_positives, false_positives : (256,) int64
        Pixels called positive, by truth.
    positives, negatives : int
        All counted pixels, by truth.
    """

    thresholds: Scores
    true_positives: Counts
    false_positives: Counts
    positives: int
    negatives: int

    @property
    def precision(self) -> Scores:
        """TP / (TP + FP); 0 where nothing is called positive."""
        return np.nan_to_num(
            _ratio(self.true_positives, self.true_positives + self.false_positives)
        )

    @property
    def recall(self) -> Scores:
        """TP / (TP + FN)."""
        return self.true_positives / self.positives

    @property
    def false_positive_rate(self) -> Scores:
        """FP / (FP + TN); 0 where there are no negatives."""
        return self.false_positives / max(self.negatives, 1)

    @property
    def f_score(self) -> Scores:
        """2 TP / (2 TP + FP + FN), the harmonic mean of precision and recall."""
        called = self.true_positives + self.false_positives
        return 2 * self.true_positives / (called + self.positives)

    @property
    def best(self) -> int:
        """Index of the highest F-score; the lowest threshold of several."""
        return int(np.argmax(self.f_score))

    @property
    def average_precision(self) -> float:
        """Mean over recalls 0, 0.1 ... 1 of the best precision at that recall or above.

        The 11-point interpolation of PASCAL VOC 2007 (Everingham et al., IJCV 2010, eq. 1-2),
        which the KITTI road benchmark takes over (Fritsch et al., ITSC 2013).
        """
        # Recall falls as the threshold rises, so the thresholds that reach a recall come first.
        best_so_far = np.maximum.accumulate(self.precision)
        reached = np.searchsorted(-self.recall, -_RECALLS, side="right")
        return float(best_so_far[reached - 1].mean())


def precision_recall_curve(counts: Counts) -> PrecisionRecallCurve:
    """Build the curve from counts of confidences.

    Parameters
    ----------
    counts : (2, 256) int64
        As `count_confidences` gives them, summed over frames.

    Raises
    ------
    ArrayError
        Another shape, or no positive was counted: recall means nothing then.
    """
    counts = without_mask(counts, "counts")
    if np.shape(counts) != (2, LEVELS):
        raise ArrayError(f"counts: expected shape (2, {LEVELS}), found {np.shape(counts)}")
    at_or_above = np.cumsum(counts[:, ::-1], axis=1)[:, ::-1]
    negatives, positives = (int(n) for n in at_or_above[:, 0])
    if positives == 0:
        raise ArrayError("counts: expected positive pixels, found none; recall is undefined")
    return PrecisionRecallCurve(
        thresholds=np.arange(LEVELS) / (LEVELS - 1),
        true_positives=at_or_above[1],
        false_positives=at_or_above[0],
        positives=positives,
        negatives=negatives,
    )


def roc_auc(scores: npt.NDArray[np.floating], positive: npt.NDArray[np.bool_]) -> float:
    """Return the area under the ROC curve: how well a number tells positives from negatives.

    The probability that a positive drawn at random has the higher score of the two, a tie counting
    one half: 1 = every positive is above every negative, 0.5 = the scores tell nothing, 0 = all are
    below. Where it does not matter which side is the higher, take the greater of it and 1 minus it.

    Parameters
    ----------
    scores : (N,) array of numbers
        Leave out what has none.
    positive : (N,) bool
        The truth.

    Raises
    ------
    ArrayError
        The shapes differ, a score is NaN or masked, or one of the two sides is empty.

    References
    ----------
    Fawcett, "An introduction to ROC analysis", Pattern Recognition Letters 27, 2006, section 7: the
    area is the Wilcoxon rank statistic of the two sides.
    """
    values, truth = without_mask(scores, "scores"), without_mask(positive, "positive").astype(bool)
    if values.ndim != 1 or values.shape != truth.shape:
        raise ArrayError(
            f"scores: expected (N,) numbers and as many truths, found shapes {values.shape} and "
            f"{truth.shape}; flatten both"
        )
    if values.dtype.kind == "f" and np.isnan(values).any():
        raise ArrayError(
            f"scores: expected numbers, found {int(np.isnan(values).sum())} of NaN; leave them out"
        )
    below, above = np.sort(values[~truth]), values[truth]
    if not below.size or not above.size:
        raise ArrayError(
            f"positive: expected positives and negatives, found {above.size} and {below.size}; "
            "the area is undefined"
        )
    lower, not_higher = (np.searchsorted(below, above, side) for side in _SIDES)
    return float((lower.mean() + not_higher.mean()) / (2 * below.size))
