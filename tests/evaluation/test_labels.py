"""Predictions scored against a store: by hand, by definition, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError, StoreError
from nimprep.evaluation import Evaluation, evaluate_predictions
from nimprep.frame import LabelClass
from nimprep.metrics import confusion_matrix
from nimprep.schema import schema_problems
from tests.fakes import SIZE, write_gmrp, write_nyu_like, write_png

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal RealSense D415")


@pytest.fixture(scope="module")
def gmrp(tmp_path_factory):
    """Return a store of five frames in GMRP's layout: 3 train, 1 val, 1 test."""
    root = tmp_path_factory.mktemp("gmrp")
    nimprep.convert(write_gmrp(root / "raw"), root / "s.zarr", modalities=["rgb", "depth", "label"])
    return nimprep.open_store(root / "s.zarr")


def write_predictions(store, folder, split=None, change=lambda label: label):
    for i in store.indices(split):
        write_png(folder / f"{store.ids[i]}.png", change(store[int(i)].label))
    return folder


def run(*arguments):
    return CliRunner().invoke(main, ["evaluate", *map(str, arguments)])


def test_the_labels_themselves_score_one_everywhere(gmrp, tmp_path):
    found = evaluate_predictions(gmrp, write_predictions(gmrp, tmp_path))
    assert found.split is None
    assert len(found.frames) == 5
    assert np.array_equal(found.confusion, np.diag(np.diag(found.confusion)))
    assert found.confusion.sum() == 5 * SIZE[0] * SIZE[1]
    assert set(found.mean.values()) == {1.0}


def test_a_case_counted_by_hand(gmrp, tmp_path):
    # Of 24 x 32 labels: 384 background, 368 drivable (12 x 32 less 4 x 4), 16 anomaly.
    def change(label):
        guess = label.copy()
        guess[11] = 1  # 32 of background called drivable
        guess[-4:, :2] = 0  # 8 of the anomaly missed
        return guess

    found = evaluate_predictions(gmrp, write_predictions(gmrp, tmp_path, "test", change))
    assert found.split == "test"
    assert found.confusion.tolist() == [[352, 32, 0], [0, 368, 0], [8, 0, 8]]
    row = found.to_dict()["classes"]
    assert row[1]["iou"] == 368 / 400
    assert row[1]["precision"] == 368 / 400
    assert row[1]["recall"] == 1
    assert row[2]["f_score"] == 16 / 24
    assert row[2]["recall"] == 0.5
    assert found.mean["iou"] == pytest.approx((368 / 400 + 8 / 16) / 2)
    assert found.mean["f_score"] == pytest.approx((736 / 768 + 16 / 24) / 2)


def test_a_class_never_predicted_has_no_precision_nor_has_the_mean(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path, "val", lambda label: np.minimum(label, 1))
    found = evaluate_predictions(gmrp, folder)
    assert found.to_dict()["classes"][2]["precision"] is None
    assert np.isnan(found.mean["precision"])
    assert found.to_dict()["mean"]["precision"] is None
    assert not schema_problems(found.to_dict(), "evaluation")
    # What is defined of the class counts: it was missed.
    assert found.mean["recall"] == 0.5
    assert found.mean["iou"] == pytest.approx(368 / 384 / 2)


def test_the_undefined_is_a_dash_and_explained(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path, "val", lambda label: np.minimum(label, 1))
    lines = run(gmrp.path, folder, "--metrics", "precision,recall").stdout.splitlines()
    rows = {line.rsplit(maxsplit=2)[0]: line.split()[-2:] for line in lines[2:7]}
    assert rows["in %"] == ["precision", "recall"]
    assert rows["road anomaly"] == ["–", "0.00"]
    assert rows["mean, no background"] == ["–", "50.00"]
    assert lines[-1].startswith("– undefined: precision where nothing was predicted")
    whole = write_predictions(gmrp, tmp_path / "whole", "val")
    assert "undefined" not in run(gmrp.path, whole).stdout


def test_a_class_that_nobody_has_is_left_out_of_the_mean(gmrp):
    counts = np.zeros((3, 3), np.int64)
    counts[0, 0] = 5
    nothing = Evaluation(gmrp.classes, None, {"a": counts}).to_dict()
    assert nothing["mean"] == dict.fromkeys(("f_score", "iou", "precision", "recall"))
    assert not schema_problems(nothing, "evaluation")
    counts[1, 1] = 7
    assert set(Evaluation(gmrp.classes, None, {"a": counts}).mean.values()) == {1.0}


def test_scores_choose_the_highest_and_score_like_their_labels(gmrp, tmp_path):
    rng = np.random.default_rng(0)
    for i in gmrp.indices("train"):
        scores = rng.normal(size=(3, *SIZE)).astype(np.float32)
        (tmp_path / "npy").mkdir(exist_ok=True)
        np.save(tmp_path / "npy" / f"{gmrp.ids[i]}.npy", scores)
        write_png(tmp_path / "png" / f"{gmrp.ids[i]}.png", scores.argmax(0).astype(np.uint8))
    npy, png = (evaluate_predictions(gmrp, tmp_path / kind) for kind in ("npy", "png"))
    assert npy.to_dict() == png.to_dict()


def test_ids_with_slashes_lie_in_subfolders_and_ignored_pixels_do_not_count(tmp_path):
    raw, description = write_nyu_like(tmp_path / "nyu")
    nimprep.convert(raw, tmp_path / "s.zarr", description=description, split_by="frame")
    store = nimprep.open_store(tmp_path / "s.zarr")
    assert "/" in store.ids[0]
    folder = write_predictions(store, tmp_path / "out", change=lambda _: np.ones(SIZE, np.uint8))
    found = evaluate_predictions(store, folder)
    # Rows 0 to 3 are 255; rows 4 and 5 are class 0.
    assert found.confusion.tolist() == [[0, 4 * 2 * 32], [0, 4 * 18 * 32]]
    # What is predicted on ignored pixels does not matter, 255 included.
    folder = write_predictions(store, tmp_path / "same")
    assert set(evaluate_predictions(store, folder).mean.values()) == {1.0}


def test_a_missing_prediction_is_named(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path)
    lost = gmrp.ids[gmrp.indices("test")[0]]
    (folder / f"{lost}.png").unlink()
    with pytest.raises(LayoutError, match=rf"each of 5 frames of the store, found none for {lost}"):
        evaluate_predictions(gmrp, folder)
    with pytest.raises(LayoutError, match=rf"1 frames of split 'test', found none for {lost}"):
        evaluate_predictions(gmrp, folder, "test")


def test_a_prediction_too_many_is_named(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path, "train")
    write_png(folder / "stranger.png", np.zeros(SIZE, np.uint8))
    with pytest.raises(LayoutError, match="3 frames of split 'train' only, found stranger too"):
        evaluate_predictions(gmrp, folder)
    (folder / "stranger.png").unlink()
    other = gmrp.ids[gmrp.indices("val")[0]]
    write_png(folder / f"{other}.png", np.zeros(SIZE, np.uint8))
    with pytest.raises(LayoutError, match=f"only, found {other} too"):
        evaluate_predictions(gmrp, folder, "train")


def save(array):
    return lambda path: np.save(path.with_suffix(".npy"), array)


def claim(shape):
    """Write a header that claims much more than the file holds."""

    def write(path):
        with path.with_suffix(".npy").open("wb") as file:
            header = {"descr": "<f4", "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(file, header)
            file.write(bytes(64))

    return write


def image(array):
    return lambda path: cv2.imwrite(str(path), array)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (image(np.zeros((24, 33), np.uint8)), "expected the frame's 32x24 pixels, found 33x24"),
        (image(np.zeros((24, 32), np.uint16)), "as 8-bit grey, found 16-bit grey"),
        (image(np.zeros((24, 32, 3), np.uint8)), "as 8-bit grey, found 8-bit colour"),
        (image(np.full((24, 32), 7, np.uint8)), r"expected class ids \[0, 1, 2\], found 7"),
        (image(np.full((24, 32), 255, np.uint8)), "found 255"),
        (lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n"), "truncated"),
        (save(np.zeros((24, 32), np.uint8)), "expected floating scores, found uint8"),
        (save(np.zeros((2, 24, 32), np.float32)), r"expected scores \(3, H, W\).*\(2, 24, 32\)"),
        (save(np.zeros((3, 20, 32), np.float32)), "expected the frame's 32x24 pixels, found 32x20"),
        (save(np.full((3, 24, 32), np.nan, np.float32)), "found NaN"),
        (save(np.array([{}], dtype=object)), "expected a NumPy array file"),
        (lambda path: path.with_suffix(".npy").write_bytes(b""), "expected a NumPy array file"),
        (claim((3, 100_000, 1_000_000)), "expected a NumPy array file"),
    ],
)
def test_a_bad_prediction_is_refused_by_name(gmrp, tmp_path, write, message):
    frame_id = gmrp.ids[gmrp.indices("test")[0]]
    write(tmp_path / f"{frame_id}.png")
    with pytest.raises(DecodeError, match=message) as error:
        evaluate_predictions(gmrp, tmp_path)
    assert f"{frame_id}." in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_no_folder_of_predictions_or_has_two_of_a_frame_is_refused(gmrp, tmp_path):
    with pytest.raises(LayoutError, match="expected a folder of predictions, found none"):
        evaluate_predictions(gmrp, tmp_path / "nowhere")
    with pytest.raises(LayoutError, match=r"expected predictions \(.png or .npy\), found none"):
        evaluate_predictions(gmrp, tmp_path)
    folder = write_predictions(gmrp, tmp_path, "test")
    frame_id = gmrp.ids[gmrp.indices("test")[0]]
    np.save(folder / f"{frame_id}.npy", np.zeros((3, *SIZE), np.float32))
    with pytest.raises(LayoutError, match=f"one prediction of frame '{frame_id}'"):
        evaluate_predictions(gmrp, folder)


def test_labels_that_are_no_class_are_refused(gmrp, tmp_path):
    store = nimprep.open_store(gmrp.path)
    store.classes = (gmrp.classes[0], gmrp.classes[2])
    folder = write_predictions(store, tmp_path, "test", np.zeros_like)
    with pytest.raises(StoreError, match=r"expected labels \[0, 2\] and 255, found others"):
        evaluate_predictions(store, folder)


def test_a_store_without_labels_is_refused(tmp_path):
    raw = write_gmrp(tmp_path / "raw", frames=3, labels=False)
    nimprep.convert(raw, tmp_path / "s.zarr", modalities=["rgb", "depth"], labels=False)
    with pytest.raises(StoreError, match="expected labels, found none"):
        evaluate_predictions(tmp_path / "s.zarr", tmp_path)


def test_the_command_prints_the_table_or_json_of_its_schema(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path, "test", lambda label: np.minimum(label, 1))
    table = run(gmrp.path, folder)
    assert table.exit_code == 0
    assert table.stdout.startswith("1 frames of split test, 768 pixels counted")
    assert "mean, no background" in table.stdout
    lines = run(gmrp.path, folder, "--split", "test", "--json")
    document = json.loads(lines.stdout)
    assert not schema_problems(document, "evaluation")
    assert document == evaluate_predictions(gmrp, folder).to_dict()
    assert not schema_problems({**document, "split": None}, "evaluation")
    assert schema_problems({**document, "accuracy": 2}, "evaluation")


def test_the_command_knows_a_bad_call_from_bad_data(gmrp, tmp_path):
    assert run(gmrp.path, tmp_path, "--split", "tset").exit_code == 2
    assert run(gmrp.path).exit_code == 2
    result = run(gmrp.path, tmp_path)
    assert result.exit_code == 1
    assert result.stderr.startswith(f"error: {tmp_path}: expected predictions")


def test_random_labels_score_as_their_definitions_say():
    rng = np.random.default_rng(3)
    label, guess = rng.integers(0, 4, (2, 5000))
    classes = tuple(LabelClass(i, str(i), (0, 0, 0)) for i in range(4))
    found = Evaluation(classes, None, {"a": confusion_matrix(label, guess, 4)}).scores
    for i in range(4):
        truth, called = label == i, guess == i
        hits = (truth & called).sum()
        precision, recall = hits / called.sum(), hits / truth.sum()
        assert found["precision"][i] == pytest.approx(precision)
        assert found["recall"][i] == pytest.approx(recall)
        assert found["iou"][i] == pytest.approx(hits / (truth | called).sum())
        assert found["f_score"][i] == pytest.approx(2 * precision * recall / (precision + recall))


def test_predictions_may_be_given_by_path_too(gmrp, tmp_path):
    folder = write_predictions(gmrp, tmp_path, "test")
    assert evaluate_predictions(str(gmrp.path), str(folder)).mean["iou"] == 1
    assert Path(folder).is_dir()
