"""Scores by counting pixel by pixel, threshold by threshold."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


def confusion(
    label: npt.NDArray[np.uint8], prediction: npt.NDArray[np.uint8], classes: int
) -> npt.NDArray[np.int64]:
    counts = np.zeros((classes, classes), np.int64)
    for truth, guess in zip(label.flat, prediction.flat, strict=True):
        if truth != 255:
            counts[truth, guess] += 1
    return counts


def road_scores(
    confidence: npt.NDArray[np.uint8],
    positive: npt.NDArray[np.bool_],
    evaluated: npt.NDArray[np.bool_],
) -> dict[str, float]:
    """Try 256 thresholds k/255; a pixel at or above is road; 11-point average precision."""
    rows = []
    for k in range(256):
        called = confidence / 255 >= k / 255
        tp = int((called & positive & evaluated).sum())
        fp = int((called & ~positive & evaluated).sum())
        fn = int((~called & positive & evaluated).sum())
        tn = int((~called & ~positive & evaluated).sum())
        precision = tp / (tp + fp) if tp + fp else 0.0
        recall = tp / (tp + fn)
        f = 2 * precision * recall / (precision + recall) if tp else 0.0
        rows.append((f, precision, recall, fp / (fp + tn) if fp + tn else 0.0, k / 255))
    best = max(rows, key=lambda row: row[0])
    points = [max(p for _, p, recall, _, _ in rows if recall >= r) for r in np.arange(0, 1.1, 0.1)]
    return {
        "MaxF": 100 * best[0],
        "AP": 100 * sum(points) / 11,
        "PRE": 100 * best[1],
        "REC": 100 * best[2],
        "FPR": 100 * best[3],
        "FNR": 100 * (1 - best[2]),
        "best_threshold": best[4],
    }
