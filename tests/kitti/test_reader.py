"""The reader kitti-road: ids, splits, labels, depth and calibration of a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError
from nimprep.kitti.calibration import FRAME_SHAPES
from nimprep.readers.base import Reader
from nimprep.readers.kitti_road import KittiRoadReader
from nimprep.splits import assign_splits

from .scenes import (
    BASELINE_M,
    HEIGHT,
    MATRICES,
    WIDTH,
    ground_truth,
    noise,
    road_folder,
    write_calibration,
    write_png,
)

NAMES = ("um_000000", "um_000001", "umm_000000", "uu_000000")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    road_folder(tmp_path / "road", NAMES)
    return road_folder(tmp_path / "road", ("um_000000", "uu_000005"), "testing")


def test_ids_name_the_split_and_the_frame(root: Path) -> None:
    reader: Reader = KittiRoadReader(root)
    assert reader.ids == (
        "testing/um_000000",
        "testing/uu_000005",
        *(f"training/{name}" for name in NAMES),
    )
    assert [reader.group(i) for i in reader.ids] == ["um", "uu", "um", "um", "umm", "uu"]
    assert reader.info.name == "kitti-road"
    assert reader.info.calibration == "file"


def test_testing_frames_are_test_and_training_frames_train_and_val(tmp_path: Path) -> None:
    names = tuple(f"{c}_{i:06d}" for c in ("um", "uu") for i in range(10))
    root = road_folder(tmp_path / "road", names)
    road_folder(root, ("um_000000",), "testing")
    reader = KittiRoadReader(root)
    fixed = {i: s for i in reader.ids if (s := reader.fixed_split(i))}
    assert fixed == {"testing/um_000000": "test"}
    groups = {i: reader.group(i) for i in reader.ids}
    splits = assign_splits(groups, "stratified", fixed=fixed)
    val = [i for i, split in splits.items() if split == "val"]
    # The default rule within each category: ceil(0.15 * 10) = 2 of each.
    assert sorted(groups[i] for i in val) == ["um", "um", "uu", "uu"]


def test_a_frame_has_image_depth_label_and_calibration(root: Path) -> None:
    frame = KittiRoadReader(root).read("training/um_000001")
    assert frame.rgb is not None
    np.testing.assert_array_equal(frame.rgb[..., ::-1], noise(1, HEIGHT, WIDTH, 3))
    assert frame.depth_m is not None
    assert (frame.depth_m == np.float32(8.001)).all()
    np.testing.assert_array_equal(frame.camera.matrix, MATRICES["P2"][:, :3])
    assert frame.baseline_m == pytest.approx(BASELINE_M)
    assert frame.cam_to_road is not None
    assert frame.cam_to_road.shape == (3, 4)
    assert frame.group == "um"


def test_labels_are_road_no_road_and_not_evaluated(root: Path) -> None:
    road, evaluated = np.zeros((2, HEIGHT, WIDTH), bool)
    road[30:], evaluated[10:] = True, True
    truth = ground_truth(road, evaluated)
    write_png(root / "training" / "gt_image_2" / "um_road_000000.png", truth)
    label = KittiRoadReader(root).read("training/um_000000").label
    assert label is not None
    assert [label[row, 0] for row in (0, 10, 29, 30)] == [255, 0, 0, 1]


def test_testing_frames_have_no_truth_and_are_ignored_throughout(root: Path) -> None:
    label = KittiRoadReader(root).read("testing/uu_000005").label
    assert label is not None
    assert (label == 255).all()


def test_lanes_are_read_from_um_frames_alone(root: Path) -> None:
    reader = KittiRoadReader(root, target="lane")
    assert {reader.group(i) for i in reader.ids} == {"um"}
    assert [c.name for c in reader.info.classes] == ["not lane", "lane"]
    paths = reader.sources("training/um_000000")
    assert root / "training" / "gt_image_2" / "um_lane_000000.png" in paths


def test_only_what_is_asked_for_is_decoded(root: Path) -> None:
    (root / "training" / "depth_u16" / "um_000000.png").write_bytes(b"no image")
    frame = KittiRoadReader(root).read("training/um_000000", ("rgb", "label"))
    assert frame.depth_m is None
    assert frame.rgb is not None


def test_the_depths_source_is_known_per_frame(root: Path) -> None:
    files = root / "training" / "depth_u16" / "umm_000000.png"
    files.unlink()
    with pytest.raises(DecodeError, match=r"depth_u16/umm_000000\.png or velodyne/.* or image_3/"):
        KittiRoadReader(root).read("training/umm_000000")
    write_png(root / "training" / "image_3" / "umm_000000.png", noise(0, HEIGHT, WIDTH, 3))
    reader = KittiRoadReader(root)
    assert reader.depth_source("training/umm_000000") == "stereo"
    assert reader.depth_source("training/um_000000") == "depth_u16"
    metadata = reader.metadata("training/umm_000000")
    assert metadata["depth_source"] == "stereo"
    np.testing.assert_allclose(metadata["calibration"]["P2"], MATRICES["P2"], rtol=1e-12)


def test_frames_can_be_read_without_any_depth(root: Path) -> None:
    for path in (root / "training" / "depth_u16").iterdir():
        path.unlink()
    reader = KittiRoadReader(root, depth=False)
    assert reader.depth_source("training/um_000000") is None
    assert reader.read("training/um_000000").depth_m is None


def test_a_training_frame_needs_its_truth(root: Path) -> None:
    (root / "training" / "gt_image_2" / "uu_road_000000.png").unlink()
    with pytest.raises(DecodeError, match=r"uu_road_000000\.png: expected the ground truth"):
        KittiRoadReader(root).read("training/uu_000000")
    reader = KittiRoadReader(root, labels=False)
    assert reader.read("training/uu_000000").label is None
    assert reader.info.classes == ()


def test_every_size_of_the_benchmark_is_read(tmp_path: Path) -> None:
    for number, (fx, (height, width)) in enumerate(FRAME_SHAPES.items()):
        name = f"um_{number:06d}"
        folder = tmp_path / "road" / "testing"
        write_png(folder / "image_2" / f"{name}.png", np.zeros((height, width, 3), np.uint8))
        p2 = np.array([[fx, 0, 600, 45], [0, fx, 180, 0.2], [0, 0, 1, 0.003]])
        write_calibration(folder / "calib" / f"{name}.txt", P2=p2)
    reader = KittiRoadReader(tmp_path / "road", depth=False)
    assert [reader.shape(i) for i in reader.ids] == list(FRAME_SHAPES.values())
    assert [reader.read(i).camera.shape for i in reader.ids] == list(FRAME_SHAPES.values())


def test_an_image_of_another_size_than_p2s_is_refused(root: Path) -> None:
    p2 = np.array([[721.5377, 0, 600, 45], [0, 721.5377, 180, 0.2], [0, 0, 1, 0.003]])
    write_calibration(root / "training" / "calib" / "um_000000.txt", P2=p2)
    with pytest.raises(DecodeError, match=r"um_000000\.png: expected 1242x375 pixels for P2"):
        KittiRoadReader(root).read("training/um_000000")


def test_a_truth_of_another_size_is_refused(root: Path) -> None:
    truth = ground_truth(np.ones((HEIGHT, WIDTH + 1), bool))
    write_png(root / "training" / "gt_image_2" / "um_road_000000.png", truth)
    with pytest.raises(DecodeError, match=r"um_road_000000\.png: expected 120x60 .*found 121x60"):
        KittiRoadReader(root).read("training/um_000000")


def test_a_calibration_without_the_road_leaves_the_frame_without_its_transform(root: Path) -> None:
    write_calibration(root / "training" / "calib" / "um_000000.txt", Tr_cam_to_road=None)
    assert KittiRoadReader(root).read("training/um_000000").cam_to_road is None


def test_names_outside_the_benchmark_are_refused(root: Path) -> None:
    write_png(root / "training" / "image_2" / "000000.png", noise(0, HEIGHT, WIDTH, 3))
    write_calibration(root / "training" / "calib" / "000000.txt")
    with pytest.raises(LayoutError, match=r"expected a name .*found '000000\.png'"):
        KittiRoadReader(root)


def test_real_frames_are_read(reference_data: Path) -> None:
    reader = KittiRoadReader(reference_data / "kitti_road")
    assert reader.ids[0] == "testing/um_000000"
    assert [reader.depth_source(i) for i in reader.ids] == [
        "depth_u16",
        "stereo",
        "stereo",
        "depth_u16",
    ]
    frame = reader.read("training/uu_000000")
    assert frame.label is not None
    # The official devkit's count of road pixels.
    assert np.count_nonzero(frame.label == 1) == 71998
    assert frame.depth_m is not None
    assert (frame.camera.fx, frame.camera.shape) == (721.5377, (375, 1242))
