"""HHA's height: counted from the floor, which no outlier moves, or from the lowest point."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep import convert
from nimprep.derive.gravity import estimate_gravity
from nimprep.derive.hha import encode_hha
from nimprep.errors import ArrayError
from nimprep.readers import open_reader
from tests.derive.test_hha import CAMERA, SMALL, cast, inner, rays, room, tilted
from tests.fakes import write_gmrp
from tests.naive import hha as naive


def heights(depth_m, camera, down, ground):
    return encode_hha(depth_m, camera, gravity=down, ground=ground)[..., 1].astype(int)


@pytest.mark.parametrize("pitch", [12.0, 20.0, 35.0])
def test_a_floor_is_20_cm_and_what_stands_on_it_is_higher(pitch: float) -> None:
    down = tilted(pitch)
    depth, surface = room(down)
    found = heights(depth, CAMERA, down, "floor")
    floor = (surface == 0) & inner(surface, 10)
    assert floor.any()
    # The floor's height is told to a centimetre.
    assert set(np.unique(found[floor])) <= {20, 21}
    points = rays(CAMERA) * depth[..., None]
    above = 150 - 100 * points @ down
    assert np.abs(found - np.clip(above + 20, 0, 255))[depth > 0].max() <= 1.5


def test_one_point_far_below_the_road_moves_the_lowest_point_alone() -> None:
    down = tilted(12.0)
    depth, surface = room(down)
    floor = (surface == 0) & inner(surface, 10)
    v, u = np.argwhere((surface == 0) & ~floor)[-1]
    hole = depth.copy()
    hole[v, u] *= 4
    lowest = heights(hole, CAMERA, down, "lowest")
    assert np.all(lowest[floor] == 255)
    assert set(np.unique(heights(hole, CAMERA, down, "floor")[floor])) <= {20, 21}


def test_a_hole_in_a_road_stays_visible_and_a_deep_one_is_0() -> None:
    down = tilted(30.0)
    depth, surface = room(down)
    road = depth[surface == 0]
    for deep_cm, expected in ((10, 10), (40, 0)):
        holed = depth.copy()
        rows, columns = np.nonzero((surface == 0) & inner(surface, 3))
        some = (rows[:20], columns[:20])
        holed[some] *= 1 + deep_cm / 150
        found = heights(holed, CAMERA, down, "floor")
        assert np.abs(found[some] - expected).max() <= 1
    assert road.size > 100


def test_without_a_floor_in_view_the_lowest_point_counts() -> None:
    down = tilted(0.0)
    depth, _ = cast(CAMERA, [(np.array([0.0, 0.0, 1.0]), 3.0)])
    assert np.array_equal(*(heights(depth, CAMERA, down, g) for g in ("floor", "lowest")))


def test_a_table_above_the_camera_or_a_ceiling_is_no_floor() -> None:
    down = tilted(-20.0)
    depth, surface = room(down)
    depth = np.where(surface == 0, 0, depth)
    assert np.array_equal(*(heights(depth, CAMERA, down, g) for g in ("floor", "lowest")))


def test_the_plain_twin_agrees_on_rough_ground() -> None:
    down = tilted(15.0)
    depth, _ = room(down, SMALL)
    rough = np.random.default_rng(0).normal(1, 0.01, depth.shape)
    depth = np.where(np.random.default_rng(1).random(depth.shape) < 0.1, 0, depth * rough)
    depth = np.round(depth, 3)
    normals = naive.normals(depth, SMALL, depth == 0, 10)
    height = -100 * (rays(SMALL) @ down) * depth
    level = np.abs(normals @ down) > np.cos(np.radians(15))
    floor = np.sort(height[(depth > 0) & level & (height < 0)])
    # A hundredth of the pixels decides on a centimetre here.
    ground = floor[int(0.1 * floor.size)]
    expected = np.clip(np.round(height - ground + 20), 0, 255)
    found = heights(depth, SMALL, down, "floor")
    assert np.abs(found - expected)[depth > 0].max() <= 1


def test_estimated_gravity_is_the_same_and_threads_change_nothing() -> None:
    depth, _ = room(tilted(12.0))
    gravity = estimate_gravity(depth, CAMERA)
    one, many, given = (
        encode_hha(depth, CAMERA, ground="floor", **how)
        for how in ({"num_threads": 1}, {"num_threads": 3}, {"gravity": gravity})
    )
    assert np.array_equal(one, many)
    assert np.array_equal(one, given)


def test_another_ground_is_refused() -> None:
    with pytest.raises(ArrayError, match="ground: expected one of lowest, floor, found 'sea'"):
        encode_hha(np.ones(CAMERA.shape), CAMERA, ground="sea")


def test_a_gmrp_frame_is_no_longer_saturated(reference_data) -> None:
    frame = open_reader(reference_data / "gmrp").read("000001")
    some = frame.depth_m > 0
    shares = {
        ground: np.mean(encode_hha(frame.depth_m, frame.camera, ground=ground)[some, 1] == 255)
        for ground in ("lowest", "floor")
    }
    assert shares["lowest"] > 0.999
    assert shares["floor"] < 0.02


def test_convert_counts_from_the_floor_and_can_do_as_the_reference(tmp_path) -> None:
    raw = write_gmrp(tmp_path / "gmrp", frames=3)
    camera = (60.0, 60.0, 15.5, 11.5)
    for name, options in (("floor", {}), ("lowest", {"hha_ground": "lowest"})):
        store = convert(raw, tmp_path / f"{name}.zarr", camera=camera, **options)
        said = store.about.modalities["hha"]["parameters"]
        assert said.get("ground", "lowest") == name
        frame = store[0]
        expected = encode_hha(frame["depth"], frame.camera, ground=name)
        assert np.array_equal(frame["hha"], expected)
