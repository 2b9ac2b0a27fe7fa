"""What the counts of classes tell of the ids."""

from __future__ import annotations

import re

import numpy as np
import pytest

from nimprep.doubts.labels import LABEL_KINDS, label_doubts
from nimprep.frame import LabelClass

CLASSES = tuple(
    LabelClass(i, name, (0, 0, 0)) for i, name in enumerate(("background", "road", "anomaly"))
)


def doubts(*counts: list[int], withheld: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    ids = [f"{n}" for n in range(len(counts))]
    found = label_doubts(ids, np.array(counts, np.uint32), CLASSES, withheld)
    assert all(d.kind in LABEL_KINDS for d in found)
    assert all(d.count == len(d.frames) > 0 for d in found)
    return [(doubt.kind, doubt.text) for doubt in found]


def test_labels_of_every_class_are_not_doubted_though_no_frame_has_all() -> None:
    assert doubts([50, 50, 0, 10], [50, 0, 50, 0]) == []


def test_a_mask_of_0_and_255_is_told_from_labels_with_pixels_to_ignore() -> None:
    ((kind, text),) = doubts([60, 0, 0, 40])
    assert kind == "mask-255"
    assert re.search(r'255 means ignore: road \(1\), anomaly \(2\).*{"0": 0, "255": 1} under', text)
    assert [kind for kind, _ in doubts([60, 0, 5, 40])] == ["class-missing"]


@pytest.mark.parametrize(("ignored", "share"), [(1900, "95.0%"), (99900, "99.9%")])
def test_labels_that_are_nearly_all_255_are_doubted(ignored: int, share: str) -> None:
    ((kind, text),) = doubts([50, 30, 20, ignored])
    assert kind == "ignored"
    assert text.startswith(f"{share} of the labels' pixels are 255")


def test_labels_that_are_all_255_are_doubted_but_not_where_they_are_withheld() -> None:
    ((kind, text),) = doubts([0, 0, 0, 100])
    assert kind == "ignored"
    assert text.startswith("all of the labels' pixels")
    assert doubts([0, 0, 0, 100], withheld=("0",)) == []


def test_frames_without_a_label_are_not_asked_where_others_have_one() -> None:
    assert doubts([9, 9, 9, 0], *[[0, 0, 0, 1000]] * 3) == []
    (kind, _), *_ = doubts([9, 0, 0, 9], *[[0, 0, 0, 1000]] * 3)
    assert kind == "mask-255"


def test_ids_that_are_counted_from_1_leave_class_0_out() -> None:
    ((kind, text),) = doubts([0, 50, 50, 0])
    assert kind == "class-missing"
    assert re.search(r'background \(0\); .*"map": {"1": 0, ', text)


def test_a_class_that_is_nowhere_is_named() -> None:
    ((kind, text),) = doubts([50, 50, 0, 0], [50, 50, 0, 0])
    assert kind == "class-missing"
    assert "anomaly (2); check" in text


def test_many_missing_classes_are_counted() -> None:
    classes = [LabelClass(i, f"c{i}", (0, 0, 0)) for i in range(9)]
    (doubt,) = label_doubts(["0"], np.array([[5] + [0] * 9]), classes)
    assert "c1 (1), c2 (2), c3 (3), c4 (4), c5 (5) and 3 more;" in doubt.text


def test_there_is_nothing_to_doubt_without_labels() -> None:
    assert label_doubts(["0"], np.zeros((1, 1), np.uint32), ()) == []
    assert doubts([0, 0, 0, 0]) == []
