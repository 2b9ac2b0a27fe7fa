"""KITTI 2015 with semantic labels: sparse disparity, a test split without depth and labels."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.recognition import recognised
from tests.fakes import write_png
from tests.kitti.scenes import road_folder
from tests.scenes import CX, CY, FX, FY, disparity_of, scene

BASELINE_M = 0.5327


def write_kitti(root: Path, frames: int = 3) -> Path:
    for split in ("training", "testing"):
        for k in range(frames):
            folder, made = root / split, scene(k)
            write_png(folder / "image_2" / f"{k:06d}_10.png", made.rgb)
            write_png(folder / "image_2" / f"{k:06d}_11.png", made.rgb[::-1])
            write_png(folder / "image_3" / f"{k:06d}_10.png", made.rgb)
            if split == "training":
                disparity = disparity_of(made.depth_m, (FX + k) * BASELINE_M)
                write_png(folder / "disp_occ_0" / f"{k:06d}_10.png", sparse(disparity * 256))
                write_png(folder / "semantic" / f"{k:06d}_10.png", made.label)
                write_png(folder / "semantic_rgb" / f"{k:06d}_10.png", made.rgb)
            calib = folder / "calib_cam_to_cam" / f"{k:06d}.txt"
            calib.parent.mkdir(parents=True, exist_ok=True)
            calib.write_text(calibration(FX + k))
    return root


def sparse(raw: np.ndarray) -> np.ndarray:
    raw = raw.round().astype(np.uint16)
    raw[1::2] = 0
    return raw


def calibration(fx: float) -> str:
    # The left colour camera stands beside the grey one, whose origin the projections share.
    left = 0.06
    shifts = {0: 0.0, 1: -0.54, 2: left, 3: left - BASELINE_M}
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for c, shift in shifts.items():
        lines += [
            f"S_{c:02d}: 1.392000e+03 5.120000e+02",
            f"K_{c:02d}: 984.2 0 690 0 980.8 233.2 0 0 1",
            f"D_{c:02d}: -0.37 0.2 0.001 0.0009 -0.07",
            f"S_rect_{c:02d}: 3.600000e+01 2.400000e+01",
            f"P_rect_{c:02d}: {fx} 0 {CX} {fx * shift} 0 {FY} {CY} 0 0 0 1 0",
        ]
    return "\n".join(lines) + "\n"


def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path) -> None:
    reader = open_reader(write_kitti(tmp_path))
    assert reader.info.name == "kitti-semantics"
    assert reader.ids == tuple(f"{s}/{k:06d}" for s in ("testing", "training") for k in range(3))
    for frame_id in reader.ids:
        split, number = frame_id.split("/")
        frame, made = reader.read(frame_id), scene(int(number))
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        camera = frame.camera
        assert (camera.fx, camera.fy) == (FX + int(number), FY)
        assert (camera.cx, camera.cy) == (CX, CY)
        np.testing.assert_allclose(frame.baseline_m, BASELINE_M, rtol=1e-9)
        assert reader.group(frame_id) == ""
        assert frame.depth_m is not None
        assert frame.label is not None
        if split == "testing":
            assert reader.fixed_split(frame_id) == "test"
            assert not frame.depth_m.any()
            assert (frame.label == 255).all()
            continue
        assert reader.fixed_split(frame_id) == "train"
        expected = made.depth_m.copy()
        expected[1::2] = 0
        np.testing.assert_allclose(frame.depth_m, expected, rtol=25 * 0.5 / 256 / (FX * BASELINE_M))
        np.testing.assert_array_equal(frame.label, made.label == 7)
    assert any("none of the frames of split test has depth" in n for n in reader.info.notes)


def test_label_sets_are_those_of_cityscapes(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    of_train = {7: 0, 11: 2, 23: 10, 26: 13}
    label = (
        open_reader(tmp_path, ReaderOptions(label_set="train-ids")).read("training/000001").label
    )
    assert label is not None
    expected = np.vectorize(of_train.get)(scene(1).label)
    np.testing.assert_array_equal(label, expected)


def test_a_training_frame_without_disparity_is_a_bad_frame(tmp_path: Path) -> None:
    write_kitti(tmp_path)
    (tmp_path / "training/disp_occ_0/000001_10.png").unlink()
    reader = open_reader(tmp_path)
    with pytest.raises(DecodeError, match="000001_10"):
        reader.read("training/000001")
    assert reader.read("training/000002").depth_m is not None


@pytest.mark.parametrize(
    ("folder", "archive"),
    [
        ("disp_occ_0", "data_scene_flow.zip"),
        ("semantic", "data_semantics.zip"),
        ("calib_cam_to_cam", "data_scene_flow_calib.zip"),
    ],
)
def test_an_archive_that_was_not_unpacked_is_named(
    tmp_path: Path, folder: str, archive: str
) -> None:
    write_kitti(tmp_path)
    for path in sorted(tmp_path.glob(f"*/{folder}")):
        shutil.rmtree(path)
    with pytest.raises(LayoutError, match=rf"{folder}.*unpack {archive} there"):
        open_reader(tmp_path)


def test_the_road_benchmark_is_none_of_it(tmp_path: Path) -> None:
    assert recognised(write_kitti(tmp_path / "a")).reader == "kitti-semantics"
    assert recognised(road_folder(tmp_path / "b", ("um_000010",))).reader == "kitti-road"
    road_folder(tmp_path / "a", ("um_000010",))
    said = "found those of kitti-road and kitti-semantics"
    with pytest.raises(LayoutError, match=said):
        recognised(tmp_path / "a")
    assert any(said in note for note in inspect_source(tmp_path / "a").notes)
    meant = open_reader(tmp_path / "a", ReaderOptions(reader="kitti-semantics"))
    assert len(meant.ids) == 6
