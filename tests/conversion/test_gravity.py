"""Gravity that is given: read, stored, made use of, carried on, and doubted where it turns."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from click.testing import CliRunner

import nimprep
from nimprep.camera import Camera
from nimprep.cli import main
from nimprep.derive.elevation import estimate_elevation, estimate_road_plane
from nimprep.derive.hha import encode_hha
from nimprep.doubts.gravity import gravity_doubts
from nimprep.errors import ArrayError, DoubtWarning, LayoutError, StoreError
from nimprep.images import read_depth
from nimprep.readers import ReaderOptions, open_reader
from nimprep.schema import schema_problems
from nimprep.store.attributes import GRAVITY_FROM
from nimprep.store.info import info_text, store_info
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.transforms import RandomHorizontalFlip, flip
from tests.fakes import write_png

CAMERA = Camera(100.0, 100.0, 63.5, 47.5, 128, 96)
HEIGHT_M = 1.3
Vector = npt.NDArray[np.float64]

SOURCE = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "rig",
    "rgb": "rgb/{time}.png",
    "id": "{time}",
    "depth": {"files": "depth/{time}.png", "scale_m": 0.001},
    "camera": CAMERA.to_dict(),
}


def rotation(roll_deg: float, pitch_deg: float) -> Vector:
    """Return the rotation from a level camera's frame to that of one rolled and looking down."""
    r, p = math.radians(roll_deg), math.radians(pitch_deg)
    roll = [[math.cos(r), -math.sin(r), 0], [math.sin(r), math.cos(r), 0], [0, 0, 1]]
    pitch = [[1, 0, 0], [0, math.cos(p), -math.sin(p)], [0, math.sin(p), math.cos(p)]]
    return np.array(roll) @ np.array(pitch)


def rolled_street(
    turn: Vector, camera: Camera = CAMERA, slope: float = 0.0
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_], Vector]:
    """Return depth of a road and a wall across it, where the road is, and heights over it, metres.

    The road climbs by `slope` ahead; heights are along gravity, over the level plane below.
    """
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )
    level = rays @ turn
    down = level[..., 1] + slope * level[..., 2]
    road = np.where(down > 1e-9, HEIGHT_M / np.maximum(down, 1e-9), np.inf)
    wall = np.where(level[..., 2] > 1e-9, 12 / np.maximum(level[..., 2], 1e-9), np.inf)
    depth = np.minimum(road, wall)
    depth[~np.isfinite(depth)] = 0
    return depth.astype(np.float32), road < wall, HEIGHT_M - level[..., 1] * depth


def write_frames(root: Path, turns: list[Vector], *, step: float = 0.1, **more: Any) -> Path:
    """Write frames at 0.0, 0.1 ... s of cameras turned so, and d.json that describes them."""
    for number, turn in enumerate(turns):
        depth, _, _ = rolled_street(turn)
        name = f"{number * step:.6f}.png"
        write_png(root / "rgb" / name, np.full((*CAMERA.shape, 3), 60 + number, np.uint8))
        write_png(root / "depth" / name, np.rint(depth * 1000).astype(np.uint16))
    (root / "d.json").write_text(json.dumps({**SOURCE, **more}))
    return root


def down_of(turn: Vector) -> Vector:
    return turn @ np.array([0.0, 1.0, 0.0])


def convert(root: Path, target: Path, **options: Any) -> nimprep.Store:
    made = {"modalities": ("rgb", "depth", "hha", "elevation"), "description": root / "d.json"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        return nimprep.convert(root, target, **{**made, **options})


@pytest.mark.parametrize(("roll", "pitch"), [(0, 6), (20, 10), (-35, 12), (60, 10), (8, 40)])
def test_hha_and_elevation_of_a_rolled_camera_are_the_scenes_own(roll: float, pitch: float) -> None:
    turn = rotation(roll, pitch)
    depth, road, heights = rolled_street(turn)
    gravity = 3.7 * down_of(turn)
    hha = encode_hha(depth, CAMERA, gravity=gravity, ground="floor")
    inside = np.zeros_like(road)
    inside[4:-4, 4:-4] = True
    near = inside & road & (np.abs(heights) < 1e-4) & (depth < 6)
    assert np.count_nonzero(near) > 500
    assert np.median(hha[near][:, 2]) == 38
    assert set(np.unique(hha[near][:, 1])) <= {20, 21}
    upright = inside & ~road & (heights > 0.6) & (heights < 2)
    if upright.any():
        assert np.median(hha[upright][:, 2]) == 128
        above = 100 * heights[upright] + 20 - hha[upright][:, 1]
        assert np.abs(above).max() < 1.6
    elevation = estimate_elevation(depth, CAMERA, gravity=gravity)
    assert np.nanmax(np.abs(elevation - heights)[depth > 0]) < 1e-5
    plane = estimate_road_plane(depth, CAMERA, gravity)
    assert plane == pytest.approx([*(-down_of(turn)), HEIGHT_M], abs=1e-5)


def test_heights_over_a_climbing_road_are_along_gravity() -> None:
    turn = rotation(10, 8)
    depth, _, heights = rolled_street(turn, slope=0.1)
    elevation = estimate_elevation(depth, CAMERA, gravity=down_of(turn))
    assert np.nanmax(np.abs(elevation - heights)[depth > 0]) < 1e-4
    assert elevation[depth > 0].max() > 0.5
    with pytest.raises(ArrayError, match="expected a road in it"):
        estimate_elevation(depth, CAMERA, gravity=(1, 0, 0))


def test_without_gravity_a_camera_rolled_by_60_degrees_is_not_understood() -> None:
    turn = rotation(60, 10)
    depth, road, heights = rolled_street(turn)
    near = road & (np.abs(heights) < 1e-4) & (depth < 6)
    assert np.median(encode_hha(depth, CAMERA)[near][:, 2]) > 60


def test_the_option_is_stored_and_tells_in_hha_and_elevation(tmp_path: Path) -> None:
    turn = rotation(25, 10)
    root = write_frames(tmp_path / "a", [turn, turn])
    gravity = (2 * down_of(turn)).tolist()
    store = convert(root, tmp_path / "a.zarr", gravity=gravity)
    assert store.tables.gravity == pytest.approx(np.tile(down_of(turn), (2, 1)))
    frame = store[0]
    assert frame.gravity == pytest.approx(down_of(turn))
    again = encode_hha(frame["depth"], CAMERA, gravity=gravity, ground="floor")
    np.testing.assert_array_equal(frame["hha"], again)
    _, road, _ = rolled_street(turn)
    assert np.nanmax(np.abs(frame["elevation"][road])) < 0.01
    assert store.about.frame_metadata[GRAVITY_FROM] == {"values": ["given"], "of_frame": [0, 0]}
    info = store_info(store)
    assert info["calibration"]["gravity"] == {"given": 2}
    assert schema_problems(info, "info") == schema_problems(store.attributes, "store") == []
    assert "gravity  given 2" in info_text(info)
    assert validate_store(tmp_path / "a.zarr", deep=True).problems == []


def test_what_is_estimated_stays_what_it_was(tmp_path: Path) -> None:
    root = write_frames(tmp_path / "a", [rotation(0, 8)])
    store = convert(root, tmp_path / "a.zarr")
    assert store[0].gravity is None
    assert GRAVITY_FROM not in store.about.frame_metadata
    assert store_info(store)["calibration"]["gravity"] == {"estimated": 1}
    assert store.tables.gravity[0] == pytest.approx(down_of(rotation(0, 8)), abs=0.02)


def test_gravity_without_hha_is_stored_too(tmp_path: Path) -> None:
    root = write_frames(tmp_path / "a", [rotation(25, 10)])
    store = convert(root, tmp_path / "a.zarr", gravity=(0.3, 1, 0), modalities=("depth",))
    assert store[0].gravity == pytest.approx(np.array([0.3, 1, 0]) / math.hypot(0.3, 1))


@pytest.mark.parametrize(
    ("given", "found"),
    [("0,1", "x,y,z"), ("0,0,0", "a direction"), ("a,b,c", "x,y,z"), ("0,nan,1", "a direction")],
)
def test_what_is_no_direction_is_refused_as_a_wrong_call(
    tmp_path: Path, given: str, found: str
) -> None:
    root = write_frames(tmp_path / "a", [rotation(0, 8)])
    command = ["convert", str(root), str(tmp_path / "o.zarr"), "--gravity", given]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    assert found in done.stderr
    assert not (tmp_path / "o.zarr").exists()


def test_a_camera_file_says_it_for_its_frames(tmp_path: Path) -> None:
    turn = rotation(-15, 10)
    camera = {**CAMERA.to_dict(), "gravity": (9.81 * down_of(turn)).tolist()}
    root = write_frames(tmp_path / "a", [turn], camera=camera)
    store = convert(root, tmp_path / "a.zarr")
    assert store[0].gravity == pytest.approx(down_of(turn))
    over = convert(root, tmp_path / "b.zarr", gravity=(0, 1, 0))
    assert over[0].gravity == pytest.approx([0, 1, 0])
    for wrong in ([0, 0, 0], [0, 1], "down", [0, None, 1]):
        (root / "cam.json").write_text(json.dumps({**CAMERA.to_dict(), "gravity": wrong}))
        with pytest.raises(nimprep.NimprepError, match="gravity"):
            open_reader(root, ReaderOptions(description=root / "d.json", camera=root / "cam.json"))


def test_a_table_of_cameras_has_it_in_columns(tmp_path: Path) -> None:
    turns = [rotation(0, 8), rotation(5, 8)]
    header = "time fx fy cx cy gravity_x gravity_y gravity_z"
    rows = [
        f"{n * 0.1:.6f} 100 100 63.5 47.5 {' '.join(map(str, down_of(turn)))}"
        for n, turn in enumerate(turns)
    ]
    root = write_frames(tmp_path / "a", turns, camera="cameras.txt")
    (root / "cameras.txt").write_text("\n".join([header, *rows]))
    store = convert(root, tmp_path / "a.zarr")
    assert store.tables.gravity == pytest.approx(np.stack([down_of(turn) for turn in turns]))
    (root / "cameras.txt").write_text(
        "\n".join([header, rows[0], rows[1].rsplit(" ", 3)[0] + " 0 0 0"])
    )
    with pytest.raises(nimprep.NimprepError, match=r"cameras\.txt:3: .*a direction in gravity_x"):
        open_reader(root, ReaderOptions(description=root / "d.json"))


def test_an_accelerometer_at_rest_points_up_and_is_joined_by_time(tmp_path: Path) -> None:
    turns = [rotation(roll, 8) for roll in (0, 3, 6)]
    gravity = {
        "files": "accelerometer.txt",
        "columns": ["time", "x", "y", "z"],
        "values": "acceleration",
        "by": "{time}",
    }
    root = write_frames(tmp_path / "a", turns, gravity=gravity)
    times = (0.004, 0.109, 0.15, 0.21)
    rows = [
        " ".join(
            map(str, (time, *(-9.81 * down_of(turns[min(n, 2)] if n != 2 else rotation(90, 0)))))
        )
        for n, time in enumerate(times)
    ]
    (root / "accelerometer.txt").write_text("# timestamp ax ay az\n" + "\n".join(rows) + "\n")
    store = convert(root, tmp_path / "a.zarr")
    assert store.tables.gravity == pytest.approx(np.stack([down_of(turn) for turn in turns]))
    _, road, _ = rolled_street(turns[2])
    assert np.nanmax(np.abs(store[2]["elevation"][road])) < 0.01
    upside_down = {**gravity, "values": "gravity"}
    (root / "d.json").write_text(json.dumps({**SOURCE, "gravity": upside_down}))
    wrong = convert(root, tmp_path / "b.zarr")
    assert wrong[0].gravity == pytest.approx(-down_of(turns[0]))


def test_frames_without_a_sample_in_time_are_estimated_and_said(tmp_path: Path) -> None:
    turn = rotation(0, 8)
    gravity = {"files": "imu.csv", "columns": ["time", "", "x", "y", "z"], "values": "gravity"}
    gravity |= {"by": "{time}", "tolerance_s": 0.01}
    root = write_frames(tmp_path / "a", [turn] * 3, gravity=gravity)
    x, y, z = (9.81 * down_of(turn)).tolist()
    row = f"0.0990001,7,{x},{y},{z}\n"
    (root / "imu.csv").write_text(f"t,n,gx,gy,gz\n{row}0.3,8,0,1,0\n")
    with pytest.warns(
        UserWarning, match=r"2 of 3 frames have no gravity within 0\.01 s.*0\.000000"
    ):
        store = convert(root, tmp_path / "a.zarr")
    sources = [store.gravity_source(n) for n in range(3)]
    assert sources == ["estimated", "given", "estimated"]
    assert [store[n].gravity is None for n in range(3)] == [True, False, True]
    (root / "imu.csv").write_text("7.5,7,0,1,0\n")
    with pytest.raises(LayoutError, match=r"imu\.csv.*none of any within 0\.01 s"):
        open_reader(root, ReaderOptions(description=root / "d.json"))


def test_a_trajectory_turns_the_worlds_gravity_into_the_cameras(tmp_path: Path) -> None:
    turn = rotation(12, 9)
    # The world's z points up, its x ahead: rows are the level camera's axes in it.
    level_to_world = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
    to_world = level_to_world @ turn.T
    w = math.sqrt(1 + np.trace(to_world)) / 2
    skew = to_world - to_world.T
    quaternion = [*(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4 * w)), w]
    columns = ["time", "", "", "", "qx", "qy", "qz", "qw"]
    gravity = {"files": "pose.txt", "columns": columns, "values": "camera_to_world"}
    gravity |= {"down": [0, 0, -1], "by": "{time}"}
    root = write_frames(tmp_path / "a", [turn], gravity=gravity)
    (root / "pose.txt").write_text(f"0.0 1 2 3 {' '.join(map(str, quaternion))}\n")
    assert convert(root, tmp_path / "a.zarr")[0].gravity == pytest.approx(down_of(turn))
    inverse = [-quaternion[0], -quaternion[1], -quaternion[2], quaternion[3]]
    (root / "pose.txt").write_text(f"0.0 1 2 3 {' '.join(map(str, inverse))}\n")
    document = {**SOURCE, "gravity": {**gravity, "values": "world_to_camera"}}
    (root / "d.json").write_text(json.dumps(document))
    assert convert(root, tmp_path / "b.zarr")[0].gravity == pytest.approx(down_of(turn))


def test_a_sensor_with_other_axes_is_turned_into_the_cameras(tmp_path: Path) -> None:
    # A body frame: x ahead, y left, z up.
    axes = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    gravity = {"files": "imu.txt", "columns": ["{time}", "x", "y", "z"], "values": "acceleration"}
    root = write_frames(
        tmp_path / "a", [rotation(0, 0)], gravity={**gravity, "sensor_to_camera": axes}
    )
    (root / "imu.txt").write_text("0.000000 0 0 9.81\n")
    reader = open_reader(root, ReaderOptions(description=root / "d.json"))
    assert reader.read(reader.ids[0]).gravity == pytest.approx([0, 1, 0])
    assert root / "imu.txt" in reader.sources(reader.ids[0])


@pytest.mark.parametrize(
    ("changes", "rows", "message"),
    [
        ({"values": None}, "", "'values'|values"),
        ({"columns": ["time", "x", "y"]}, "", "no z"),
        ({"by": None}, "0 0 1 0", 'give "by"'),
        ({"by": "{stamp}"}, "0 0 1 0", "found 'stamp'"),
        ({}, "0 0 1", "expected 4 columns"),
        ({}, "0 0 0 0", "expected a direction"),
        ({}, "0 0 nan 0", "expected a direction"),
        ({}, "now 0 1 0\nnow 0 1 0", "expected a time"),
        ({"down": [0, 0, 1]}, "0 0 1 0", "expected no 'down'"),
        ({"sensor_to_camera": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "0 0 1 0", "a rotation"),
        ({"columns": ["qx", "qy", "qz", "qw"], "values": "camera_to_world"}, "", "'down'"),
        ({"columns": ["time", "scene", "x", "y", "z"]}, "0 a 0 1 0", "found 'scene'"),
        ({"columns": ["{time}", "x", "y", "z"]}, "0 0 1 0\n0 1 1 0", "one row for '0'"),
    ],
)
def test_a_list_that_is_wrong_is_refused_in_a_line(
    tmp_path: Path, changes: dict[str, Any], rows: str, message: str
) -> None:
    gravity: dict[str, Any] = {"files": "imu.txt", "columns": ["time", "x", "y", "z"]}
    gravity |= {"values": "gravity", "by": "{time}", **changes}
    gravity = {name: value for name, value in gravity.items() if value is not None}
    root = write_frames(tmp_path / "a", [rotation(0, 8)], gravity=gravity)
    (root / "imu.txt").write_text(rows + "\n")
    with pytest.raises(LayoutError, match=message) as raised:
        open_reader(root, ReaderOptions(description=root / "d.json"))
    assert "\n" not in str(raised.value)


def test_gravity_that_turns_is_doubted_within_a_recording_alone(tmp_path: Path) -> None:
    turns = [rotation(roll, 8) for roll in (0, 6, 12)]
    rows = [f"{n * 0.1:.6f} {' '.join(map(str, down_of(t)))}\n" for n, t in enumerate(turns)]
    gravity = {"files": "g.txt", "columns": ["time", "x", "y", "z"], "values": "gravity"}
    gravity |= {"by": "{time}"}
    root = write_frames(tmp_path / "a", turns, gravity=gravity)
    (root / "g.txt").write_text("".join(rows))
    options = {"description": root / "d.json", "modalities": ("rgb",)}
    with pytest.warns(DoubtWarning, match=r"turns by 12 degrees .*\(3 frames, first '0\.000000'\)"):
        nimprep.convert(root, tmp_path / "a.zarr", **options)
    document = {**SOURCE, "gravity": gravity, "group": "{time}"}
    (root / "d.json").write_text(json.dumps(document))
    apart = nimprep.convert(root, tmp_path / "b.zarr", **options)
    assert apart.about.doubts == []


@pytest.mark.parametrize("roll", [0, 40, -55])
def test_gravity_that_points_up_is_doubted(tmp_path: Path, roll: float) -> None:
    root = write_frames(tmp_path / "a", [rotation(roll, 8)] * 2)
    down = down_of(rotation(roll, 8))
    expected = r"upside down; .* the sign is wrong.* \(2 frames, first '0\.000000'\)"
    with pytest.warns(DoubtWarning, match=expected) as said:
        store = nimprep.convert(
            root, tmp_path / "up.zarr", description=root / "d.json", gravity=tuple(-down)
        )
    assert [d["kind"] for d in store.about.doubts].count("gravity-up") == 1
    assert sum("upside down" in str(one.message) for one in said) == 1
    store = convert(root, tmp_path / "down.zarr", gravity=tuple(down))
    assert "gravity-up" not in [d["kind"] for d in store.about.doubts]


def test_gravity_along_the_axis_and_of_a_few_frames_is_not_taken_to_point_up() -> None:
    level, away, up = (0, 1, 0), (0, -0.4, 0.9165), (0, -1, 0)

    def kinds(*gravity: tuple[float, float, float], given: bool = True) -> list[str]:
        count = len(gravity)
        flags = np.full(count, given)
        found = gravity_doubts(list(map(str, range(count))), [""] * count, np.array(gravity), flags)
        return [doubt.kind for doubt in found if doubt.kind == "gravity-up"]

    assert kinds(away, away) == []
    assert kinds(up, level) == []
    assert kinds(up, up, given=False) == []
    assert kinds(up, up, level) == ["gravity-up"]


def test_append_and_merge_keep_each_frames_own_and_look_for_turns_anew(tmp_path: Path) -> None:
    level, leaning = rotation(0, 8), rotation(15, 8)
    first = write_frames(tmp_path / "a", [level])
    second = write_frames(tmp_path / "b", [leaning])
    (second / "rgb/0.000000.png").rename(second / "rgb/0.500000.png")
    (second / "depth/0.000000.png").rename(second / "depth/0.500000.png")
    given = convert(first, tmp_path / "a.zarr", gravity=down_of(level).tolist())
    assert given.about.doubts == []
    more = {"description": second / "d.json", "gravity": down_of(leaning).tolist()}
    with pytest.warns(DoubtWarning, match="turns by 15 degrees"):
        grown = nimprep.append_frames(second, tmp_path / "a.zarr", **more).store
    assert grown.about.frame_metadata[GRAVITY_FROM]["of_frame"] == [0, 0]
    assert grown[1].gravity == pytest.approx(down_of(leaning))
    estimated = convert(second, tmp_path / "b.zarr")
    stores = [convert(first, tmp_path / "c.zarr", gravity=(0, 1, 0)).path, estimated.path]
    merged = nimprep.merge_stores(stores, tmp_path / "m.zarr")
    assert [merged.gravity_source(n) for n in range(2)] == ["given", "estimated"]
    assert merged[1].gravity is None
    assert merged.about.doubts == []
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []


def test_a_store_that_says_what_was_said_before_takes_more_frames(tmp_path: Path) -> None:
    from nimprep.conversion.compatibility import as_said_now, options_like

    root = write_frames(tmp_path / "a", [rotation(0, 8)])
    store = convert(root, tmp_path / "a.zarr")
    before = dict(store.about.modalities)
    for name, key, said in (
        ("hha", "gravity", "from cam_to_road where a frame has it, else estimated"),
        (
            *("elevation", "plane"),
            "the road frame's y = 0 where a frame has cam_to_road, else fitted to the depth",
        ),
    ):
        made = before[name]
        store.about.modalities[name] = {**made, "parameters": {**made["parameters"], key: said}}
        assert as_said_now(store.about.modalities[name]) == made
    assert options_like(store).modalities == store.modalities
    store.about.modalities["hha"]["parameters"]["gravity"] = "guessed"
    with pytest.raises(StoreError, match="expected hha"):
        options_like(store)


def test_flips_turn_gravity_over_and_loaders_hand_it_on(tmp_path: Path) -> None:
    turn = rotation(20, 8)
    root = write_frames(tmp_path / "a", [turn, turn])
    store = convert(root, tmp_path / "a.zarr", gravity=down_of(turn).tolist())
    x, y, z = down_of(turn).tolist()
    plain = StoreDataset(store.path, split=None, modalities=("rgb",))
    assert plain[0]["gravity"].tolist() == pytest.approx([x, y, z], abs=1e-6)
    mirrored = StoreDataset(
        store.path, split=None, modalities=("rgb", "hha"), transform=RandomHorizontalFlip(1.0)
    )
    assert mirrored[0]["gravity"].tolist() == pytest.approx([-x, y, z], abs=1e-6)
    (batch,) = StoreLoader(plain, batch_size=2)
    assert batch["gravity"].shape == (2, 3)
    sample = {"rgb": torch.zeros(3, 4, 6, dtype=torch.uint8), "gravity": torch.tensor([x, y, z])}
    assert flip(sample)["gravity"].tolist() == pytest.approx([-x, y, z])
    estimated = convert(root, tmp_path / "b.zarr")
    assert "gravity" not in StoreDataset(estimated.path, split=None, modalities=("rgb",))[0]


def test_a_mirrored_frames_hha_is_that_of_its_gravity() -> None:
    turn = rotation(20, 8)
    depth, _, _ = rolled_street(turn)
    x, y, z = down_of(turn)
    hha = encode_hha(depth, CAMERA, gravity=(x, y, z), ground="floor")
    mirrored = encode_hha(
        np.ascontiguousarray(depth[:, ::-1]), CAMERA.flip(), gravity=(-x, y, z), ground="floor"
    )
    assert np.abs(mirrored[:, ::-1].astype(int) - hha).max() <= 1


@pytest.mark.filterwarnings("ignore:.*no calibration")
def test_a_real_frame_has_heights_along_the_gravity_given(
    reference_data: Path, tmp_path: Path
) -> None:
    estimated = nimprep.convert(
        reference_data / "gmrp", tmp_path / "e.zarr", modalities=("hha",), labels=False
    )
    found = estimated.tables.gravity[0]
    lean = rotation(4, 0) @ found
    out = tmp_path / "s.zarr"
    command = ["convert", str(reference_data / "gmrp"), str(out), "--no-labels", "--modalities"]
    command += ["depth,hha,elevation", "--gravity", ",".join(map(str, lean.tolist()))]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 0, done.output
    store = nimprep.open_store(out)
    frame = store[0]
    assert frame.gravity == pytest.approx(lean)
    raw = read_depth(reference_data / "gmrp/depth_u16/000001.png")
    depth = np.where(raw == 65535, 0, raw / np.float32(1000)).astype(np.float32)
    hha = encode_hha(depth, frame.camera, gravity=lean, ground="floor")
    np.testing.assert_array_equal(frame["hha"], hha)
    # Two points differ in elevation by what they do along gravity.
    v, u = (part[:: len(part) // 7] for part in np.nonzero(frame["depth"]))
    z, camera = frame["depth"][v, u].astype(float), frame.camera
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    heights = -(points @ lean)
    elevation = frame["elevation"][v, u]
    assert len(elevation) >= 7
    assert np.diff(elevation) == pytest.approx(np.diff(heights), abs=2e-3)


def test_kitti_takes_gravity_over_its_calibrations(reference_data: Path, tmp_path: Path) -> None:
    options = {"modalities": ("hha", "elevation"), "labels": False}
    source = reference_data / "kitti_road"
    own = nimprep.convert(source, tmp_path / "a.zarr", **options)
    assert store_info(own)["calibration"]["gravity"] == {"cam_to_road": 4}
    given = nimprep.convert(source, tmp_path / "b.zarr", gravity=(0.1, 1, 0), **options)
    assert store_info(given)["calibration"]["gravity"] == {"given": 4}
    assert not np.array_equal(own[0]["hha"], given[0]["hha"])
    assert not np.array_equal(own[0]["elevation"], given[0]["elevation"])
