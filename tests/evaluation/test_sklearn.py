"""Every number against scikit-learn's, on random labels with ignored pixels and absent classes."""

from __future__ import annotations

import numpy as np
import pytest
from sklearn import metrics as reference

import nimprep
from nimprep.evaluation import Evaluation, evaluate_predictions
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.metrics import confusion_matrix, roc_auc
from tests.fakes import SIZE, write_gmrp, write_png

REFERENCE = {
    "f_score": reference.f1_score,
    "iou": reference.jaccard_score,
    "precision": reference.precision_score,
    "recall": reference.recall_score,
}


def check(found: Evaluation, label: np.ndarray, guess: np.ndarray) -> None:
    """Compare with scikit-learn's scores of the pixels that count."""
    kept = label != IGNORE_LABEL
    label, guess = label[kept], guess[kept]
    ids = [c.id for c in found.classes]
    assert np.array_equal(found.confusion, reference.confusion_matrix(label, guess, labels=ids))
    in_label, in_guess = np.isin(ids, label), np.isin(ids, guess)
    defined = {
        "f_score": in_label | in_guess,
        "iou": in_label | in_guess,
        "precision": in_guess,
        "recall": in_label,
    }
    foreground = [i for i in ids if i != 0 and (i in label or i in guess)]
    for name, score in REFERENCE.items():
        each = score(label, guess, labels=ids, average=None, zero_division=0)
        assert np.array_equal(np.isnan(found.scores[name]), ~defined[name])
        np.testing.assert_allclose(np.nan_to_num(found.scores[name]), each, rtol=1e-12)
        if foreground and defined[name][foreground].all():
            mean = score(label, guess, labels=foreground, average="macro", zero_division=0)
            assert found.mean[name] == pytest.approx(mean, rel=1e-12)
        else:
            assert np.isnan(found.mean[name])


@pytest.mark.parametrize("seed", range(40))
def test_random_labels_score_as_scikit_learn_scores_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    classes = tuple(LabelClass(i, f"c{i}", (0, 0, 0)) for i in range(int(rng.integers(2, 7))))
    ids = np.arange(len(classes))
    # Few of the ids, so that classes are absent from one side or from both.
    some = [rng.choice(ids, size=int(rng.integers(1, len(ids) + 1)), replace=False) for _ in "ab"]
    label = rng.choice(some[0], size=int(rng.integers(1, 400)))
    guess = np.where(rng.random(label.size) < 0.5, label, rng.choice(some[1], size=label.size))
    label[rng.random(label.size) < 0.2] = IGNORE_LABEL
    label[0] = some[0][0]
    counts = confusion_matrix(label, guess, len(classes))
    check(Evaluation(classes, None, {"a": counts}), label, guess)


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Evaluation, dict, dict]:
    """Return six frames of random labels and predictions, as files through the whole way."""
    root = tmp_path_factory.mktemp("random")
    raw = write_gmrp(root / "raw", frames=6)
    rng = np.random.default_rng(11)
    for path in sorted((raw / "label").iterdir()):
        write_png(path, rng.choice([0, 1, 1, 2, 255], size=SIZE).astype(np.uint8))
        write_png(root / "guess" / path.name, rng.choice([0, 0, 1, 2], size=SIZE).astype(np.uint8))
    store = nimprep.convert(raw, root / "s.zarr", camera=(30, 30, 15, 11), modalities=["label"])
    guesses = {i: nimprep.images.read_label(root / "guess" / f"{i}.png") for i in store.ids}
    labels = {i: store[n].label for n, i in enumerate(store.ids)}
    return evaluate_predictions(store, root / "guess"), labels, guesses


def test_frames_together_and_each_alone_score_as_scikit_learn_scores_them(scored) -> None:
    found, labels, guesses = scored
    check(found, *(np.concatenate([part[i] for i in found.frames]) for part in (labels, guesses)))
    assert len(found.by_frame) == 6
    for frame_id, part in found.by_frame.items():
        check(part, labels[frame_id], guesses[frame_id])
    worst = [part.mean["iou"] for part in found.by_frame.values()]
    assert worst == sorted(worst)


@pytest.mark.parametrize("levels", [2, 7, 10**6])
@pytest.mark.parametrize("share", [0.003, 0.5])
def test_the_roc_area_is_the_same_with_ties_and_rare_positives(levels: int, share: float) -> None:
    rng = np.random.default_rng(levels)
    positive = rng.random(3000) < share
    scores = np.round(rng.normal(positive * 0.7, 1) * levels)
    assert positive.any()
    found = roc_auc(scores, positive)
    assert found == pytest.approx(reference.roc_auc_score(positive, scores), abs=1e-12)
