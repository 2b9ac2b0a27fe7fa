"""TartanGround: float32 depth in four bytes, 90 degrees wide, labels named per environment."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import SIZE, scene

NAMES = {"road": 7, "building": 11, "sky": 23, "car": 26, "van": 26}


def write_tartanground(
    root: Path, environments: tuple[str, ...] = ("Hospital", "OldTown")
) -> dict[str, int]:
    """Write two cameras of two trajectories of each environment; return seeds by id."""
    seeds: dict[str, int] = {}
    for environment in environments:
        for robot, trajectory in (("omni", "P0000"), ("anymal", "P2000")):
            for camera in ("lcam_front", "rcam_left"):
                seed = len(seeds)
                seeds[f"{environment}/{robot}/{trajectory}/{camera}/000000"] = seed
                folder, made = root / environment / f"Data_{robot}" / trajectory, scene(seed)
                depth = np.where(made.depth_m > 0, made.depth_m, 1e4).astype("<f4")
                # As OpenCV writes them: its channels are B, G, R, A.
                packed = np.ascontiguousarray(depth).view(np.uint8).reshape(*SIZE, 4)
                base = f"000000_{camera}"
                write_png(folder / f"image_{camera}" / f"{base}.png", made.rgb)
                write_png(folder / f"seg_{camera}" / f"{base}_seg.png", made.label)
                place = folder / f"depth_{camera}" / f"{base}_depth.png"
                place.parent.mkdir(parents=True)
                assert cv2.imwrite(str(place), packed)
        (root / environment / "seg_label_map.json").write_text(json.dumps({"name_map": NAMES}))
    return seeds


def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path) -> None:
    root = tmp_path / "TartanGround"
    seeds = write_tartanground(root)
    reader = open_reader(root)
    assert reader.info.name == "tartanground"
    front = {i: seed for i, seed in seeds.items() if "/lcam_front/" in i}
    assert reader.ids == tuple(sorted(front))
    assert any("camera lcam_front alone; --variations" in note for note in reader.info.notes)
    named = [(c.id, c.name) for c in reader.info.classes]
    assert named == [(7, "road"), (11, "building"), (23, "sky"), (26, "car, van")]
    for frame_id, seed in front.items():
        frame, made = reader.read(frame_id), scene(seed)
        assert reader.group(frame_id) == frame_id.partition("/")[0]
        assert reader.fixed_split(frame_id) is None
        camera = frame.camera
        # 90 degrees over the width, the centre in the middle, counted from the first pixel's.
        found = (camera.fx, camera.fy, camera.cx, camera.cy)
        assert found == pytest.approx((SIZE[1] / 2, SIZE[1] / 2, 17.5, 11.5))
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        np.testing.assert_array_equal(frame.depth_m, made.depth_m)
        np.testing.assert_array_equal(frame.label, made.label)


def test_the_camera_of_the_real_size_is_the_authors_counted_from_the_middle() -> None:
    camera = nimprep.Camera.from_fov(90, 640, 640)
    assert (camera.fx, camera.cx, camera.cy) == pytest.approx((320, 319.5, 319.5))


def test_other_cameras_are_taken_where_they_are_asked_for(tmp_path: Path) -> None:
    root = tmp_path / "TartanGround"
    seeds = write_tartanground(root)
    reader = open_reader(root, ReaderOptions(variations="rcam_left,lcam_front"))
    assert reader.ids == tuple(sorted(seeds))


def test_names_that_contradict_each_other_or_are_not_there_are_said(tmp_path: Path) -> None:
    root = tmp_path / "TartanGround"
    write_tartanground(root)
    path = root / "OldTown" / "seg_label_map.json"
    path.write_text(json.dumps({"name_map": {"road": 8}}))
    with pytest.raises(LayoutError, match="expected the same names of labels as Hospital"):
        open_reader(root)
    assert open_reader(root, labels=False).info.classes == ()
    path.write_text("[]")
    with pytest.raises(LayoutError, match=r"OldTown.*expected an object name_map"):
        open_reader(root)
    for each in root.glob("*/*.json"):
        each.unlink()
    reader = open_reader(root)
    assert any("no seg_label_map.json in any" in note for note in reader.info.notes)
    np.testing.assert_array_equal(reader.read(reader.ids[0]).label, scene(2).label)


def test_what_is_not_named_is_to_be_ignored(tmp_path: Path) -> None:
    root = tmp_path / "TartanGround"
    write_tartanground(root, ("Hospital",))
    (root / "Hospital" / "seg_label_map.json").write_text(json.dumps({"name_map": {"road": 7}}))
    reader = open_reader(root)
    label = reader.read("Hospital/omni/P0000/lcam_front/000000").label
    np.testing.assert_array_equal(label, np.where(scene(0).label == 7, 7, 255))


@pytest.mark.filterwarnings("ignore:.*lcam_front alone")
def test_convert_needs_no_option_and_a_part_or_folder_that_is_wrong_is_named(
    tmp_path: Path,
) -> None:
    root = tmp_path / "data" / "TartanGround"
    write_tartanground(root)
    store = nimprep.convert(root, tmp_path / "o.zarr")
    assert store.about.dataset == "tartanground"
    assert "2505.10696" in store.about.references[0]["citation"]
    assert inspect_source(root).reader == "tartanground"
    for wrong in (root / "Hospital", root.parent):
        with pytest.raises(LayoutError, match=f"did you mean {root}\\?"):
            open_reader(wrong)
    for folder in ("depth", "seg"):
        for path in sorted(root.rglob(f"*_{folder}.png")):
            path.unlink()
        if folder == "depth":
            with pytest.raises(LayoutError, match=r"expected depth files.*depth_lcam_front.zip"):
                open_reader(root)
    assert open_reader(root, depth=False).info.classes == ()
