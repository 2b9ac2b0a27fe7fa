"""KITTI road through `convert`: every size in one store, calibration and depth's source kept."""

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError
from nimprep.splits import count_splits
from nimprep.store.info import store_info
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.kitti.scenes import (
    MATRICES,
    ground_truth,
    noise,
    write_calibration,
    write_png,
    write_whole_benchmark,
)

SIZES = {721.5377: (1242, 375), 718.856: (1241, 376), 707.0912: (1226, 370), 707.0493: (1224, 370)}

CAMERAS_M = {"P2": 0.06, "P3": 0.06 - 0.54}


def write_frame(root: Path, split: str, name: str, fx: float) -> None:
    width, height = SIZES[fx]
    k = np.array([[fx, 0, width / 2], [0, fx, height / 2], [0, 0, 1]])
    projections = {p: k @ np.hstack([np.eye(3), [[x], [0], [0]]]) for p, x in CAMERAS_M.items()}
    write_calibration(root / split / "calib" / f"{name}.txt", **projections)
    write_png(root / split / "image_2" / f"{name}.png", noise(1, height, width, 3))
    depth = np.full((height, width), 8000, np.uint16)
    depth[: height // 2] = 0
    write_png(root / split / "depth_u16" / f"{name}.png", depth)
    if split == "training":
        road = np.zeros((height, width), bool)
        road[height // 2 :] = True
        category, number = name.split("_")
        evaluated = np.ones((height, width), bool)
        evaluated[:10] = False
        truth = ground_truth(road, evaluated)
        write_png(root / split / "gt_image_2" / f"{category}_road_{number}.png", truth)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> nimprep.Store:
    folder = tmp_path_factory.mktemp("kitti")
    for number, fx in enumerate(SIZES):
        for category in ("um", "umm", "uu"):
            write_frame(folder / "data_road", "training", f"{category}_{number:06d}", fx)
    write_frame(folder / "data_road", "testing", "um_000000", 721.5377)
    return nimprep.convert(folder / "data_road", folder / "s.zarr", shard_length=8)


def test_every_size_of_the_benchmark_goes_into_one_store(made: nimprep.Store) -> None:
    assert made.arrays["rgb"].shape == (13, 376, 1242, 3)
    found = {(f.camera.fx, f.camera.width, f.camera.height) for f in made}
    assert found == {(fx, *size) for fx, size in SIZES.items()}
    for frame in made:
        assert frame.rgb is not None
        assert frame.rgb.shape[:2] == frame.camera.shape
    assert validate_store(made.path, deep=True).problems == []


def test_testing_frames_are_test_and_training_frames_train_and_val(made: nimprep.Store) -> None:
    assert made.splits["testing/um_000000"] == "test"
    assert count_splits(made.splits.values()) == {"train": 9, "val": 3, "test": 1}
    validation = [made.tables.group[i] for i in made.indices("val")]
    assert sorted(validation) == ["um", "umm", "uu"]
    assert made.attributes["split"] == {"rule": "eighth", "seed": 0}


def test_splitting_anew_leaves_the_testing_frames_test(made: nimprep.Store) -> None:
    splits = resplit(made.path, rule="frame", seed=4)
    assert splits["testing/um_000000"] == "test"
    assert count_splits(splits.values())["test"] == 1
    assert count_splits(resplit(made.path, rule="eighth", seed=0).values())["val"] == 3


def test_labels_are_ignored_outside_the_evaluated_area_and_in_testing_frames(
    made: nimprep.Store,
) -> None:
    frame = made[made.ids.index("training/um_000000")]
    assert frame.label is not None
    assert (frame.label[:10] == 255).all()
    assert (frame.label[-1] == 1).all()
    assert (made[made.ids.index("testing/um_000000")].label == 255).all()
    assert [c.name for c in made.classes] == ["not road", "road"]


def test_calibration_is_composed_and_the_raw_matrices_stay(made: nimprep.Store) -> None:
    frame = made[0]
    assert np.isclose(frame.baseline_m, 0.54)
    assert frame.cam_to_road is not None
    # The camera hangs 1.65 m above the road, whose y axis points down.
    assert np.allclose(frame.cam_to_road @ (0.06, 1.65, 10, 1), (0, 0, 10))
    column = made.attributes["frame_metadata"]["calibration"]
    assert len(column["values"]) == 4
    raw = column["values"][column["of_frame"][0]]
    assert np.allclose(raw["Tr_cam_to_road"], MATRICES["Tr_cam_to_road"])


def test_gravity_is_the_roads_where_the_calibration_knows_it(made: nimprep.Store) -> None:
    assert np.allclose(made.tables.gravity, (0, 1, 0))


def test_where_depth_came_from_is_recorded_and_shown(made: nimprep.Store) -> None:
    assert store_info(made.path)["depth_sources"] == {"depth_u16": 13}


def test_the_real_frames_convert_with_the_depth_each_has(
    reference_data: Path, tmp_path: Path
) -> None:
    store = nimprep.convert(reference_data / "kitti_road", tmp_path / "s.zarr")
    assert store_info(store.path)["depth_sources"] == {"depth_u16": 2, "stereo": 2}
    assert validate_store(store.path, deep=True).problems == []
    # The road's normal in the calibration is gravity, nearly straight down in the image.
    assert (store.tables.gravity @ (0, 1, 0) > np.cos(np.radians(3))).all()
    frame = store[store.ids.index("training/uu_000000")]
    assert frame.depth_m is not None
    estimated = nimprep.estimate_gravity(frame.depth_m, frame.camera)
    assert estimated @ store.tables.gravity[store.ids.index("training/uu_000000")] > 0.99


def test_without_a_need_for_depth_none_is_asked_for(made: nimprep.Store, tmp_path: Path) -> None:
    root = tmp_path / "data_road"
    write_frame(root, "training", "um_000000", 721.5377)
    (root / "training" / "depth_u16" / "um_000000.png").unlink()
    with pytest.raises(LayoutError, match="um_000000"):
        nimprep.convert(root, tmp_path / "a.zarr")
    store = nimprep.convert(root, tmp_path / "b.zarr", modalities=("rgb", "label"))
    assert store.modalities == ("rgb", "label")


def test_options_that_replace_the_benchmarks_calibration_are_refused(
    made: nimprep.Store, tmp_path: Path
) -> None:
    root = tmp_path / "data_road"
    write_frame(root, "training", "um_000000", 721.5377)
    with pytest.raises(LayoutError, match="leave out --camera"):
        nimprep.convert(root, tmp_path / "a.zarr", camera=(1, 1, 1, 1))


@pytest.mark.parametrize("halves", [("training", "testing"), ("training",)])
def test_the_whole_benchmark_is_253_to_train_and_36_to_validate(
    tmp_path: Path, halves: tuple[str, ...]
) -> None:
    root = write_whole_benchmark(tmp_path / "data_road")
    if "testing" not in halves:
        shutil.rmtree(root / "testing")
    made = nimprep.convert(root, tmp_path / "s.zarr", modalities=["label"], shard_length=512)
    test = 290 if "testing" in halves else 0
    expected = {"train": 253, "val": 36, "test": test}
    assert count_splits(made.splits.values()) == expected
    assert Counter(made.tables.group[i] for i in made.indices("val")) == dict.fromkeys(
        ("um", "umm", "uu"), 12
    )
    assert {i.split("/")[0] for i, s in made.splits.items() if s == "test"} <= {"testing"}
    # Another rule, and back.
    assert count_splits(resplit(made.path, rule="stratified").values())["val"] == 45
    assert count_splits(resplit(made.path, rule="eighth").values()) == expected


@pytest.mark.parametrize("lost", ["gt_image_2/um_road_000001.png", "calib/um_000001.txt"])
def test_a_frame_that_lacks_a_file_is_left_out_on_request(tmp_path: Path, lost: str) -> None:
    root = tmp_path / "data_road"
    for number in range(3):
        write_frame(root, "training", f"um_00000{number}", 721.5377)
    (root / "training" / lost).unlink()
    with pytest.raises(DecodeError, match=r"expected the .* of frame training/um_000001, found n"):
        nimprep.convert(root, tmp_path / "s.zarr")
    store = nimprep.convert(root, tmp_path / "s.zarr", on_error="skip")
    assert store.ids == ("training/um_000000", "training/um_000002")
    assert [frame["id"] for frame in store.about.skipped] == ["training/um_000001"]
