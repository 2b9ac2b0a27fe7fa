"""TUM RGB-D: one sequence or several, paired in time, the camera by the folder's name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from tests.fakes import write_png
from tests.scenes import scene

START = 1305031102
CAMERAS = {
    "rgbd_dataset_freiburg1_xyz": (517.3, 516.5, 318.6, 255.3),
    "rgbd_dataset_Freiburg2_desk": (520.9, 521.0, 325.1, 249.7),
    "freiburg3_long_office": (535.4, 539.2, 320.1, 247.6),
    "office_7": (525.0, 525.0, 319.5, 239.5),
}


def write_sequence(root: Path, first: int = 0, count: int = 3) -> dict[str, int]:
    """Write frames a thirtieth of a second apart, depth 15 ms before; return seeds by time."""
    seeds: dict[str, int] = {}
    lists: dict[str, list[str]] = {"rgb": ["# timestamp filename"], "depth": ["# depth maps"]}
    for k in range(count):
        made, seed = scene(first + k), first + k
        # Microseconds: a double has no more digits than these need.
        times = {"rgb": 175304 + 33333 * k, "depth": 160407 + 33333 * k}
        raw = np.round(made.depth_m * 5000).clip(0, 65535).astype(np.uint16)
        for kind, image in (("rgb", made.rgb), ("depth", raw)):
            time = f"{START}.{times[kind]:06d}"
            write_png(root / kind / f"{time}.png", image)
            lists[kind].append(f"{time} {kind}/{time}.png")
        seeds[f"{START}.{times['rgb']:06d}"] = seed
    for kind, lines in lists.items():
        (root / f"{kind}.txt").write_text("\n".join(lines) + "\n")
    (root / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n")
    return seeds


def write_sequences(root: Path) -> dict[str, int]:
    """Write a sequence of each camera; return seeds by id."""
    seeds: dict[str, int] = {}
    for name in CAMERAS:
        made = write_sequence(root / name, len(seeds))
        seeds |= {f"{name}/{time}": seed for time, seed in made.items()}
    return seeds


def test_frames_are_what_the_lists_and_the_truth_say(tmp_path: Path) -> None:
    seeds = write_sequences(tmp_path)
    reader = open_reader(tmp_path)
    assert reader.info.name == "tum"
    assert reader.ids == tuple(sorted(seeds))
    assert reader.info.classes == ()
    for frame_id, seed in seeds.items():
        sequence = frame_id.partition("/")[0]
        frame, made = reader.read(frame_id), scene(seed)
        assert (reader.group(frame_id), reader.fixed_split(frame_id)) == (sequence, None)
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == CAMERAS[sequence]
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        assert frame.depth_m is not None
        near = made.depth_m < 13
        np.testing.assert_allclose(frame.depth_m[near], made.depth_m[near], atol=0.5 / 5000)
        # 65535 is what did not fit, and no 13.1 m.
        assert (frame.depth_m[~near] == 0).all()
    (note,) = [n for n in reader.info.notes if "no calibration" in n]
    assert "of 3 frames, first 'office_7/" in note
    assert "ROS's default for the Kinect" in note
    assert reader.info.calibration == "nominal"


def test_one_sequence_is_taken_too(tmp_path: Path) -> None:
    root = tmp_path / "rgbd_dataset_freiburg2_xyz"
    seeds = write_sequence(root)
    reader = open_reader(root)
    assert reader.ids == tuple(sorted(seeds))
    assert reader.info.calibration == "file"
    assert not any("no calibration" in note for note in reader.info.notes)
    assert reader.read(reader.ids[0]).camera.fx == 520.9


def test_images_of_half_the_size_have_the_numbers_scaled(tmp_path: Path) -> None:
    root = tmp_path / "freiburg3"
    write_sequence(root, count=1)
    for kind in ("rgb", "depth"):
        (path,) = (root / kind).iterdir()
        made = scene(0, (240, 320))
        raw = np.round(made.depth_m * 2000).astype(np.uint16)
        write_png(path, made.rgb if kind == "rgb" else raw)
    reader = open_reader(root)
    camera = reader.read(reader.ids[0]).camera
    assert (camera.fx, camera.cx) == pytest.approx((535.4 / 2, (320.1 + 0.5) / 2 - 0.5))


def test_distortion_is_left_unless_it_is_asked_for(tmp_path: Path) -> None:
    root = tmp_path / "freiburg1"
    write_sequence(root, count=1)
    assert not any("undistorted" in note for note in open_reader(root).info.notes)
    asked = open_reader(root, ReaderOptions(distortion="undistort"))
    assert any("distortion undistorted" in note for note in asked.info.notes)


def test_convert_needs_no_option_and_counts_hha_from_the_lowest_point(tmp_path: Path) -> None:
    root = tmp_path / "freiburg1_room"
    write_sequence(root)
    camera = (30, 31, 17.5, 8)
    store = nimprep.convert(root, tmp_path / "o.zarr", camera=camera)
    assert store.about.dataset == "tum"
    assert "IROS 2012" in store.about.references[0]["citation"]
    assert open_reader(root).info.hha_ground == "lowest"


def test_frames_without_a_partner_in_time_are_left_out_and_said(tmp_path: Path) -> None:
    root = tmp_path / "one"
    # The second colour image is of 208637 us.
    write_sequence(root, count=2)
    text = (root / "depth.txt").read_text()
    for microseconds, found in ((228638, 1), (228637, 2)):
        moved = text.replace(f"{START}.193740 ", f"{START}.{microseconds} ")
        (root / "depth.txt").write_text(moved)
        reader = open_reader(root)
        assert len(reader.ids) == found
        said = "1 of 2 colour images have no depth within 0.02 s"
        assert any(said in note for note in reader.info.notes) == (found == 1)


def test_images_that_a_list_names_and_are_not_there_are_said(tmp_path: Path) -> None:
    root = tmp_path / "one"
    write_sequence(root)
    lost = sorted((root / "rgb").iterdir())[1]
    lost.unlink()
    notes = open_reader(root).info.notes
    expected = f"1 images that lists of rgb name are not there, first rgb/{lost.name}"
    assert expected in notes


@pytest.mark.parametrize("several", [False, True])
def test_a_part_that_is_not_there_is_named(tmp_path: Path, several: bool) -> None:
    root = tmp_path / "a" / "b" / "set"
    sequence = root / "freiburg1" if several else root
    write_sequence(sequence)
    text = (sequence / "depth.txt").read_text()
    (sequence / "depth.txt").unlink()
    with pytest.raises(LayoutError, match=r"expected a list of times like '.*depth.txt', found"):
        open_reader(root)
    (sequence / "depth.txt").write_text(text)
    for path in sorted((sequence / "depth").iterdir()):
        path.unlink()
    with pytest.raises(LayoutError, match=r"expected depth files of tum.*unpack the sequence's"):
        open_reader(root)


def test_a_folder_too_deep_or_too_high_is_named(tmp_path: Path) -> None:
    root = tmp_path / "data" / "set"
    write_sequences(root)
    with pytest.raises(LayoutError, match=f"did you mean {root}\\?"):
        open_reader(tmp_path / "data")
    sequence = root / "office_7"
    with pytest.raises(LayoutError, match=f"did you mean {sequence}\\?"):
        open_reader(sequence / "depth")


def test_inspect_names_it_and_its_description_reads_the_same(tmp_path: Path) -> None:
    root = tmp_path / "set"
    write_sequences(root)
    found = inspect_source(root)
    assert (found.kind, found.reader) == ("reader", "tum")
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(root, ReaderOptions(description=tmp_path / "d.json"))
    named = open_reader(root)
    assert (described.ids, described.info) == (named.ids, named.info)


def test_a_folder_that_no_camera_is_for_is_a_bad_frame(tmp_path: Path) -> None:
    root = tmp_path / "set"
    write_sequences(root)
    description = inspect_source(root).description
    assert description is not None
    del description["camera"]["folders"]["*"]
    (tmp_path / "d.json").write_text(json.dumps(description))
    reader = open_reader(root, ReaderOptions(description=tmp_path / "d.json"))
    bad = [i for i in reader.ids if i.startswith("office_7")]
    with pytest.raises(nimprep.errors.NimprepError, match=r"expected a folder like .*freiburg1"):
        reader.read(bad[0])
    assert reader.read(reader.ids[0]).camera.fx == 535.4
