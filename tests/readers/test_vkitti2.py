"""Virtual KITTI 2: scenes in variations, two cameras, colours that a text file names."""

from __future__ import annotations

import json
import shutil
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import DecodeError, LayoutError
from nimprep.inspection.inspection import inspect_source
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.color_names import named_colors
from tests.fakes import write_png
from tests.scenes import scene

SCENES = ("Scene01", "Scene06", "Scene20")
VARIATIONS = ("15-deg-left", "clone")
COLORS = {
    "Terrain": (210, 0, 200),
    "Sky": (90, 200, 255),
    "Tree": (0, 199, 0),
    "Vegetation": (90, 240, 0),
    "Building": (140, 140, 140),
    "Road": (100, 60, 100),
    "GuardRail": (250, 100, 255),
    "TrafficSign": (255, 255, 0),
    "TrafficLight": (200, 200, 0),
    "Pole": (255, 130, 0),
    "Misc": (80, 80, 80),
    "Truck": (160, 60, 60),
    "Car": (255, 127, 80),
    "Van": (0, 139, 139),
}
NAMES = {7: "Road", 11: "Building", 23: "Sky", 26: "Car"}


def write_vkitti2(root: Path) -> dict[str, int]:
    """Write two frames per scene, variation and camera; return each frame's seed by its id."""
    seeds: dict[str, int] = {}
    for place, variation in product(SCENES, VARIATIONS):
        folder = root / place / variation
        rows = ["frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]"]
        # One scene has colours of its own: those of its file count.
        colors = dict(COLORS)
        if place == "Scene06":
            colors |= {"Road": COLORS["Sky"], "Sky": COLORS["Road"]}
        for frame, camera in product(range(2), range(2)):
            seed = len(seeds)
            seeds[f"{place}/{variation}/Camera_{camera}/{frame:05d}"] = seed
            made = scene(seed)
            rows.append(f"{frame} {camera} {30 + seed} 31 17.5 8.25")
            raw = np.round(made.depth_m * 100).astype(np.uint16)
            raw[made.depth_m == 0] = 65535
            raw[3, :4] = 60000
            label = np.zeros((*made.label.shape, 3), np.uint8)
            for value, name in NAMES.items():
                label[made.label == value] = colors[name]
            label[20, :3] = 0
            at = folder / "frames"
            number = f"{frame:05d}.png"
            write_png(at / "rgb" / f"Camera_{camera}" / f"rgb_{number}", made.rgb)
            write_png(at / "depth" / f"Camera_{camera}" / f"depth_{number}", raw)
            write_png(at / "classSegmentation" / f"Camera_{camera}" / f"classgt_{number}", label)
            write_png(at / "forwardFlow" / f"Camera_{camera}" / f"flow_{number}", label)
        (folder / "intrinsic.txt").write_text("\n".join(rows) + "\n")
        lines = [f"{name} {r} {g} {b}" for name, (r, g, b) in colors.items()]
        (folder / "colors.txt").write_text("\n".join(["Category r g b", *lines, ""]))
    return seeds


@pytest.fixture
def vkitti2(tmp_path: Path) -> Path:
    write_vkitti2(tmp_path / "vk")
    return tmp_path / "vk"


def apart(root: Path, target: Path) -> None:
    """Move each archive's files into a folder of its own."""
    kinds = {
        "rgb": "frames/rgb",
        "depth": "frames/depth",
        "classSegmentation": "frames/classSegmentation",
    }
    for place, variation in product(SCENES, VARIATIONS):
        for name, inner in kinds.items():
            moved = target / f"vkitti_2.0.3_{name}" / place / variation / inner
            moved.parent.mkdir(parents=True, exist_ok=True)
            shutil.move(root / place / variation / inner, moved)
        text = target / "vkitti_2.0.3_textgt" / place / variation
        text.mkdir(parents=True)
        for name in ("intrinsic.txt", "colors.txt"):
            shutil.move(root / place / variation / name, text / name)


@pytest.mark.parametrize("side_by_side", [False, True])
def test_frames_are_what_the_folders_and_the_truth_say(tmp_path: Path, side_by_side: bool) -> None:
    seeds = write_vkitti2(tmp_path / "made")
    root = tmp_path / "made"
    if side_by_side:
        root = tmp_path / "vk"
        apart(tmp_path / "made", root)
    reader = open_reader(root)
    assert reader.info.name == "vkitti2"
    assert reader.ids == tuple(sorted(seeds))
    assert reader.info.split_by == "group"
    assert [(c.id, c.name) for c in reader.info.classes] == [(0, "other"), (1, "road")]
    for frame_id, seed in seeds.items():
        frame, made = reader.read(frame_id), scene(seed)
        assert reader.group(frame_id) == frame_id.split("/")[0]
        assert reader.fixed_split(frame_id) is None
        camera = frame.camera
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30 + seed, 31, 17.5, 8.25)
        np.testing.assert_array_equal(frame.rgb, made.rgb)
        depth = np.round(made.depth_m * 100) / np.float32(100)
        depth[3, :4] = 600
        np.testing.assert_array_equal(frame.depth_m, depth)
        label = (made.label == 7).astype(np.uint8)
        label[20, :3] = 255
        np.testing.assert_array_equal(frame.label, label)


def test_all_classes_are_those_of_the_file(tmp_path: Path) -> None:
    seeds = write_vkitti2(tmp_path)
    reader = open_reader(tmp_path, ReaderOptions(label_set="classes"))
    names = [c.name for c in reader.info.classes]
    assert [c.id for c in reader.info.classes] == list(range(14))
    assert [name.replace(" ", "") for name in names] == [name.lower() for name in COLORS]
    for frame_id in ("Scene01/clone/Camera_0/00000", "Scene06/clone/Camera_1/00001"):
        label = reader.read(frame_id).label
        assert label is not None
        made = scene(seeds[frame_id])
        for value, name in NAMES.items():
            where = made.label == value
            where[20, :3] = False
            assert {*label[where].tolist()} == {names.index(name.lower())}


def test_variations_and_the_camera_choose_frames_on_the_command_line(
    vkitti2: Path, tmp_path: Path
) -> None:
    out = tmp_path / "v.zarr"
    options = ["--variations", "clone", "--camera", "1", "--modalities", "rgb,depth,label"]
    done = CliRunner().invoke(main, ["convert", str(vkitti2), str(out), *options])
    assert done.exit_code == 0, done.stderr
    store = nimprep.open_store(out)
    assert store.ids == tuple(
        f"{place}/clone/Camera_1/{frame:05d}" for place in SCENES for frame in range(2)
    )
    # Scenes stay together, and depth of 600 m is kept.
    of_scene = {place: {store.splits[i] for i in store.ids if place in i} for place in SCENES}
    assert sorted(map(list, of_scene.values())) == [["test"], ["train"], ["val"]]
    assert store[0].depth_m is not None
    assert store[0].depth_m.max() == 600
    assert "Virtual KITTI 2" in store.about.references[0]["citation"]
    with pytest.raises(LayoutError, match=r"expected variation fog.*found 15-deg-left, clone"):
        open_reader(vkitti2, ReaderOptions(variations="fog"))


def test_two_scenes_are_left_whole_in_train_and_that_is_said(vkitti2: Path, tmp_path: Path) -> None:
    shutil.rmtree(vkitti2 / "Scene06")
    reader = open_reader(vkitti2)
    assert any("fewer than 3 scenes" in note for note in reader.info.notes)
    with pytest.warns(UserWarning, match="all frames are in train"):
        whole = nimprep.convert(vkitti2, tmp_path / "whole.zarr", modalities=("rgb", "label"))
    assert set(whole.splits.values()) == {"train"}
    options = {"modalities": ("rgb", "label"), "split_by": "frame"}
    split = nimprep.convert(vkitti2, tmp_path / "split.zarr", **options)
    assert set(split.splits.values()) == {"train", "val", "test"}


@pytest.mark.parametrize(
    ("folder", "archive"),
    [
        ("frames/depth", "vkitti_2.0.3_depth.tar"),
        ("frames/classSegmentation", "vkitti_2.0.3_classSegmentation.tar"),
        ("frames/rgb", "vkitti_2.0.3_rgb.tar"),
        ("intrinsic.txt", "vkitti_2.0.3_textgt.tar.gz"),
        ("colors.txt", "vkitti_2.0.3_textgt.tar.gz"),
    ],
)
def test_an_archive_that_was_not_unpacked_is_named(
    vkitti2: Path, folder: str, archive: str
) -> None:
    for path in sorted(vkitti2.glob(f"*/*/{folder}")):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(LayoutError, match=f"{folder}.*unpack {archive} there"):
        open_reader(vkitti2)


def test_a_folder_too_deep_or_too_high_is_answered_with_the_right_one(
    vkitti2: Path, tmp_path: Path
) -> None:
    deep = vkitti2 / "Scene01/clone/frames"
    for wrong in (tmp_path, vkitti2 / "Scene01", deep.parent, deep, deep / "rgb/Camera_0"):
        with pytest.raises(LayoutError, match=rf"did you mean {vkitti2}\?"):
            open_reader(wrong)


def test_a_colour_that_nothing_names_is_an_error(vkitti2: Path) -> None:
    path = vkitti2 / "Scene01/clone/frames/classSegmentation/Camera_0/classgt_00001.png"
    write_png(path, np.full((24, 36, 3), 1, np.uint8))
    with pytest.raises(DecodeError, match=r"classgt_00001.png: .*found #010101"):
        open_reader(vkitti2).read("Scene01/clone/Camera_0/00001")


def test_a_frame_that_lacks_its_row_or_its_colours_is_bad(vkitti2: Path) -> None:
    rows = (vkitti2 / "Scene01/clone/intrinsic.txt").read_text().splitlines()
    (vkitti2 / "Scene01/clone/intrinsic.txt").write_text("\n".join(rows[:-1]))
    (vkitti2 / "Scene20/clone/colors.txt").unlink()
    reader = open_reader(vkitti2)
    with pytest.raises(nimprep.errors.CameraError, match="expected a row for frame 1, cameraID 1"):
        reader.read("Scene01/clone/Camera_1/00001")
    with pytest.raises(DecodeError, match="expected names of colours of frame 'Scene20/clone"):
        reader.read("Scene20/clone/Camera_0/00000")


def test_inspect_names_it_and_its_description_reads_the_same(vkitti2: Path, tmp_path: Path) -> None:
    found = inspect_source(vkitti2)
    assert (found.kind, found.reader) == ("reader", "vkitti2")
    (tmp_path / "d.json").write_text(json.dumps(found.description))
    described = open_reader(vkitti2, ReaderOptions(description=tmp_path / "d.json"))
    named = open_reader(vkitti2)
    assert (described.ids, described.info) == (named.ids, named.info)
    some = named.ids[9]
    np.testing.assert_array_equal(described.read(some).label, named.read(some).label)
    assert vkitti2 / "Scene01/15-deg-left/colors.txt" in named.sources(named.ids[0])


@pytest.mark.parametrize(
    ("text", "colors"),
    [
        ("Category r g b\nRoad 1 2 3\n", {"Road": (1, 2, 3)}),
        (
            "name,r,g,b\nRoad lane, 1, 2, 3\n# more\nSky,4,5,6",
            {"Road lane": (1, 2, 3), "Sky": (4, 5, 6)},
        ),
        ("64 128 64\tAnimal\n", {"Animal": (64, 128, 64)}),
    ],
)
def test_colours_are_named_in_any_usual_way(
    tmp_path: Path, text: str, colors: dict[str, tuple[int, int, int]]
) -> None:
    (tmp_path / "c.txt").write_text(text)
    assert named_colors(tmp_path / "c.txt") == colors


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("Road 1 2 3\nSky\n", "expected a name and its colour from 0 to 255.*found 'Sky'"),
        ("Road 1 2 3\nSky 256 0 0\n", "found 'Sky 256 0 0'"),
        ("Road 1 2 3\nRoad 1 2 4\n", "expected one colour for 'Road', found two"),
        ("Category r g b\n", "expected names of colours, found none"),
    ],
)
def test_a_file_that_names_no_colours_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "c.txt").write_text(text)
    with pytest.raises(DecodeError, match=said):
        named_colors(tmp_path / "c.txt")


def test_two_meanings_of_a_colour_and_names_of_another_dataset_are_refused(vkitti2: Path) -> None:
    path = vkitti2 / "Scene01/clone/colors.txt"
    text = path.read_text()
    path.write_text(text.replace("Sky 90 200 255", "Sky 100 60 100"))
    with pytest.raises(DecodeError, match="'Sky' and of 'Road'"):
        open_reader(vkitti2).read("Scene01/clone/Camera_0/00000")
    path.write_text("one 1 2 3\n")
    with pytest.raises(DecodeError, match=r"expected names among Terrain, .*found one"):
        open_reader(vkitti2).read("Scene01/clone/Camera_0/00000")
