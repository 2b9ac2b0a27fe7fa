"""HHA: analytic scenes, the plain twin, the reference's own pictures."""

from __future__ import annotations

import json
import math
import subprocess
import sys

import cv2
import numpy as np
import pytest

from nimprep.camera import Camera
from nimprep.derive.gravity import estimate_gravity
from nimprep.derive.hha import encode_hha
from nimprep.errors import ArrayError
from tests.naive import hha as naive
from tests.processes import PATIENCE_S

CAMERA = Camera(fx=90.0, fy=95.0, cx=61.5, cy=44.0, width=120, height=90)
SMALL = Camera(fx=30.0, fy=28.0, cx=15.3, cy=10.8, width=32, height=24)


def tilted(pitch_deg: float, roll_deg: float = 0.0) -> np.ndarray:
    """Return the direction of gravity in a camera pitched down and rolled, degrees."""
    pitch, roll = math.radians(pitch_deg), math.radians(roll_deg)
    down = np.array([0.0, math.cos(pitch), math.sin(pitch)])
    c, s = math.cos(roll), math.sin(roll)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ down


def rays(camera: Camera) -> np.ndarray:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def cast(camera: Camera, planes: list[tuple[np.ndarray, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth and the index of the first of the planes n·P = d (d > 0) that rays meet."""
    along = np.stack([rays(camera) @ normal for normal, _ in planes])
    distances = np.array([distance for _, distance in planes])[:, None, None]
    depth = np.where(along > 1e-6, distances / np.maximum(along, 1e-6), np.inf)
    return depth.min(axis=0), depth.argmin(axis=0)


def room(down: np.ndarray, camera: Camera = CAMERA) -> tuple[np.ndarray, np.ndarray]:
    """Return depth and surface (0 floor, 1 far wall, 2 left, 3 right, 4 ceiling) of a room.

    The camera stands 1.5 m above the floor and 1 m below the ceiling.
    """
    right = np.cross(down, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    forward = np.cross(right, down)
    walls = [(forward, 4.0), (-right, 2.0), (right, 2.5)]
    return cast(camera, [(down, 1.5), *walls, (-down, 1.0)])


def inner(surface: np.ndarray, radius: int) -> np.ndarray:
    """Return where the whole window lies on one surface."""
    square = np.ones((2 * radius + 1, 2 * radius + 1))
    low, high = (f(surface.astype(np.float32), square) for f in (cv2.erode, cv2.dilate))
    return low == high


@pytest.mark.parametrize("pitch", [-20.0, 0.0, 12.0, 35.0])
@pytest.mark.parametrize("roll", [0.0, 8.0])
def test_gravity_of_a_room_is_its_floor_s_normal(pitch: float, roll: float) -> None:
    down = tilted(pitch, roll)
    depth, _ = room(down)
    found = estimate_gravity(depth, CAMERA)
    assert np.linalg.norm(found) == pytest.approx(1, abs=1e-12)
    # Windows across the edges of the room give planes in between, some within 15 degrees.
    assert math.degrees(math.acos(found @ down)) < 0.5


@pytest.mark.parametrize("pitch", [0.0, 12.0, 30.0])
def test_a_room_has_its_heights_and_angles(pitch: float) -> None:
    down = tilted(pitch)
    depth, surface = room(down)
    hha = encode_hha(depth, CAMERA, gravity=down).astype(int)
    height_cm = 150 - 100 * (depth[..., None] * rays(CAMERA)) @ down
    np.testing.assert_array_equal(hha[..., 0], np.minimum(np.rint(310 / np.maximum(depth, 1)), 255))
    assert np.abs(hha[..., 1] - height_cm).max() <= 0.5 + 1e-4
    whole = inner(surface, 3)
    for index, level in enumerate([38, 128, 128, 128, 218]):
        assert set(hha[whole & (surface == index), 2]) <= {level}
    assert {38, 128} <= set(hha[..., 2].ravel())


def test_a_road_seen_from_a_car_has_its_height_and_angle() -> None:
    camera = Camera(fx=360.0, fy=360.0, cx=155.0, cy=43.0, width=310, height=94)
    down = tilted(1.5, -0.8)
    depth, _ = cast(camera, [(down, 1.65)])
    depth[depth > 80] = 0
    np.testing.assert_allclose(estimate_gravity(depth, camera), down, atol=1e-6)
    hha = encode_hha(depth, camera)
    assert set(hha[depth > 0, 1]) <= {0, 1}
    assert set(hha[depth > 0, 2]) == {38}


def test_a_given_gravity_is_used_whatever_its_length() -> None:
    depth, _ = room(tilted(10.0))
    down = tilted(25.0)
    expected = encode_hha(depth, CAMERA, gravity=down)
    np.testing.assert_array_equal(encode_hha(depth, CAMERA, gravity=list(9.81 * down)), expected)
    assert (encode_hha(depth, CAMERA) != expected).any()


def test_heights_do_not_turn_below_a_tenth_of_a_degree() -> None:
    depth = np.full(CAMERA.shape, 80.0)
    upright = encode_hha(depth, CAMERA, gravity=(0, 1, 0))
    np.testing.assert_array_equal(
        encode_hha(depth, CAMERA, gravity=tilted(0, 0.09))[..., 1], upright[..., 1]
    )
    assert (encode_hha(depth, CAMERA, gravity=tilted(0, 0.11))[..., 1] != upright[..., 1]).any()


def test_ground_that_is_out_of_view_is_taken_130_cm_below() -> None:
    depth = np.full(CAMERA.shape, 1.5)
    hha = encode_hha(depth, CAMERA, gravity=(0, 1, 0))
    assert -150 * (CAMERA.height - 1 - CAMERA.cy) / CAMERA.fy > -90
    expected = 130 - 150 * (np.arange(CAMERA.height) - CAMERA.cy) / CAMERA.fy
    assert np.abs(hha[..., 1] - expected[:, None]).max() <= 0.5 + 1e-4


def test_ground_95_cm_below_is_in_view() -> None:
    camera = Camera(90, 90, 60, 10, 120, 106)
    for lowest_cm, level in ((85, 45), (95, 0)):
        hha = encode_hha(
            np.full(camera.shape, lowest_cm * 90 / 95 / 100), camera, gravity=(0, 1, 0)
        )
        assert set(hha[-1, :, 1]) == {level}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("unit", [0.001, 0.0001, None])
def test_the_plain_twin_agrees(seed: int, unit: float | None) -> None:
    rng = np.random.default_rng(seed)
    depth = room(tilted(10.0), SMALL)[0] * rng.uniform(0.97, 1.03, SMALL.shape)
    depth[rng.random(SMALL.shape) < [0.0, 0.3, 0.9][seed]] = 0
    if unit is None:
        metres = depth.astype(np.float32)
        exact = metres.astype(np.float64)
    else:
        exact = np.rint(depth / unit) / (1 / unit)
        metres = exact.astype(np.float32)
    none = np.zeros(SMALL.shape, bool)
    down = estimate_gravity(metres, SMALL)
    np.testing.assert_allclose(down, naive.gravity(exact, SMALL, none), atol=1e-7)
    np.testing.assert_array_equal(
        encode_hha(metres, SMALL), naive.encode_hha(exact, SMALL, none, down)
    )


def test_normals_point_away_from_the_camera_even_where_the_fit_does_not_hold() -> None:
    rng = np.random.default_rng(11)
    depth = np.rint(np.exp(rng.uniform(-1, 4, SMALL.shape)) * 1000) / 1000
    missing = rng.random(SMALL.shape) < 0.85
    down = tilted(20.0)
    expected = naive.encode_hha(depth, SMALL, missing, down)
    found = encode_hha(depth, SMALL, missing, gravity=down)
    plane = ~np.isnan(naive.normals(depth, SMALL, missing, 3)[..., 0])
    assert np.count_nonzero(plane) > 600
    np.testing.assert_array_equal(found[plane], expected[plane])


def test_a_window_on_one_line_has_no_normal_and_counts_as_180_degrees() -> None:
    depth = np.zeros(SMALL.shape, np.float32)
    depth[7, 4:20] = 2.0
    depth[15, 6] = 2.0
    depth[15:20, 22] = 2.0
    hha = encode_hha(depth, SMALL)
    assert set(hha[depth > 0, 2]) == {218}
    depth[8, 10] = 2.0
    assert set(encode_hha(depth, SMALL)[7, 4:20, 2]) == {218, 128}


def test_a_mask_that_marks_nothing_changes_nothing() -> None:
    depth = room(tilted(10.0))[0]
    depth[20:40, 30:60] = depth[:, 5:] = 0
    np.testing.assert_array_equal(
        encode_hha(depth, CAMERA, np.zeros(CAMERA.shape, bool)), encode_hha(depth, CAMERA)
    )


def test_pixels_without_depth_are_zero_and_no_others() -> None:
    depth = room(tilted(10.0))[0].astype(np.float32)
    holes = np.zeros(CAMERA.shape, bool)
    holes[20:40, 30:60] = holes[:, 100] = holes[3, 3] = True
    depth[holes] = np.nan
    hha = encode_hha(depth, CAMERA)
    assert not hha[holes].any()
    assert (hha[~holes, 2] >= 38).all()


def test_filled_pixels_are_points_but_take_no_part_in_planes() -> None:
    rng = np.random.default_rng(5)
    depth = np.rint(room(tilted(10.0), SMALL)[0] * 1000) / 1000
    missing = np.zeros(SMALL.shape, bool)
    missing[5:10, 8:13] = missing[15, 20:25] = True
    filled = np.where(
        missing, np.rint(depth * 1000 * rng.uniform(0.9, 1.1, SMALL.shape)) / 1000, depth
    )
    hole = np.where(missing, 0, depth)
    down = estimate_gravity(filled, SMALL, missing)
    np.testing.assert_array_equal(down, estimate_gravity(hole, SMALL))
    expected = naive.encode_hha(filled, SMALL, missing, down)
    np.testing.assert_array_equal(encode_hha(filled, SMALL, missing), expected)
    assert (encode_hha(filled, SMALL)[..., 2] != expected[..., 2]).any()


@pytest.mark.parametrize("yaw", [0.0, 30.0])
def test_a_lone_wall_leaves_gravity_where_it_was(yaw: float) -> None:
    angle = math.radians(yaw)
    depth, _ = cast(CAMERA, [(np.array([math.sin(angle), 0.0, math.cos(angle)]), 3.0)])
    np.testing.assert_allclose(estimate_gravity(depth, CAMERA), [0, 1, 0], atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (2, 2)])
def test_tiny_images_are_encoded(shape: tuple[int, int]) -> None:
    camera = Camera(50, 50, shape[1] / 2, shape[0] / 2, shape[1], shape[0])
    hha = encode_hha(np.full(shape, 2.0), camera)
    np.testing.assert_array_equal(estimate_gravity(np.full(shape, 2.0), camera), [0, 1, 0])
    assert set(hha[..., 0].ravel()) == {155}
    assert set(hha[..., 2].ravel()) == {128 if shape == (2, 2) else 218}


def test_an_image_without_depth_is_all_none() -> None:
    depth = np.zeros(CAMERA.shape)
    assert not encode_hha(depth, CAMERA).any()
    np.testing.assert_array_equal(estimate_gravity(depth, CAMERA), [0, 1, 0])


def test_threads_do_not_change_a_bit() -> None:
    depth, _ = room(tilted(10.0, 3.0))
    missing = np.zeros(CAMERA.shape, bool)
    missing[10:40, 30:33] = True
    expected = encode_hha(depth, CAMERA, missing, num_threads=1)
    for threads in (2, 3, None):
        np.testing.assert_array_equal(
            encode_hha(depth, CAMERA, missing, num_threads=threads), expected
        )


def test_read_only_and_strided_arrays_are_read() -> None:
    depth = room(tilted(10.0))[0].astype(np.float32)
    expected = encode_hha(depth, CAMERA, np.zeros(CAMERA.shape, bool))
    wide = np.repeat(depth, 2, axis=1)
    depth.flags.writeable = False
    missing = np.zeros(CAMERA.shape, bool)
    missing.flags.writeable = False
    np.testing.assert_array_equal(encode_hha(depth, CAMERA, missing), expected)
    np.testing.assert_array_equal(encode_hha(wide[:, ::2], CAMERA, missing), expected)


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="no fork on this system")
def test_a_forked_child_encodes_too() -> None:
    script = """
import os, numpy as np
from nimprep.camera import Camera
from nimprep.derive.hha import encode_hha
camera = Camera(90, 90, 60, 60, 120, 120)
depth = np.random.default_rng(0).uniform(1, 5, (120, 120))
before = encode_hha(depth, camera, num_threads=2)
child = os.fork()
if child == 0:
    os._exit(0 if (encode_hha(depth, camera, num_threads=2) == before).all() else 1)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=PATIENCE_S)


def test_millimetres_are_refused_by_name() -> None:
    depth, _ = room(tilted(10.0))
    with pytest.raises(ArrayError, match=r"expected metres, found a median of .* millimetres"):
        encode_hha(depth * 1000, CAMERA)
    with pytest.raises(ArrayError, match="tenths of a millimetre; divide by 10000"):
        encode_hha(depth * 10000, CAMERA)
    with pytest.raises(ArrayError, match="expected metres"):
        estimate_gravity(depth / 1000, CAMERA)
    with pytest.raises(ArrayError, match="expected floating-point metres"):
        encode_hha((depth * 1000).astype(np.uint16), CAMERA)


def test_a_few_far_or_near_pixels_are_no_wrong_unit() -> None:
    depth, _ = room(tilted(10.0))
    depth[:40] = 500.0
    depth[80:] = 0.01
    assert encode_hha(depth, CAMERA).shape == (*CAMERA.shape, 3)


@pytest.mark.parametrize(
    "missing", [np.zeros((3, 3), bool), np.zeros(CAMERA.shape, np.float32), np.zeros(CAMERA.shape)]
)
def test_a_mask_of_another_shape_or_type_is_refused(missing: np.ndarray) -> None:
    with pytest.raises(ArrayError, match="missing: expected"):
        encode_hha(np.ones(CAMERA.shape), CAMERA, missing)


@pytest.mark.parametrize("gravity", [(0, 0, 0), (0, np.nan, 1), (0, 1), [[0, 1, 0]], 1.0])
def test_a_gravity_that_is_no_direction_is_refused(gravity: object) -> None:
    with pytest.raises(ArrayError, match="gravity: expected"):
        encode_hha(np.ones(CAMERA.shape), CAMERA, gravity=gravity)


def reference_frame(reference_data):
    folder = reference_data / "nyu_hha"
    numbers = json.loads((folder / "camera.json").read_text())
    names = ("depth_filled", "depth_raw", "hha_matlab", "hha_reference_with_missing")
    filled, raw, *expected = (cv2.imread(str(folder / f"{n}.png"), -1) for n in names)
    height, width = filled.shape
    # The file counts pixels from 1.
    center = numbers["cx"] - 1, numbers["cy"] - 1
    camera = Camera(numbers["fx"], numbers["fy"], *center, width, height)
    depth_m = filled / np.float32(round(1 / numbers["depth_scale"]))
    return depth_m, raw == 0, camera, [picture[..., ::-1].astype(int) for picture in expected]


def test_filled_depth_gives_the_original_s_picture(reference_data) -> None:
    depth_m, _, camera, (expected, _) = reference_frame(reference_data)
    difference = np.abs(encode_hha(depth_m, camera) - expected).max(axis=-1)
    assert difference.max() <= 1
    assert np.count_nonzero(difference) <= difference.size / 100_000


def test_missing_values_give_the_reference_s_picture(reference_data) -> None:
    depth_m, missing, camera, (_, expected) = reference_frame(reference_data)
    difference = np.abs(encode_hha(depth_m, camera, missing) - expected).max(axis=-1)
    assert np.mean(difference <= 1) >= 0.9999
