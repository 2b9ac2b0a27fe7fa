"""Scores on cases counted by hand, and against a plain twin."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep.errors import ArrayError
from nimprep.kitti.evaluation import score_counts
from nimprep.metrics import (
    confusion_matrix,
    count_confidences,
    f_score_per_class,
    iou_per_class,
    pixel_accuracy,
    precision_per_class,
    precision_recall_curve,
    recall_per_class,
    roc_auc,
)
from tests.naive.scores import confusion as naive_confusion
from tests.naive.scores import road_scores

LABEL = np.array([[0, 0, 0, 1], [1, 1, 2, 255]], np.uint8)
GUESS = np.array([[0, 0, 1, 1], [1, 0, 2, 0]], np.uint8)


def test_a_confusion_matrix_has_the_label_in_rows_and_leaves_ignored_pixels_out() -> None:
    expected = [[2, 1, 0], [1, 2, 0], [0, 0, 1]]
    np.testing.assert_array_equal(confusion_matrix(LABEL, GUESS, 3), expected)


def test_scores_per_class_are_those_counted_by_hand() -> None:
    counts = np.array([[2, 1, 0], [3, 4, 0], [0, 0, 0]])
    np.testing.assert_allclose(precision_per_class(counts), [2 / 5, 4 / 5, np.nan])
    np.testing.assert_allclose(recall_per_class(counts), [2 / 3, 4 / 7, np.nan])
    np.testing.assert_allclose(f_score_per_class(counts), [4 / 8, 8 / 12, np.nan])
    np.testing.assert_allclose(iou_per_class(counts), [2 / 6, 4 / 8, np.nan])
    assert pixel_accuracy(counts) == 0.6


def test_accuracy_of_nothing_is_nan() -> None:
    assert np.isnan(pixel_accuracy(np.zeros((2, 2), np.int64)))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_a_confusion_matrix_equals_its_plain_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    label = rng.choice(np.array([0, 1, 2, 255], np.uint8), (5, 7))
    guess = rng.integers(0, 3, (5, 7)).astype(np.uint8)
    np.testing.assert_array_equal(
        confusion_matrix(label, guess, 3), naive_confusion(label, guess, 3)
    )


@pytest.mark.parametrize(
    ("label", "guess", "message"),
    [
        (LABEL, GUESS[:1], "expected the label's shape"),
        (LABEL.astype(float), GUESS, "label: expected integer"),
        (LABEL, GUESS + 3, "prediction: expected class ids 0 to 2, found"),
        (np.full((2, 4), 9), GUESS, "label: expected class ids 0 to 2, found 9"),
    ],
)
def test_arrays_that_are_no_classes_are_refused(
    label: np.ndarray, guess: np.ndarray, message: str
) -> None:
    with pytest.raises(ArrayError, match=message):
        confusion_matrix(label, guess, 3)


def test_a_perfect_prediction_scores_a_hundred() -> None:
    road = np.arange(100).reshape(10, 10) > 60
    score = score_counts(count_confidences(np.where(road, 200, 10).astype(np.uint8), road))
    assert (score.MaxF, score.AP, score.PRE, score.REC) == (100, 100, 100, 100)
    assert (score.FPR, score.FNR) == (0, 0)
    # The lowest of the thresholds that do: 11/255 is the first above the background's 10.
    assert score.best_threshold == 11 / 255


def test_a_pixel_at_the_threshold_counts_as_positive() -> None:
    curve = precision_recall_curve(
        count_confidences(np.array([[128, 0]], np.uint8), np.array([[True, False]]))
    )
    assert curve.recall[128] == 1
    assert curve.recall[129] == 0


def test_scores_of_four_pixels_are_those_counted_by_hand() -> None:
    confidence = np.array([[255, 128, 64, 0]], np.uint8)
    road = np.array([[True, False, True, False]])
    score = score_counts(count_confidences(confidence, road))
    # Down to 64: two roads among three called, F = 4/5; at 129 to 255: one of one, F = 2/3.
    assert score.MaxF == pytest.approx(80)
    assert score.best_threshold == 1 / 255
    rates = (score.PRE, score.REC, score.FPR)
    assert rates == pytest.approx((200 / 3, 100, 50))
    # Precision 1 up to recall 0.5 (six points), 2/3 beyond (five).
    average = score.AP
    assert average == pytest.approx(100 * (6 + 5 * 2 / 3) / 11)


def test_pixels_outside_the_evaluated_area_do_not_count() -> None:
    confidence = np.array([[255, 255, 0, 0]], np.uint8)
    road = np.array([[True, False, False, True]])
    evaluated = np.array([[True, False, True, False]])
    counts = count_confidences(confidence, road, evaluated)
    assert counts.sum() == 2
    assert score_counts(counts).MaxF == 100


def test_frames_are_pooled_by_adding_their_counts() -> None:
    rng = np.random.default_rng(3)
    confidence = rng.integers(0, 256, (6, 8)).astype(np.uint8)
    road = rng.random((6, 8)) > 0.5
    halves = [count_confidences(confidence[i : i + 3], road[i : i + 3]) for i in (0, 3)]
    np.testing.assert_array_equal(halves[0] + halves[1], count_confidences(confidence, road))


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 5, 256]))
@settings(max_examples=20)
def test_scores_equal_their_plain_twin(seed: int, levels: int) -> None:
    rng = np.random.default_rng(seed)
    road = rng.random((10, 10)) > 0.6
    road[0, 0] = True
    evaluated = rng.random((10, 10)) > 0.1
    evaluated[0, 0] = True
    confidence = rng.integers(0, levels, (10, 10)) * (255 // (levels - 1))
    counts = count_confidences(confidence.astype(np.uint8), road, evaluated)
    score, expected = score_counts(counts), road_scores(confidence, road, evaluated)
    for name, value in expected.items():
        if name != "best_threshold":
            assert getattr(score, name) == pytest.approx(value, abs=1e-9), name


def test_without_negatives_the_false_positive_rate_is_zero() -> None:
    road = np.ones((2, 2), bool)
    assert score_counts(count_confidences(np.full((2, 2), 9, np.uint8), road)).FPR == 0


def test_recall_without_positives_means_nothing() -> None:
    with pytest.raises(ArrayError, match="expected positive pixels, found none"):
        precision_recall_curve(np.zeros((2, 256), np.int64))


def test_counts_of_another_shape_are_refused() -> None:
    with pytest.raises(ArrayError, match="counts"):
        precision_recall_curve(np.zeros((256, 2), np.int64))


def test_confidences_are_bytes_of_the_truths_shape() -> None:
    with pytest.raises(ArrayError, match="expected uint8"):
        count_confidences(np.zeros((2, 2)), np.zeros((2, 2), bool))  # type: ignore[arg-type]
    with pytest.raises(ArrayError, match="positive: expected the confidence's shape"):
        count_confidences(np.zeros((2, 2), np.uint8), np.zeros((2, 3), bool))


@pytest.mark.parametrize(
    ("scores", "positive", "area"),
    [
        ([1, 2, 3, 4], [0, 0, 1, 1], 1),
        ([4, 3, 2, 1], [0, 0, 1, 1], 0),
        ([5, 5, 5], [0, 1, 0], 0.5),
        ([1, 2, 2, 3], [0, 1, 0, 1], 0.875),  # 3 of 4 pairs in order, one tied
        ([-np.inf, 0, np.inf], [0, 0, 1], 1),
    ],
)
def test_the_roc_area_counts_pairs_in_order_and_ties_by_half(
    scores: list[float], positive: list[int], area: float
) -> None:
    assert roc_auc(np.array(scores, float), np.array(positive, bool)) == area


def test_the_roc_area_of_normal_scores_is_the_normal_distributions() -> None:
    # Two normal distributions a deviation apart: P(X > Y) = Phi(1 / sqrt 2).
    quantiles = np.array([NormalDist().inv_cdf((i + 0.5) / 4000) for i in range(4000)])
    scores = np.concatenate([quantiles, quantiles + 1])
    area = roc_auc(scores, np.arange(8000) >= 4000)
    assert area == pytest.approx(NormalDist().cdf(1 / np.sqrt(2)), abs=1e-4)


def test_what_has_no_roc_area_is_refused() -> None:
    with pytest.raises(ArrayError, match="positives and negatives, found 2 and 0"):
        roc_auc(np.array([1.0, 2.0]), np.array([True, True]))
    with pytest.raises(ArrayError, match="found 1 of NaN; leave them out"):
        roc_auc(np.array([1.0, np.nan]), np.array([True, False]))
    with pytest.raises(ArrayError, match="as many truths"):
        roc_auc(np.zeros((2, 2)), np.zeros((2, 2), bool))
