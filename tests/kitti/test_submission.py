"""The packer: complete, checked, the same bytes each time, and nothing left where it refuses."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep.kitti
from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.kitti import pack_submission
from nimprep.kitti.bev import BEV_SHAPE, transform_to_bev
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.names import official_names

from .scenes import HEIGHT, WIDTH, noise, read_png, write_calibration, write_png

VIEW = np.repeat(np.arange(800, dtype=np.uint16)[:, None] // 4, 400, axis=1).astype(np.uint8)


@pytest.fixture(scope="module")
def all_predictions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every road prediction, in the bird's-eye view."""
    folder = tmp_path_factory.mktemp("predictions")
    _, data = cv2.imencode(".png", VIEW)
    for name in official_names("road"):
        (folder / name.png).write_bytes(data.tobytes())
    return folder


@pytest.fixture
def predictions(all_predictions: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(all_predictions, tmp_path / "pred"))


def _left_behind(tmp_path: Path) -> list[str]:
    return [path.name for path in tmp_path.iterdir() if "zip" in path.name]


def test_a_whole_set_becomes_a_flat_zip_of_290(all_predictions: Path, tmp_path: Path) -> None:
    packed = pack_submission(all_predictions, tmp_path / "out.zip")
    assert (len(packed.names), packed.transformed) == (290, 0)
    with zipfile.ZipFile(tmp_path / "out.zip") as archive:
        names = archive.namelist()
        stamps = {(info.date_time, info.external_attr) for info in archive.infolist()}
        image = cv2.imdecode(np.frombuffer(archive.read(names[7]), np.uint8), -1)
    assert stamps == {((1980, 1, 1, 0, 0, 0), 0o100644 << 16)}
    assert names == list(packed.names) == [name.png for name in official_names("road")]
    counts = [sum(name.startswith(f"{c}_road_") for name in names) for c in ("um", "umm", "uu")]
    assert counts == [96, 94, 100]
    np.testing.assert_array_equal(image, VIEW)


def test_the_same_input_gives_the_same_bytes(all_predictions: Path, tmp_path: Path) -> None:
    for name in ("a.zip", "b.zip"):
        pack_submission(all_predictions, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()


def test_lanes_are_the_96_of_um(all_predictions: Path, tmp_path: Path) -> None:
    for name in official_names("lane"):
        path = tmp_path / "lanes" / name.png
        path.parent.mkdir(exist_ok=True)
        shutil.copy(all_predictions / "um_road_000000.png", path)
    packed = pack_submission(tmp_path / "lanes", tmp_path / "out.zip", target="lane")
    assert len(packed.names) == 96
    with pytest.raises(LayoutError, match=r"290 missing.*96 extra: um_lane_000000.png"):
        pack_submission(tmp_path / "lanes", tmp_path / "road.zip")


def test_what_is_missing_extra_and_wrong_is_named_at_once(
    predictions: Path, tmp_path: Path
) -> None:
    (predictions / "umm_road_000093.png").unlink()
    shutil.copy(predictions / "um_road_000000.png", predictions / "um_road_000096.png")
    (predictions / "notes.txt").write_text("not a prediction")
    write_png(predictions / "uu_road_000003.png", noise(0, *BEV_SHAPE, 3))
    write_png(predictions / "uu_road_000004.png", noise(0, 60, 120))
    with pytest.raises(LayoutError) as caught:
        pack_submission(predictions, tmp_path / "out.zip")
    message = str(caught.value)
    assert "1 missing: umm_road_000093.png" in message
    assert "2 extra: notes.txt, um_road_000096.png" in message
    assert "uu_road_000003.png (expected 8-bit or 16-bit grey, found 8-bit RGB)" in message
    assert "uu_road_000004.png: expected a calibration" in message
    assert "\n" not in message
    assert _left_behind(tmp_path) == []


def test_damage_found_while_packing_leaves_no_zip(predictions: Path, tmp_path: Path) -> None:
    path = predictions / "uu_road_000099.png"
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(DecodeError, match=r"uu_road_000099\.png: expected a whole PNG"):
        pack_submission(predictions, tmp_path / "out.zip")
    assert _left_behind(tmp_path) == []


def test_an_existing_zip_is_kept_unless_told_otherwise(
    all_predictions: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.zip"
    out.write_bytes(b"mine")
    with pytest.raises(LayoutError, match=r"out\.zip: expected a new file.*--overwrite"):
        pack_submission(all_predictions, out)
    assert out.read_bytes() == b"mine"
    pack_submission(all_predictions, out, overwrite=True)
    assert zipfile.is_zipfile(out)


def test_a_refused_overwrite_keeps_the_old_zip(predictions: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.zip"
    out.write_bytes(b"mine")
    (predictions / "uu_road_000000.png").unlink()
    with pytest.raises(LayoutError, match="1 missing"):
        pack_submission(predictions, out, overwrite=True)
    assert out.read_bytes() == b"mine"


def test_a_zip_among_the_predictions_is_refused(predictions: Path) -> None:
    with pytest.raises(LayoutError, match="sources are never written to"):
        pack_submission(predictions, predictions / "out.zip")


def test_a_place_that_cannot_be_written_is_an_error(all_predictions: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LayoutError, match="expected to write it"):
        pack_submission(all_predictions, tmp_path / "file" / "out.zip")


def _one(tmp_path: Path, image: np.ndarray) -> Path:
    folder = tmp_path / "one"
    write_png(folder / "uu_road_000002.png", image)
    return folder


def _road_calib(tmp_path: Path, **changes: np.ndarray) -> Path:
    calib = tmp_path / "testing" / "calib"
    write_calibration(calib / "uu_000002.txt", **changes)
    write_png(tmp_path / "testing" / "image_2" / "uu_000002.png", noise(9, HEIGHT, WIDTH, 3))
    return calib


def test_predictions_in_perspective_are_transformed(tmp_path: Path) -> None:
    image, calib = noise(0, HEIGHT, WIDTH), _road_calib(tmp_path)
    packed = pack_submission(_one(tmp_path, image), tmp_path / "o.zip", calib, partial=True)
    assert (packed.names, packed.transformed) == (("uu_road_000002.png",), 1)
    with zipfile.ZipFile(packed.path) as archive:
        found = cv2.imdecode(np.frombuffer(archive.read(packed.names[0]), np.uint8), -1)
    expected = transform_to_bev(image, read_calibration(calib / "uu_000002.txt"))
    np.testing.assert_array_equal(found, expected)


def test_the_size_is_the_images_own_even_where_p2_says_another(tmp_path: Path) -> None:
    p2 = np.array([[721.5377, 0, 600, 45], [0, 721.5377, 180, 0.2], [0, 0, 1, 0.003]])
    calib = _road_calib(tmp_path, P2=p2)
    pack_submission(
        _one(tmp_path, noise(0, HEIGHT, WIDTH)), tmp_path / "o.zip", calib, partial=True
    )
    folder = _one(tmp_path, noise(0, 375, 1242))
    with pytest.raises(
        LayoutError, match=r"uu_road_000002\.png \(expected 120x60 or 400x800, found"
    ):
        pack_submission(folder, tmp_path / "p.zip", calib, partial=True)


def test_without_the_image_p2_tells_the_size(tmp_path: Path) -> None:
    p2 = np.array([[718.856, 0, 600, 45], [0, 718.856, 180, 0.2], [0, 0, 1, 0.003]])
    calib = _road_calib(tmp_path, P2=p2)
    shutil.rmtree(tmp_path / "testing" / "image_2")
    pack_submission(_one(tmp_path, noise(0, 376, 1241)), tmp_path / "o.zip", calib, partial=True)
    folder = _one(tmp_path, noise(0, 375, 1242))
    with pytest.raises(LayoutError, match="expected 1241x376 or 400x800, found 1242x375"):
        pack_submission(folder, tmp_path / "p.zip", calib, partial=True)


def test_a_size_that_cannot_be_known_is_refused(tmp_path: Path) -> None:
    calib = _road_calib(tmp_path)
    shutil.rmtree(tmp_path / "testing" / "image_2")
    folder = _one(tmp_path, noise(0, HEIGHT, WIDTH))
    with pytest.raises(LayoutError, match="expected an image_2 folder beside"):
        pack_submission(folder, tmp_path / "o.zip", calib, partial=True)


def test_probabilities_become_the_nearest_byte(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    probability = np.linspace(0, 1, 800 * 400, dtype=np.float32).reshape(BEV_SHAPE)
    np.save(tmp_path / "one" / "um_road_000000.npy", probability)
    packed = pack_submission(tmp_path / "one", tmp_path / "o.zip", partial=True)
    with zipfile.ZipFile(packed.path) as archive:
        assert archive.namelist() == ["um_road_000000.png"]
        found = cv2.imdecode(np.frombuffer(archive.read("um_road_000000.png"), np.uint8), -1)
    np.testing.assert_array_equal(found, np.rint(probability.astype(np.float64) * 255))


BAD_PROBABILITIES = {
    "NaN": (np.full(BEV_SHAPE, np.nan), r"in \[0, 1\], found nan"),
    "over one": (np.full(BEV_SHAPE, 1.5), r"in \[0, 1\], found 1\.5 to 1\.5"),
    "negative": (np.full(BEV_SHAPE, -0.1), r"in \[0, 1\]"),
    "integers": (np.zeros(BEV_SHAPE, np.uint8), r"floating.*found \(800, 400\) of uint8"),
    "channels": (np.zeros((2, 375, 1242)), r"floating.*found \(2, 375, 1242\) of float64"),
}


@pytest.mark.parametrize(("array", "found"), BAD_PROBABILITIES.values(), ids=BAD_PROBABILITIES)
def test_what_is_no_probability_is_refused(tmp_path: Path, array: np.ndarray, found: str) -> None:
    (tmp_path / "one").mkdir()
    np.save(tmp_path / "one" / "um_road_000000.npy", array)
    with pytest.raises(
        NimprepError, match=rf"um_road_000000\.npy.* ?\(?expected probabilities .*{found}"
    ):
        pack_submission(tmp_path / "one", tmp_path / "o.zip", partial=True)
    assert _left_behind(tmp_path) == []


def test_two_files_for_one_prediction_are_wrong(tmp_path: Path) -> None:
    folder = _one(tmp_path, VIEW)
    np.save(folder / "uu_road_000002.npy", VIEW / 255)
    with pytest.raises(LayoutError, match=r"1 wrong: uu_road_000002\.png \(beside uu_road_000002"):
        pack_submission(folder, tmp_path / "o.zip", partial=True)


@pytest.mark.parametrize(
    ("image", "what"),
    [(np.full(BEV_SHAPE, 7, np.uint8), "one value"), (VIEW // 128 * 255, "two values")],
    ids=["flat", "binary"],
)
def test_maps_without_levels_are_packed_with_a_warning(
    tmp_path: Path, image: np.ndarray, what: str
) -> None:
    with pytest.warns(UserWarning, match=rf"found only {what} in 1 predictions \(uu_road_000002\)"):
        pack_submission(_one(tmp_path, image), tmp_path / "o.zip", partial=True)


def test_an_empty_trial_is_refused(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    with pytest.raises(
        LayoutError, match="expected only test predictions of type road, found none"
    ):
        pack_submission(tmp_path / "one", tmp_path / "o.zip", partial=True)


def test_a_trial_still_refuses_what_does_not_belong(tmp_path: Path) -> None:
    folder = _one(tmp_path, VIEW)
    write_png(folder / "uu_road_000100.png", VIEW)
    with pytest.raises(LayoutError, match=r"1 extra: uu_road_000100\.png"):
        pack_submission(folder, tmp_path / "o.zip", partial=True)


def test_the_packed_view_is_the_official_one(reference_data: Path, tmp_path: Path) -> None:
    golden = reference_data / "kitti_road_golden"
    calib = reference_data / "kitti_road" / "training" / "calib"
    packed = pack_submission(golden / "perspective", tmp_path / "o.zip", calib, partial=True)
    with zipfile.ZipFile(packed.path) as archive:
        for name in packed.names:
            found = cv2.imdecode(np.frombuffer(archive.read(name), np.uint8), -1)
            np.testing.assert_array_equal(found, read_png(golden / "bev" / name))


def test_public_names_are_those_of_the_package() -> None:
    assert "pack_submission" in dir(nimprep.kitti)
    for name in nimprep.kitti.__all__:
        assert callable(getattr(nimprep.kitti, name))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = nimprep.kitti.nothing
