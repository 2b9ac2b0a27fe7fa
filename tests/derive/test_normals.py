"""Normals: against planes and spheres, then a slow twin, then the authors' own program."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from nimprep import Camera, estimate_normals
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.layout import list_road_files
from tests.naive import normals as naive

CAMERA = Camera(fx=100.0, fy=120.0, cx=30.3, cy=21.6, width=64, height=48)


def rays(camera):
    """Return P / Z of every pixel, (H, W, 3)."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=-1)


def plane_depth(normal, distance, camera):
    """Return the depth of the plane n.P = -distance; 0 where the ray misses it."""
    towards = rays(camera) @ np.asarray(normal)
    return np.where(towards < -1e-2, -distance / np.minimum(towards, -1e-2), 0).astype(np.float32)


def unit(vector):
    return np.asarray(vector, dtype=np.float64) / np.linalg.norm(vector)


def angle_deg(a, b):
    """Return the angle between vectors along the last axis; exact for small ones too."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(across, np.sum(a * b, axis=-1)))


def with_holes(depth, share, seed=0):
    holes = np.random.default_rng(seed).random(depth.shape) < share
    return np.where(holes, np.float32(0), depth)


def measured(depth):
    """Return where depth is and beside it, above, below, left or right: there a normal is."""
    some = np.pad(depth > 0, 1)
    beside = some[1:-1, :-2] | some[1:-1, 2:] | some[:-2, 1:-1] | some[2:, 1:-1]
    return (depth > 0) & beside


def scene(seed=0, camera=CAMERA):
    """Return waves with jumps in depth, which are smooth nowhere near the jumps."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: camera.height, : camera.width]
    waves = 5 + np.sin(u / 7 + rng.random()) + np.cos(v / 5 + rng.random())
    return np.where((u // 11 + v // 9) % 3 == 0, waves / 2, waves).astype(np.float32)


NORMALS = {
    "road": (0, -1, 0),
    "left wall": (1, 0, -0.1),
    "right wall": (-1, 0, -0.05),
    "ramp": (0, -1, -0.4),
    "facing": (0.1, 0.05, -1),
    "oblique": (-0.5, -0.7, -0.6),
    "ceiling": (0.2, 0.9, -0.3),
}


@pytest.mark.parametrize("sign_filter", [False, True])
@pytest.mark.parametrize("share", [0, 0.3], ids=["whole", "with holes"])
@pytest.mark.parametrize("normal", NORMALS.values(), ids=NORMALS)
def test_a_plane_gives_its_own_normal_up_to_borders_and_holes(normal, share, sign_filter):
    normal = unit(normal)
    depth = with_holes(plane_depth(normal, 2.0, CAMERA), share)
    # A pixel with neighbours along one axis only knows the plane's slope along that axis only.
    seen = np.pad(depth > 0, 1)
    along_u, along_v = seen[1:-1, :-2] | seen[1:-1, 2:], seen[:-2, 1:-1] | seen[2:, 1:-1]
    known = (depth > 0) & along_u & along_v
    found = estimate_normals(depth, CAMERA, sign_filter=sign_filter)
    # What rounding depth to float32 allows, most for the plane that faces the camera.
    assert angle_deg(found[known], normal).max() < 0.002
    assert known.sum() > 300


def test_a_plane_that_faces_the_camera_has_no_gradient_and_faces_it_exactly():
    depth = np.full(CAMERA.shape, 3.7, np.float32)
    found = estimate_normals(with_holes(depth, 0.2), CAMERA)
    assert np.array_equal(np.unique(found.reshape(-1, 3), axis=0), [(0, 0, -1), (0, 0, 0)])


def test_a_sphere_gives_its_radii():
    camera = Camera.from_fov(60, 256, 256)
    direction, centre, radius = rays(camera), np.array([0.1, -0.2, 4.0]), 1.5
    a, b = np.sum(direction**2, axis=-1), direction @ centre
    root = b**2 - a * (centre @ centre - radius**2)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)
    exact = (direction * depth[..., None] - centre) / radius
    away_from_the_rim = root > 0.05 * root.max()
    error = angle_deg(estimate_normals(depth, camera), exact)[away_from_the_rim]
    # The rest lies where depth turns from falling to rising along a row or a column: there two
    # candidates of the method contradict each other.
    assert np.median(error) < 0.01
    assert np.percentile(error, 90) < 0.1


@pytest.mark.parametrize("scale", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("sign_filter", [False, True])
@pytest.mark.parametrize("share", [0, 0.25, 0.8], ids=["whole", "holes", "mostly holes"])
def test_any_depth_gives_what_the_slow_twin_gives(share, sign_filter, scale):
    depth = with_holes(scene() * np.float32(scale), share)
    found = estimate_normals(depth, CAMERA, sign_filter=sign_filter)
    expected = naive.estimate_normals(depth, CAMERA, sign_filter)
    assert angle_deg(found, expected).max() < 1e-4


@pytest.mark.parametrize("sign_filter", [False, True])
def test_unrelated_depths_give_what_the_slow_twin_gives(sign_filter):
    rng = np.random.default_rng(1)
    depth = with_holes(rng.uniform(0.3, 60, CAMERA.shape).astype(np.float32), 0.3)
    found = estimate_normals(depth, CAMERA, sign_filter=sign_filter)
    expected = naive.estimate_normals(depth, CAMERA, sign_filter)
    assert angle_deg(found, expected).max() < 1e-4


def test_millimetres_at_60_m_lose_nothing_to_rounding():
    camera = Camera.from_fov(69.4, 1280, 720).crop(600, 100, 40, 60)
    exact = plane_depth(unit((0.1, -1, -0.2)), 40.0, camera)
    depth = np.round(exact * 1000) / np.float32(1000)
    assert depth.min() > 30
    found = estimate_normals(depth, camera)
    # Differences of float32 reciprocals are off by 0.003 degrees here.
    assert angle_deg(found, naive.estimate_normals(depth, camera)).max() < 1e-3


def cross(left, right, up, down, camera):
    """Return 3x3 depth with the pixel (1, 1) at 1 m and these neighbours, no corners."""
    depth = np.array([[0, up, 0], [left, 1, right], [0, down, 0]], np.float32)
    return depth, camera


AXIS = Camera(fx=1, fy=1, cx=1, cy=1, width=3, height=3)


def test_without_the_sign_filter_both_sides_of_a_valley_count():
    # n_x = 1/3 - 1/2 < 0; n_z = -n_x 3/2 * ... along n_x: right (-1, 0, 3/2), left (-1, 0, -2).
    depth, camera = cross(2, 3, 0, 0, AXIS)
    total = unit((-1, 0, 1.5)) + unit((-1, 0, -2))
    assert total[2] < 0  # n.P <= 0 already, so it stays as it is
    np.testing.assert_allclose(estimate_normals(depth, camera)[1, 1], unit(total), atol=1e-6)


def test_with_the_sign_filter_a_tie_counts_as_positive():
    depth, camera = cross(2, 3, 0, 0, AXIS)
    found = estimate_normals(depth, camera, sign_filter=True)[1, 1]
    # The positive candidate (-1, 0, 3/2) points away from the camera and is turned.
    np.testing.assert_allclose(found, unit((1, 0, -1.5)), atol=1e-6)


def test_with_the_sign_filter_the_majority_wins():
    # From cx = -3 on the pixel's x is 4: n_z = -4 n_x +- n_x Z_i / dz_i is negative on both sides
    # of this slope but where the left neighbour is close enough in depth.
    depth, _ = cross(1.25, 3, 0, 0, AXIS)
    camera = Camera(fx=1, fy=1, cx=-3, cy=1, width=3, height=3)
    left, right = (candidate[2] for candidate in naive.candidates(depth, camera, 1, 1))
    assert (left < 0) != (right < 0)
    found = estimate_normals(depth, camera, sign_filter=True)
    np.testing.assert_allclose(found, naive.estimate_normals(depth, camera, True), atol=1e-6)


def test_with_the_sign_filter_level_ground_keeps_its_normal():
    # Y = y Z is 1 * 2 and 2 * 1: the lower pixel's one candidate has n_z = 0 exactly.
    depth = np.array([[2], [1]], np.float32)
    camera = Camera(fx=1, fy=1, cx=0, cy=-1, width=1, height=2)
    found = estimate_normals(depth, camera, sign_filter=True)
    np.testing.assert_allclose(found[1, 0], (0, -1, 0), atol=1e-6)


@pytest.mark.parametrize("sign_filter", [False, True])
def test_a_pixel_alone_has_no_normal(sign_filter):
    depth = np.zeros((3, 3), np.float32)
    depth[1, 1] = 2
    depth[0, 0] = 2  # across a corner: no difference along an axis
    assert not estimate_normals(depth, AXIS, sign_filter=sign_filter).any()


@pytest.mark.parametrize("sign_filter", [False, True])
@pytest.mark.parametrize("beside", [(0, 1), (2, 1), (1, 0), (1, 2)])
def test_one_neighbour_as_far_is_a_difference_that_was_measured(beside, sign_filter):
    depth = np.zeros((3, 3), np.float32)
    depth[1, 1] = depth[beside] = 2
    found = estimate_normals(depth, AXIS, sign_filter=sign_filter)
    assert np.array_equal(found[1, 1], (0, 0, -1))
    assert np.array_equal(found[beside], (0, 0, -1))
    assert np.count_nonzero(found) == 2


@pytest.mark.parametrize("method", ["nim", "nim-edge"])
def test_lidar_as_it_was_measured_has_normals_where_points_lie_side_by_side(reference_data, method):
    (files,) = list_road_files(reference_data / "kitti_lidar")
    depth = frame_depth(files, "lidar", sparse=True)
    camera = read_calibration(files.calibration).camera(*depth.shape)
    found = estimate_normals(depth, camera, method)
    assert np.array_equal(found.any(axis=-1), measured(depth))
    # Of 4.5 % with depth five sixths are alone: all of those faced the camera.
    assert 0.16 < np.mean(found[depth > 0].any(axis=-1)) < 0.17
    assert np.mean((found[depth > 0] == (0, 0, -1)).all(axis=-1)) < 0.003


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (1, 50), (2, 1), (50, 1), (2, 2), (3, 17)])
@pytest.mark.parametrize("share", [0, 0.3, 1], ids=["whole", "holes", "nothing"])
def test_thin_images_give_what_the_slow_twin_gives(shape, share):
    camera = Camera(fx=40, fy=50, cx=shape[1] / 3, cy=shape[0] / 4, width=shape[1], height=shape[0])
    rng = np.random.default_rng(2)
    depth = with_holes(rng.uniform(1, 2, shape).astype(np.float32), share)
    found = estimate_normals(depth, camera)
    assert found.shape == (*shape, 3)
    np.testing.assert_allclose(found, naive.estimate_normals(depth, camera), atol=1e-6)


def kitti_frame(reference_data):
    """Return the depth and the camera that the authors' program was run on."""
    road = reference_data / "kitti_road" / "training"
    raw = cv2.imread(str(road / "depth_u16" / "uu_000000.png"), cv2.IMREAD_UNCHANGED)
    lines = (road / "calib" / "uu_000000.txt").read_text().splitlines()
    (p2,) = (line.split()[1:] for line in lines if line.startswith("P2:"))
    matrix = np.array(p2, dtype=np.float64).reshape(3, 4)[:, :3]
    height, width = raw.shape
    return raw / np.float32(1000), Camera.from_matrix(matrix, width, height)


@pytest.mark.parametrize(("name", "sign_filter"), [("plain", False), ("sign_filter", True)])
def test_the_authors_own_program_agrees(reference_data, name, sign_filter):
    depth, camera = kitti_frame(reference_data)
    with np.load(reference_data / "nim_golden" / "uu_000000.npz") as stored:
        golden = stored[name].astype(np.float64)
    seen = np.pad(depth > 0, 1)
    around = seen[1:-1, :-2] & seen[1:-1, 2:] & seen[:-2, 1:-1] & seen[2:, 1:-1]
    # That program sets Z to 0 where Y <= 0: the row above must lie below the horizon too.
    below = np.arange(camera.height)[:, None] - 1 > camera.cy
    comparable = (depth > 0) & around & below
    assert comparable.sum() > 200_000
    found = estimate_normals(depth, camera, sign_filter=sign_filter)
    error = angle_deg(found, golden)[comparable]
    error = np.minimum(error, 180 - error)  # its signs are free
    median, high = np.percentile(error, [50, 99])
    assert median <= 0.005
    assert high <= 0.02


@pytest.mark.parametrize(("name", "most"), [("android", 0.65), ("demo", 0.42)])
def test_scenes_with_exact_normals_agree(reference_data, name, most):
    folder = reference_data / "normals_3f2n" / name
    depth = np.fromfile(folder / "depth.bin", np.float32).reshape(480, 640)
    depth[depth == 1] = 0
    fx, fy, cx, cy, _ = map(float, (folder / "params.txt").read_text().split())
    raw = cv2.imread(str(folder / "normal.png"), cv2.IMREAD_UNCHANGED)
    exact = 1 - raw[..., ::-1] / 32767.5
    found = estimate_normals(depth, Camera(fx, fy, cx - 1, cy - 1, 640, 480))
    assert np.median(angle_deg(found, exact)[depth > 0]) < most
