"""Confidence maps as people have them: frame ids, 8 and 16 bits, floats, masks of 0 and 1."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner, Result

from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError
from nimprep.kitti import evaluate_predictions, pack_submission, transform_folder
from nimprep.kitti.bev import BEV_SHAPE
from nimprep.kitti.images import read_confidence

from .scenes import HEIGHT, WIDTH, ground_truth, noise, read_png, write_png

VIEW = noise(3, *BEV_SHAPE)


def _write(path: Path, image: npt.NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, image)
    else:
        write_png(path, image)


FORMS = {
    "8-bit PNG": (".png", VIEW),
    "16-bit PNG": (".png", VIEW.astype(np.uint16) * 257 + np.uint16(100)),
    "float32": (".npy", VIEW.astype(np.float32) / 255),
    "float16": (".npy", (VIEW / 255).astype(np.float16)),
    "rounded past 1": (".npy", (VIEW / 255).astype(np.float32) * np.float32(1.0000005)),
}


def _form(name: str) -> tuple[str, npt.NDArray[np.generic]]:
    suffix, image = FORMS[name]
    # 65535 has nothing above it.
    return suffix, np.where(VIEW == 255, np.uint16(65535), image) if "16-bit PNG" == name else image


NAMES = {
    "frame": "{c}_{n}",
    "id": "testing/{c}_{n}",
    "category": "{c}_road_{n}",
    "both": "testing/{c}_road_{n}",
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("naming", NAMES)
def test_every_name_and_number_is_packed_as_the_same_bytes(
    tmp_path: Path, naming: str, form: str
) -> None:
    suffix, image = _form(form)
    for number in ("000000", "000095"):
        path = NAMES[naming].format(c="um", n=number) + suffix
        _write(tmp_path / "pred" / path, image)
    target = "road" if naming in ("category", "both") else "lane"
    packed = pack_submission(tmp_path / "pred", tmp_path / "o.zip", target=target, partial=True)
    expected = f"um_{target}_000095.png"
    assert packed.names == (f"um_{target}_000000.png", expected)
    with zipfile.ZipFile(packed.path) as archive:
        found = cv2.imdecode(np.frombuffer(archive.read(expected), np.uint8), -1)
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - VIEW).max() == 0


def _truths(tmp_path: Path, names: tuple[str, ...]) -> Path:
    for i, name in enumerate(names):
        write_png(tmp_path / "gt" / f"{name}.png", ground_truth(noise(50 + i, HEIGHT, WIDTH) > 99))
    return tmp_path / "gt"


def test_frame_ids_score_as_the_benchmarks_names_do(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000", "uu_road_000001", "um_lane_000000"))
    for i, (ours, theirs) in enumerate(
        [("um_000000", "um_road_000000"), ("uu_000001", "uu_road_000001")]
    ):
        image = noise(i, HEIGHT, WIDTH)
        _write(tmp_path / "theirs" / f"{theirs}.png", image)
        _write(tmp_path / "flat" / f"{ours}.npy", image.astype(np.float32) / 255)
        _write(tmp_path / "ids" / "training" / f"{ours}.png", image.astype(np.uint16) * 257)
    expected = evaluate_predictions(tmp_path / "theirs", truths, view="perspective")
    assert list(expected.scores) == ["um_road", "uu_road", "urban"]
    for folder in ("flat", "ids"):
        assert evaluate_predictions(tmp_path / folder, truths, view="perspective") == expected


def test_a_frames_own_name_is_of_the_type_that_is_asked_for(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000", "um_lane_000000"))
    _write(tmp_path / "pred" / "um_000000.png", noise(0, HEIGHT, WIDTH))
    found = evaluate_predictions(tmp_path / "pred", truths, view="perspective", target="lane")
    assert list(found.scores) == ["um_lane"]


def _mask(i: int) -> npt.NDArray[np.uint8]:
    return (noise(20 + i, HEIGHT, WIDTH) > 120).astype(np.uint8)


@pytest.mark.parametrize("bits", [8, 16])
def test_masks_of_0_and_1_are_scored_as_0_and_255_are(tmp_path: Path, bits: int) -> None:
    names = ("um_road_000000", "uu_road_000001")
    truths = _truths(tmp_path, names)
    for i, name in enumerate(names):
        _write(tmp_path / "full" / f"{name}.png", _mask(i) * 255)
        _write(tmp_path / "ones" / f"{name}.png", _mask(i).astype(f"uint{bits}"))
    full = evaluate_predictions(tmp_path / "full", truths, view="perspective")
    assert evaluate_predictions(tmp_path / "ones", truths, view="perspective") == full


def test_masks_of_0_and_1_are_packed_as_0_and_255(tmp_path: Path) -> None:
    _write(tmp_path / "pred" / "um_000000.png", (VIEW > 9).astype(np.uint8))
    with pytest.warns(UserWarning, match="only two values in 1 predictions"):
        packed = pack_submission(tmp_path / "pred", tmp_path / "o.zip", partial=True)
    with zipfile.ZipFile(packed.path) as archive:
        found = cv2.imdecode(np.frombuffer(archive.read("um_road_000000.png"), np.uint8), -1)
    np.testing.assert_array_equal(found, np.where(VIEW > 9, 255, 0))


def test_a_mask_of_0_and_1_among_other_maps_is_told_of(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000", "uu_road_000001"))
    _write(tmp_path / "pred" / "um_000000.png", _mask(0))
    _write(tmp_path / "pred" / "uu_000001.png", noise(1, HEIGHT, WIDTH))
    with pytest.warns(UserWarning, match=r"0 and 1 alone in 1 of 2 predictions \(um_000000\.png\)"):
        evaluate_predictions(tmp_path / "pred", truths, view="perspective")


def test_an_image_of_one_bit_is_a_mask(tmp_path: Path) -> None:
    path = tmp_path / "um_000000.png"
    assert cv2.imwrite(str(path), _mask(0) * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])
    np.testing.assert_array_equal(read_confidence(path), _mask(0) * 255)


@pytest.mark.parametrize(
    ("value", "byte"), [(0, 0), (128, 0), (129, 1), (32767, 127), (32768, 128), (65535, 255)]
)
def test_sixteen_bits_become_the_nearest_eight(tmp_path: Path, value: int, byte: int) -> None:
    image = np.array([[value, 65535]], np.uint16)
    write_png(tmp_path / "a.png", image)
    assert read_confidence(tmp_path / "a.png").tolist() == [[byte, 255]]


def test_eight_bits_kept_in_sixteen_are_refused(tmp_path: Path) -> None:
    write_png(tmp_path / "a.png", np.array([[3, 255]], np.uint16))
    with pytest.raises(DecodeError, match=r"up to 65535, found at most 255.*8-bit grey"):
        read_confidence(tmp_path / "a.png")


def _pack(tmp_path: Path, *options: str) -> Result:
    return CliRunner().invoke(
        main, ["kitti", "pack", str(tmp_path / "pred"), str(tmp_path / "o.zip"), *options]
    )


def test_a_trial_names_what_is_extra_and_not_the_290_that_are_missing(tmp_path: Path) -> None:
    for name in ("um_road_0.png", "UU_ROAD_000002.png", "kerbs.png"):
        _write(tmp_path / "pred" / name, VIEW)
    _write(tmp_path / "pred" / "um_road_000007.jpg", VIEW)
    result = _pack(tmp_path, "--partial")
    assert result.exit_code == 1
    assert result.stderr == (
        f"error: {tmp_path / 'pred'}: expected only test predictions of type road, found 4 extra: "
        "UU_ROAD_000002.png (uu_road_000002.png?), kerbs.png, um_road_0.png (um_road_000000.png?), "
        "um_road_000007.jpg (expected .png or .npy)\n"
    )


@pytest.mark.parametrize("shape", [(2, 375, 1242), (1, 375, 1242), (375, 1242, 2), (375,)])
def test_a_wrong_array_is_shown_with_its_whole_shape(
    tmp_path: Path, shape: tuple[int, ...]
) -> None:
    truths = _truths(tmp_path, ("um_road_000000",))
    _write(tmp_path / "pred" / "um_000000.npy", np.zeros(shape, np.float32))
    packed = _pack(tmp_path, "--partial")
    arguments = ["kitti", "evaluate", str(tmp_path / "pred"), str(truths)]
    for result in (packed, CliRunner().invoke(main, arguments)):
        assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
        assert f"found {shape} of float32; write one plane" in result.stderr


def test_a_logit_is_refused_by_name(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000",))
    _write(tmp_path / "pred" / "um_000000.npy", np.linspace(-4, 4, 320000).reshape(BEV_SHAPE))
    packed = _pack(tmp_path, "--partial")
    arguments = ["kitti", "evaluate", str(tmp_path / "pred"), str(truths)]
    for result in (packed, CliRunner().invoke(main, arguments)):
        assert result.exit_code == 1
        assert "um_000000.npy: expected probabilities in [0, 1], found -4 to 4" in result.stderr


def test_a_ground_truth_by_frame_id_is_told_its_name(tmp_path: Path) -> None:
    _write(tmp_path / "pred" / "um_000000.png", noise(0, HEIGHT, WIDTH))
    _write(tmp_path / "gt" / "um_000000.png", ground_truth(_mask(0) > 0))
    with pytest.raises(LayoutError, match=r"found 'um_000000\.png'; um_road_000000\.png may be"):
        evaluate_predictions(tmp_path / "pred", tmp_path / "gt", view="perspective")


def test_one_frame_under_both_names_is_refused(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000",))
    for name in ("um_000000.png", "um_road_000000.png"):
        _write(tmp_path / "pred" / name, noise(0, HEIGHT, WIDTH))
    with pytest.raises(LayoutError, match=r"um_road_000000\.png.*found um_000000\.png too"):
        evaluate_predictions(tmp_path / "pred", truths, view="perspective")


def test_of_a_whole_stores_predictions_each_step_takes_its_own(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000",))
    _write(tmp_path / "pred" / "training" / "um_000000.png", noise(0, HEIGHT, WIDTH))
    _write(tmp_path / "pred" / "testing" / "um_000000.png", VIEW)
    packed = pack_submission(tmp_path / "pred", tmp_path / "o.zip", partial=True)
    with zipfile.ZipFile(packed.path) as archive:
        found = cv2.imdecode(np.frombuffer(archive.read("um_road_000000.png"), np.uint8), -1)
    np.testing.assert_array_equal(found, VIEW)
    found = evaluate_predictions(tmp_path / "pred", truths, view="perspective")
    shutil.rmtree(tmp_path / "pred" / "testing")
    assert evaluate_predictions(tmp_path / "pred", truths, view="perspective") == found
    _write(tmp_path / "pred" / "testing" / "um_000000.png", VIEW)
    with pytest.raises(LayoutError, match="training or of testing frames, found both"):
        transform_folder(tmp_path / "pred", tmp_path / "bev", None)


def test_training_predictions_are_no_submission(tmp_path: Path) -> None:
    _write(tmp_path / "pred" / "training" / "um_000000.png", VIEW)
    with pytest.raises(LayoutError, match="of testing frames, found 1 of training frames only"):
        pack_submission(tmp_path / "pred", tmp_path / "o.zip", partial=True)


def test_a_part_of_the_truths_is_scored_where_that_is_asked_for(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("um_road_000000", "uu_road_000001"))
    _write(tmp_path / "pred" / "um_000000.png", noise(0, HEIGHT, WIDTH))
    with pytest.raises(LayoutError, match=r"missing uu_road_000001\.png; --partial"):
        evaluate_predictions(tmp_path / "pred", truths, view="perspective")
    found = evaluate_predictions(tmp_path / "pred", truths, view="perspective", partial=True)
    assert list(found.scores) == ["um_road", "urban"]
    assert found.frames == {"um_road": 1, "urban": 1}
    assert [row["frames"] for row in found.to_dict().values()] == [1, 1]


def test_a_part_that_has_no_truth_is_refused(tmp_path: Path) -> None:
    truths = _truths(tmp_path, ("uu_road_000001",))
    _write(tmp_path / "pred" / "um_000000.png", noise(0, HEIGHT, WIDTH))
    with pytest.raises(LayoutError, match="found um_000000, which have none"):
        evaluate_predictions(tmp_path / "pred", truths, view="perspective", partial=True)


def test_frame_ids_become_the_benchmarks_names_in_the_birds_eye_view(tmp_path: Path) -> None:
    _write(tmp_path / "pred" / "training" / "um_000000.PNG", VIEW)
    written = transform_folder(tmp_path / "pred", tmp_path / "bev", None)
    assert written == (tmp_path / "bev" / "um_road_000000.png",)
    np.testing.assert_array_equal(read_png(written[0]), VIEW)


def _said(folder: Path, *names: str) -> None:
    """Say what planes of scores stand for, as `nimprep predict` does."""
    document = {
        "format": "nimprep-predictions",
        "version": "1.0",
        "nimprep": "0",
        "store": "s.zarr",
        "run": None,
        "network": "mfnet",
        "setup": "rgb",
        "split": "test",
        "frames": 1,
        "classes": [{"id": number, "name": name} for number, name in enumerate(names)],
        "scores": True,
    }
    (folder / "predictions.json").write_text(json.dumps(document))


@pytest.mark.parametrize("size", [BEV_SHAPE, (HEIGHT, WIDTH)])
@pytest.mark.parametrize("within", [".", "scores", "scores/testing"])
def test_of_scores_of_classes_the_roads_are_taken(
    tmp_path: Path, size: tuple[int, int], within: str
) -> None:
    road = noise(3, *size) / np.float32(255)
    _write(tmp_path / within / "um_000000.npy", np.stack([1 - road, road, road * 0]))
    _said(tmp_path, "not road", "road", "kerb")
    found = read_confidence(tmp_path / within / "um_000000.npy")
    np.testing.assert_array_equal(found, noise(3, *size))


@pytest.mark.parametrize("names", [(), ("ground", "way"), ("road", "lane"), ("a", "road", "b")])
def test_planes_of_which_nothing_says_which_is_the_roads_are_refused(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    _write(tmp_path / "um_000000.npy", np.stack([1 - VIEW / 255, VIEW / 255]))
    if names:
        _said(tmp_path, *names)
    with pytest.raises(DecodeError, match=r"found \(2, 800, 400\) of float64; write one plane"):
        read_confidence(tmp_path / "um_000000.npy")


def test_what_predict_says_of_its_predictions_is_no_prediction(tmp_path: Path) -> None:
    _write(tmp_path / "pred" / "um_000000.npy", np.stack([1 - VIEW / 255, VIEW / 255]))
    _said(tmp_path / "pred", "not road", "road")
    packed = _pack(tmp_path, "--partial")
    assert packed.exit_code == 0, packed.stderr
    assert "1 predictions" in packed.stdout
