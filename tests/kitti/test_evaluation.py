"""Scores of folders: the official numbers, pooling, and what is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError
from nimprep.kitti.bev import BEV_SHAPE
from nimprep.kitti.evaluation import evaluate_predictions
from nimprep.schema import schema_problems
from tests.naive.scores import road_scores

from .scenes import HEIGHT, WIDTH, ground_truth, noise, write_calibration, write_png


def _official(reference_data: Path) -> tuple[Path, Path, dict]:
    golden = reference_data / "kitti_road_golden"
    return (
        golden,
        reference_data / "kitti_road" / "training",
        json.loads((golden / "scores.json").read_text()),
    )


def _assert_scores(found: dict, expected: dict) -> None:
    assert list(found) == list(expected)
    for table, row in expected.items():
        for name, value in row.items():
            # The official numbers pass through 32-bit floats here and there: 3e-6 percent.
            assert found[table][name] == pytest.approx(value, abs=1e-5), (table, name)


@pytest.mark.parametrize("view", ["perspective", "bev"])
def test_scores_are_the_official_ones(reference_data: Path, view: str) -> None:
    golden, training, scores = _official(reference_data)
    found = evaluate_predictions(
        golden / "perspective", training / "gt_image_2", training / "calib", view
    )
    _assert_scores(found.to_dict(), scores[view])


def test_views_that_are_there_already_need_no_calibration(reference_data: Path) -> None:
    golden, _, scores = _official(reference_data)
    found = evaluate_predictions(golden / "bev", golden / "gt_bev")
    _assert_scores(found.to_dict(), scores["bev"])


def test_one_side_may_be_there_already(reference_data: Path) -> None:
    golden, training, scores = _official(reference_data)
    found = evaluate_predictions(golden / "bev", training / "gt_image_2", training / "calib")
    _assert_scores(found.to_dict(), scores["bev"])


def _folders(tmp_path: Path, names: tuple[str, ...]) -> tuple[Path, Path]:
    for i, name in enumerate(names):
        write_png(tmp_path / "pred" / f"{name}.png", noise(i, HEIGHT, WIDTH))
        write_png(tmp_path / "gt" / f"{name}.png", ground_truth(noise(50 + i, HEIGHT, WIDTH) > 99))
    return tmp_path / "pred", tmp_path / "gt"


def test_categories_are_scored_apart_and_roads_pooled_as_urban(tmp_path: Path) -> None:
    names = ("um_road_000000", "uu_road_000000", "uu_road_000001", "um_lane_000000")
    scores = evaluate_predictions(*_folders(tmp_path, names), view="perspective").to_dict()
    assert list(scores) == ["um_road", "uu_road", "um_lane", "urban"]
    assert schema_problems(scores, "kitti-scores") == []
    stacked = [np.vstack([noise(i, HEIGHT, WIDTH) for i in range(k, k + 3)]) for k in (0, 50)]
    expected = road_scores(stacked[0], stacked[1] > 99, np.ones(stacked[0].shape, bool))
    assert scores["urban"]["AP"] == pytest.approx(expected["AP"])
    assert scores["urban"]["MaxF"] == pytest.approx(expected["MaxF"])


def test_truths_of_a_type_nobody_predicted_are_left_alone(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    write_png(truths / "um_lane_000000.png", ground_truth(noise(1, HEIGHT, WIDTH) > 99))
    assert list(evaluate_predictions(predictions, truths, view="perspective").scores) == [
        "um_road",
        "urban",
    ]


def test_probabilities_score_as_their_bytes_do(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    expected = evaluate_predictions(predictions, truths, view="perspective")
    image = noise(0, HEIGHT, WIDTH)
    (predictions / "um_road_000000.png").unlink()
    np.save(predictions / "um_road_000000.npy", image.astype(np.float32) / 255)
    assert evaluate_predictions(predictions, truths, view="perspective") == expected


def test_a_missing_prediction_is_named(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000", "umm_road_000003"))
    (predictions / "umm_road_000003.png").unlink()
    with pytest.raises(LayoutError, match=r"found 1; missing umm_road_000003\.png"):
        evaluate_predictions(predictions, truths, view="perspective")


def test_a_prediction_without_truth_is_left_out_with_a_warning(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000", "umm_road_000003"))
    (truths / "umm_road_000003.png").unlink()
    with pytest.warns(UserWarning, match=r"left out: umm_road_000003\.png"):
        scores = evaluate_predictions(predictions, truths, view="perspective").scores
    assert list(scores) == ["um_road", "urban"]


def test_predictions_of_another_type_than_the_truths_are_refused(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    (truths / "um_road_000000.png").rename(truths / "um_lane_000000.png")
    with pytest.raises(LayoutError, match="expected ground truth of type road"):
        evaluate_predictions(predictions, truths, view="perspective")


BAD_PREDICTIONS = {
    "colour": (noise(0, HEIGHT, WIDTH, 3), "8-bit or 16-bit grey, found 8-bit RGB"),
    "16 bit": (
        noise(0, HEIGHT, WIDTH).astype(np.uint16),
        "16-bit confidences up to 65535, found at most 255",
    ),
    "another size": (noise(0, HEIGHT, WIDTH - 1), "its ground truth's 120x60"),
}


@pytest.mark.parametrize(("image", "found"), BAD_PREDICTIONS.values(), ids=BAD_PREDICTIONS)
def test_a_bad_prediction_is_named(tmp_path: Path, image: np.ndarray, found: str) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    write_png(predictions / "um_road_000000.png", image)
    with pytest.raises(DecodeError, match=rf"um_road_000000\.png: expected .*{found}"):
        evaluate_predictions(predictions, truths, view="perspective")


def test_a_truth_with_no_evaluated_pixel_is_named(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    write_png(truths / "um_road_000000.png", ground_truth(~nothing, nothing))
    with pytest.raises(DecodeError, match=r"um_road_000000\.png: expected evaluated pixels"):
        evaluate_predictions(predictions, truths, view="perspective")


def test_a_truth_evaluated_only_where_the_view_does_not_reach_is_named(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    sky = np.zeros((HEIGHT, WIDTH), bool)
    sky[:10] = True
    write_png(truths / "um_road_000000.png", ground_truth(sky, sky))
    write_calibration(tmp_path / "calib" / "um_000000.txt")
    with pytest.raises(DecodeError, match="expected evaluated pixels in the bird's-eye view"):
        evaluate_predictions(predictions, truths, tmp_path / "calib")


def test_a_category_without_road_has_no_scores(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    write_png(truths / "um_road_000000.png", ground_truth(np.zeros((HEIGHT, WIDTH), bool)))
    with pytest.raises(DecodeError, match="positive pixels in the evaluated area of um_road"):
        evaluate_predictions(predictions, truths, view="perspective")


def test_a_name_outside_the_benchmarks_grammar_is_refused(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    for name in ("um_0000", "uu_lane_000000", "um_road_0", "UM_road_000000"):
        write_png(predictions / f"{name}.png", noise(0, HEIGHT, WIDTH))
        with pytest.raises(LayoutError, match=rf"expected a name .*found '{name}\.png'"):
            evaluate_predictions(predictions, truths, view="perspective")
        (predictions / f"{name}.png").unlink()


def test_folders_that_are_empty_or_missing_are_refused(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    (tmp_path / "empty").mkdir()
    with pytest.raises(LayoutError, match="found none"):
        evaluate_predictions(tmp_path / "empty", truths)
    with pytest.raises(LayoutError, match="found none"):
        evaluate_predictions(predictions, tmp_path / "nowhere")


def test_a_damaged_calibration_is_named(tmp_path: Path) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    write_calibration(tmp_path / "calib" / "um_000000.txt", Tr_cam_to_road=None)
    with pytest.raises(DecodeError, match=r"um_000000\.txt: expected the matrix Tr_cam_to_road"):
        evaluate_predictions(predictions, truths, tmp_path / "calib")


def test_a_size_that_the_calibration_rules_out_is_refused_in_perspective_too(
    tmp_path: Path,
) -> None:
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    write_calibration(tmp_path / "calib" / "um_000000.txt")
    write_png(tmp_path / "image_2" / "um_000000.png", noise(0, HEIGHT + 1, WIDTH, 3))
    with pytest.raises(DecodeError, match="expected 120x61 pixels"):
        evaluate_predictions(predictions, truths, tmp_path / "calib", "perspective")


def test_the_birds_eye_view_is_four_hundred_by_eight_hundred(tmp_path: Path) -> None:
    assert BEV_SHAPE == (800, 400)
    predictions, truths = _folders(tmp_path, ("um_road_000000",))
    shutil.rmtree(truths)
    write_png(truths / "um_road_000000.png", ground_truth(noise(0, *BEV_SHAPE) > 9))
    with pytest.raises(LayoutError, match="give --calib"):
        evaluate_predictions(predictions, truths)
