"""Scores of groups and frames, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep.evaluation import Evaluation
from nimprep.frame import LabelClass
from nimprep.schema import schema_problems

CLASSES = (
    LabelClass(0, "background", (0, 0, 0)),
    LabelClass(1, "road", (0, 200, 0)),
    LabelClass(2, "anomaly", (220, 0, 0)),
)

# Rows are labels, columns predictions.
FRAMES = {
    # road: TP 6, FN 2, FP 2: IoU 6/10; anomaly: TP 1, FN 1, FP 0: 1/2. Mean 0.55.
    "half": np.array([[8, 1, 0], [2, 6, 0], [0, 1, 1]]),
    # road: TP 9, FN 0, FP 1: 9/10; no anomaly anywhere. Mean 0.9.
    "good": np.array([[9, 1, 0], [0, 9, 0], [0, 0, 0]]),
    # Nothing but background: no mean.
    "empty": np.array([[20, 0, 0], [0, 0, 0], [0, 0, 0]]),
    # road: TP 5, no error: 1; anomaly: TP 0, FP 5: 0. Mean 0.5.
    "ghost": np.array([[5, 0, 5], [0, 5, 0], [0, 0, 0]]),
}
GROUPS = {"half": "b", "good": "a", "ghost": "b"}


def evaluation(groups: dict[str, str]) -> Evaluation:
    return Evaluation(CLASSES, None, FRAMES, groups)


def test_the_worst_frame_comes_first_and_a_frame_without_foreground_last() -> None:
    found = evaluation({})
    assert list(found.by_frame) == ["ghost", "half", "good", "empty"]
    means = [part.mean["iou"] for part in found.by_frame.values()]
    assert means[:3] == [0.5, pytest.approx(0.55), 0.9]
    assert np.isnan(means[3])


def test_groups_are_scored_on_their_own() -> None:
    parts = evaluation(GROUPS).by_group
    assert list(parts) == ["", "a", "b"]
    assert [len(part.frames) for part in parts.values()] == [1, 1, 2]
    # Of half and ghost together: road TP 11, FN 2, FP 2; anomaly TP 1, FN 1, FP 5.
    assert parts["b"].scores["iou"].tolist() == [13 / (13 + 2 + 6), 11 / 15, 1 / 7]
    assert parts["b"].scores["precision"][2] == 1 / 6
    assert parts["b"].scores["recall"][2] == 1 / 2
    assert parts["b"].mean["f_score"] == pytest.approx((22 / 26 + 2 / 8) / 2)


def test_without_scenes_there_are_no_groups() -> None:
    assert evaluation({}).by_group == {}
    assert evaluation({"half": ""}).by_group == {}


def test_json_says_groups_and_frames_worst_first_and_fits_its_schema() -> None:
    document = evaluation(GROUPS).to_dict()
    assert schema_problems(document, "evaluation") == []
    assert [g["group"] for g in document["groups"]] == ["", "a", "b"]
    assert document["groups"][2]["frames"] == 2
    first, last = document["by_frame"][0], document["by_frame"][-1]
    assert (first["id"], first["group"], first["pixels"]) == ("ghost", "b", 15)
    assert first["iou"] == [0.5, 1.0, 0.0]
    assert last["mean"]["iou"] is None
    assert last["iou"] == [1.0, None, None]
    del document["by_frame"][0]["mean"]
    assert schema_problems(document, "evaluation")
