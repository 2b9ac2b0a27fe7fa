"""Edge-aware normals: planes, edges, spheres; then a slow twin; then scenes with exact normals."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nimprep import Camera, estimate_normals
from nimprep.derive import normals_edge
from nimprep.derive.normals_edge import Smoothing, choose_smoothing, depth_scale
from nimprep.errors import ArrayError
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.images import read_ground_truth
from nimprep.kitti.layout import list_road_files
from nimprep.synthetic import render_frame
from tests.derive.test_normals import (
    CAMERA,
    NORMALS,
    angle_deg,
    measured,
    plane_depth,
    rays,
    scene,
    unit,
    with_holes,
)
from tests.derive.test_normals_properties import METRES, SHAPES, big_scene, camera_of
from tests.naive import normals_edge as naive


def edge(depth, camera, **options):
    return estimate_normals(depth, camera, method="nim-edge", **options)


def noisy(depth, sigma, seed=0):
    """Return depth whose inverse has independent errors of a standard deviation, 1/m."""
    error = np.random.default_rng(seed).normal(0, sigma, depth.shape)
    inverse = 1 / np.where(depth > 0, depth, np.inf) + error
    return np.where(depth > 0, 1 / np.maximum(inverse, 1e-3), 0).astype(np.float32)


@pytest.mark.parametrize("noise", [None, 0.0], ids=["estimated", "none"])
@pytest.mark.parametrize("share", [0, 0.3], ids=["whole", "with holes"])
@pytest.mark.parametrize("normal", NORMALS.values(), ids=NORMALS)
def test_a_plane_gives_its_own_normal_up_to_borders_and_holes(normal, share, noise):
    normal = unit(normal)
    depth = with_holes(plane_depth(normal, 2.0, CAMERA), share)
    seen = np.pad(depth > 0, 1)
    along_u, along_v = seen[1:-1, :-2] | seen[1:-1, 2:], seen[:-2, 1:-1] | seen[2:, 1:-1]
    known = (depth > 0) & along_u & along_v
    error = angle_deg(edge(depth, CAMERA, noise=noise)[known], normal)
    # What rounding depth and its inverse to float32 allows; the differences between two pixels
    # have more of it than the second order's.
    assert error.max() < 0.01
    assert np.median(error) < 0.001
    assert known.sum() > 300


def test_a_plane_that_faces_the_camera_faces_it_exactly():
    depth = np.full(CAMERA.shape, 3.7, np.float32)
    found = edge(with_holes(depth, 0.2), CAMERA)
    assert np.array_equal(np.unique(found.reshape(-1, 3), axis=0), [(0, 0, -1), (0, 0, 0)])


@pytest.mark.parametrize("slope", [0, 0.7, -1.5], ids=["upright", "slanted", "flat"])
def test_two_planes_keep_their_normals_up_to_the_depth_edge_between_them(slope):
    near, far = unit((0.3, -0.5, -1)), unit((-0.6, 0.1, -1))
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    left = u + slope * (v - 24) < 32
    depth = np.where(left, plane_depth(near, 2.0, CAMERA), plane_depth(far, 5.0, CAMERA))
    exact = np.where(left[..., None], near, far)
    error = angle_deg(edge(depth, CAMERA), exact)
    nim = angle_deg(estimate_normals(depth, CAMERA), exact)
    kernel = np.ones((3, 3), np.uint8)
    beside = cv2.dilate(left.astype(np.uint8), kernel) != cv2.erode(left.astype(np.uint8), kernel)
    # A pixel in a corner between the edge and the image's border may have no neighbour to go by.
    beside[[0, -1]] = beside[:, [0, -1]] = False
    assert error[beside].max() < 0.05
    assert nim[beside].max() > 10


def test_a_crease_and_a_strip_two_pixels_wide_keep_their_normals():
    road, wall = unit((0, -1, -0.1)), unit((1, 0, -0.2))
    ground, side = plane_depth(road, 1.0, CAMERA), plane_depth(wall, 1.5, CAMERA)
    depth = np.where((side > 0) & ((ground == 0) | (side < ground)), side, ground)
    exact = np.where((depth == side)[..., None], wall, road)
    error = angle_deg(edge(depth, CAMERA), exact)[depth > 0]
    assert np.percentile(error, 99) < 0.05
    strip = plane_depth(unit((0.4, -0.2, -1)), 6.0, CAMERA)
    strip[:, 30:32] = plane_depth(unit((-0.2, 0.3, -1)), 2.0, CAMERA)[:, 30:32]
    found = edge(strip, CAMERA)[:, 30:32]
    # Along the strip's width there is but one difference to go by.
    assert angle_deg(found, unit((-0.2, 0.3, -1))).max() < 1.5


def sphere(camera):
    """Return depth and exact normals of a sphere, and how far within its rim pixels are."""
    direction, centre, radius = rays(camera), np.array([0.1, -0.2, 4.0]), 1.5
    a, b = np.sum(direction**2, axis=-1), direction @ centre
    root = b**2 - a * (centre @ centre - radius**2)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0).astype(np.float32)
    return depth, (direction * depth[..., None] - centre) / radius, root / root.max()


def test_a_sphere_gives_its_radii():
    camera = Camera.from_fov(60, 256, 256)
    depth, exact, within = sphere(camera)
    error = angle_deg(edge(depth, camera), exact)
    assert np.median(error[within > 0.05]) < 0.02
    assert error[within > 0.05].max() < 0.3
    assert error[depth > 0].mean() < 0.25


def test_a_noisy_sphere_is_smoothed_and_stays_round():
    camera = Camera.from_fov(60, 256, 256)
    depth, exact, within = sphere(camera)
    depth = noisy(depth, 1e-4)
    own, nim = (
        angle_deg(estimate_normals(depth, camera, method=method), exact)[within > 0.2].mean()
        for method in ("nim-edge", "nim")
    )
    assert own < 2 < nim / 3


@pytest.mark.parametrize("scale", [1e-3, 1.0, 30.0])
@pytest.mark.parametrize("share", [0, 0.25, 0.8], ids=["whole", "holes", "mostly holes"])
@pytest.mark.parametrize("sigma", [0, 1e-3, 0.1], ids=["clean", "cells of 8", "cells of 16"])
def test_any_depth_gives_what_the_slow_twin_gives(sigma, share, scale):
    depth = with_holes(noisy(scene(), sigma / 10) * np.float32(scale), share)
    found = edge(depth, CAMERA, noise=sigma / scale)
    multiple = depth_scale(depth)
    smoothing = choose_smoothing(depth, CAMERA, sigma / scale, float(multiple))
    if share < 0.5:
        assert smoothing.side == {0: 0, 1e-3: 8, 0.1: 16}[sigma]
    expected = naive.estimate_normals(depth, CAMERA, multiple, smoothing)
    error = angle_deg(found, expected)[measured(depth)]
    # float32 against float64; cells pass through three sums and two fits.
    assert error.max() < 0.05
    assert np.percentile(error, 99) < 0.002


@pytest.mark.parametrize("share", [0, 0.25], ids=["whole", "holes"])
@pytest.mark.parametrize("apart", [1e-3, 0.3, 1e3], ids=["quarters", "some", "cells"])
def test_quarters_of_cells_give_what_the_slow_twin_gives(apart, share, monkeypatch):
    depth = with_holes(noisy(scene(), 0.01), share)
    multiple = depth_scale(depth)
    smoothing = Smoothing(16, (0.01 / float(multiple)) ** 2, 0.0, 0.1, apart)
    monkeypatch.setattr(normals_edge, "choose_smoothing", lambda *_: smoothing)
    expected = naive.estimate_normals(depth, CAMERA, multiple, smoothing)
    error = angle_deg(edge(depth, CAMERA), expected)[measured(depth)]
    assert error.max() < 0.05
    assert np.percentile(error, 99) < 0.002
    whole = replace(smoothing, apart=0.0)
    others = angle_deg(naive.estimate_normals(depth, CAMERA, multiple, whole), expected)
    assert (np.median(others[measured(depth)]) > 0.2) == (apart < 1)


def test_noise_that_grows_with_inverse_depth_gives_what_the_slow_twin_gives():
    exact = plane_depth(unit((0.2, -1, -0.3)), 2.0, CAMERA)
    exact[10:20, 30:45] = plane_depth(unit((0.5, 0, -1)), 2.0, CAMERA)[10:20, 30:45]
    depth = with_holes((np.round(exact * 300) / 300).astype(np.float32), 0.1)
    multiple = depth_scale(depth)
    smoothing = choose_smoothing(depth, CAMERA, None, float(multiple))
    assert (smoothing.side, smoothing.variance) == (8, 0)
    assert smoothing.quartic > 0
    expected = naive.estimate_normals(depth, CAMERA, multiple, smoothing)
    assert angle_deg(edge(depth, CAMERA), expected)[measured(depth)].max() < 0.05


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (1, 50), (2, 1), (50, 1), (2, 2), (3, 17)])
@pytest.mark.parametrize("share", [0, 0.3, 1], ids=["whole", "holes", "nothing"])
@pytest.mark.parametrize("sigma", [0, 0.02])
def test_thin_images_give_what_the_slow_twin_gives(shape, share, sigma):
    camera = Camera(fx=40, fy=50, cx=shape[1] / 3, cy=shape[0] / 4, width=shape[1], height=shape[0])
    rng = np.random.default_rng(2)
    depth = with_holes(rng.uniform(1, 2, shape).astype(np.float32), share)
    multiple = depth_scale(depth)
    smoothing = choose_smoothing(depth, camera, sigma, float(multiple))
    expected = naive.estimate_normals(depth, camera, multiple, smoothing)
    np.testing.assert_allclose(edge(depth, camera, noise=sigma), expected, atol=1e-4)


@pytest.mark.parametrize("noise", [None, 0.0, 0.02])
def test_a_pixel_alone_has_no_normal_even_where_cells_have_planes(noise):
    depth = plane_depth(unit((0.2, -0.5, -1)), 2.0, CAMERA)
    # Lone pixels in a field that is dense around it, each without any of its four neighbours.
    for v, u in ((20, 30), (24, 34)):
        depth[v, u - 1] = depth[v, u + 1] = depth[v - 1, u] = depth[v + 1, u] = 0
    found = edge(depth, CAMERA, noise=noise)
    assert np.array_equal(found.any(axis=-1), measured(depth))
    assert depth[20, 30] > 0
    assert not found[20, 30].any()


@pytest.mark.parametrize("beside", [(0, 1), (2, 1), (1, 0), (1, 2)])
def test_one_neighbour_as_far_is_a_difference_that_was_measured(beside):
    depth = np.zeros((3, 3), np.float32)
    depth[1, 1] = depth[beside] = 2
    found = edge(depth, Camera(fx=1, fy=1, cx=1, cy=1, width=3, height=3))
    assert np.array_equal(found[1, 1], (0, 0, -1))
    assert np.count_nonzero(found) == 2


def test_a_row_alone_has_the_slope_along_itself():
    whole = plane_depth(unit((0.5, 0, -1)), 2.0, CAMERA)
    depth = np.zeros_like(whole)
    depth[20] = whole[20]
    assert angle_deg(edge(depth, CAMERA)[20], unit((0.5, 0, -1))).max() < 0.01


@settings(max_examples=60)
@given(hnp.arrays(np.float32, SHAPES, elements=METRES), st.sampled_from([None, 0.0, 0.01, 10.0]))
def test_normals_are_unit_where_depth_is_and_look_at_the_camera(depth, noise):
    camera = camera_of(depth)
    found = edge(depth, camera, noise=noise)
    length = np.linalg.norm(found.astype(np.float64), axis=-1)
    some = measured(depth)
    assert np.all(found[~some] == 0)
    assert np.all(np.abs(length[some] - 1) < 1e-6)
    assert np.all(np.sum(found * rays(camera), axis=-1) < 1e-6)


@settings(max_examples=60)
@given(
    hnp.arrays(
        np.float32, SHAPES, elements=st.floats(0, width=32, allow_infinity=False, allow_nan=False)
    ),
    st.sampled_from([None, 0.0, 1e-20, 0.01, 1e20]),
)
def test_even_absurd_depths_give_unit_vectors(depth, noise):
    length = np.linalg.norm(edge(depth, camera_of(depth), noise=noise).astype(np.float64), axis=-1)
    assert np.array_equal(np.round(length, 5), measured(depth >= 1e-4).astype(np.float64))


@pytest.mark.parametrize("sigma", [0, 1e-3])
@pytest.mark.parametrize("exponent", [-14, -10, 1, 30])
def test_a_scene_any_times_as_large_has_the_same_normals(exponent, sigma):
    depth = noisy(big_scene(), sigma)
    camera = camera_of(depth)
    scaled = edge(depth * np.float32(2.0**exponent), camera)
    assert np.array_equal(edge(depth, camera), scaled)


@pytest.mark.parametrize("sigma", [0, 1e-3, 0.02])
@pytest.mark.parametrize("num_threads", [2, 3, None])
def test_any_number_of_threads_gives_the_same_bits(num_threads, sigma):
    depth = noisy(big_scene(), sigma)
    camera = camera_of(depth)
    alone = edge(depth, camera, noise=sigma, num_threads=1)
    assert np.array_equal(alone, edge(depth, camera, noise=sigma, num_threads=num_threads))


def test_nan_is_no_depth_and_the_input_stays_as_it_is():
    depth = big_scene().astype(np.float64)
    camera = camera_of(depth)
    with_nan = np.where(depth == 0, np.nan, depth)
    before = with_nan.copy()
    assert np.array_equal(edge(with_nan, camera), edge(depth, camera))
    assert np.array_equal(with_nan, before, equal_nan=True)


def test_out_is_written_and_returned():
    depth = big_scene()
    out = np.full((*depth.shape, 3), np.nan, np.float32)
    assert edge(depth, camera_of(depth), out=out) is out
    assert np.array_equal(out, edge(depth, camera_of(depth)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "nim-edge", "sign_filter": True}, r"^sign_filter: expected False .*nim-edge"),
        ({"method": "nim", "noise": 0.01}, r"^noise: expected None with 'nim', found 0.01"),
        ({"method": "nim-edge", "noise": -1.0}, r"^noise: expected .* >= 0, 1/m, found -1.0"),
        ({"method": "nim-edge", "noise": np.nan}, r"^noise: expected a finite .*, found nan"),
    ],
)
def test_options_of_the_other_method_and_impossible_noise_are_refused(options, message):
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ArrayError, match=message):
        estimate_normals(depth, camera_of(depth), **options)


@pytest.mark.parametrize(("name", "most"), [("android", 0.70), ("demo", 0.45)])
def test_scenes_with_exact_normals_agree(reference_data, name, most):
    folder = reference_data / "normals_3f2n" / name
    depth = np.fromfile(folder / "depth.bin", np.float32).reshape(480, 640)
    depth[depth == 1] = 0
    fx, fy, cx, cy, _ = map(float, (folder / "params.txt").read_text().split())
    raw = cv2.imread(str(folder / "normal.png"), cv2.IMREAD_UNCHANGED)
    exact = 1 - raw[..., ::-1] / 32767.5
    found = edge(depth, Camera(fx, fy, cx - 1, cy - 1, 640, 480))
    assert angle_deg(found, exact)[depth > 0].mean() < most


@pytest.fixture(scope="module")
def street():
    camera = Camera.from_fov(69.4, 640, 480)
    return render_frame(7, 1, camera), camera


def mean_errors(depth, exact, camera, **options):
    """Return nim-edge's and nim's mean error over the pixels with depth, degrees."""
    some = depth > 0
    found = edge(depth, camera, **options), estimate_normals(depth, camera)
    return tuple(float(angle_deg(normal, exact)[some].mean()) for normal in found)


def test_a_clean_street_is_all_but_exact(street):
    frame, camera = street
    own, nim = mean_errors(frame.depth_exact_m, frame.normal, camera)
    assert own < 0.02 < 0.5 < nim


def test_a_stereo_cameras_noise_and_holes_leave_a_fifth_of_nims_error(street):
    frame, camera = street
    depth = np.where(frame.depth_exact_m > 0, frame.depth_m, np.float32(0))
    assert np.mean(depth == 0) > 0.05
    own, nim = mean_errors(depth, frame.normal, camera)
    assert own < 6.5 < nim / 5


def test_independent_noise_and_holes_leave_a_twentieth_of_nims_error(street):
    frame, camera = street
    sigma = 0.1 / (camera.fx * 0.11)
    depth = with_holes(noisy(frame.depth_exact_m, sigma), 0.1)
    own, nim = mean_errors(depth, frame.normal, camera)
    given, _ = mean_errors(depth, frame.normal, camera, noise=sigma)
    assert own < 3 < nim / 20
    assert abs(given - own) < 0.3


def test_depth_in_millimetres_leaves_a_tenth_of_nims_error(street):
    frame, camera = street
    depth = np.round(frame.depth_exact_m * 1000) / np.float32(1000)
    own, nim = mean_errors(depth, frame.normal, camera)
    assert own < 0.15 < nim / 10


def road_auc(normals, road, other):
    """Return how well the angle to the road's median normal tells road from the rest."""
    middle = np.median(normals[road], axis=0)
    of_road, of_other = (angle_deg(normals[some], middle) for some in (road, other))
    ranked = np.sort(of_road)
    below, up_to = (np.searchsorted(ranked, of_other, side) for side in ("left", "right"))
    return (below + up_to).sum() / (2 * of_road.size * of_other.size), np.median(of_road)


@pytest.mark.parametrize(
    ("name", "least", "most"),
    [("um_000000", 0.96, 0.6), ("umm_000000", 0.955, 0.65), ("uu_000000", 0.93, 1.45)],
)
def test_real_stereo_tells_road_from_what_is_beside_it(reference_data, name, least, most):
    root = reference_data / "kitti_road"
    files = next(f for f in list_road_files(root) if (f.split, f.name) == ("training", name))
    depth, truth = frame_depth(files, "stereo"), read_ground_truth(files.ground_truth("road"))
    camera = read_calibration(files.calibration).camera(*depth.shape)
    found = edge(depth, camera)
    known = truth.evaluated & found.any(axis=-1)
    auc, angle = road_auc(found, known & truth.positive, known & ~truth.positive)
    assert auc > least
    assert angle < most


def test_a_ditch_in_a_road_keeps_slopes_that_cells_would_level(monkeypatch):
    v, u = np.mgrid[:320, :480]
    slope = np.where((v > 150) & (v < 190) & (u > 120) & (u < 360), -5e-4, 1e-3)
    inverse = 0.02 + np.cumsum(slope, axis=0)
    error = cv2.GaussianBlur(np.random.default_rng(4).normal(0, 1, v.shape), (0, 0), 2.5)
    depth = (1 / (inverse + 6e-4 * error / error.std())).astype(np.float32)
    camera = Camera.from_fov(60, 480, 320)
    y = np.arange(320)[:, None] - camera.cy
    exact = np.stack([0 * slope, -camera.fy * slope, slope * y - inverse], axis=-1)
    scaled = (6e-4 / float(depth_scale(depth))) ** 2
    # Errors of such a blur are alike over 3.5 times its width: 2 sqrt(pi).
    smoothing = Smoothing(16, scaled, 0.0, (8.9 / 16) ** 2, (8.9 / 8) ** 2)
    found = []
    for one in (smoothing, replace(smoothing, apart=0.0)):
        monkeypatch.setattr(normals_edge, "choose_smoothing", lambda *_, one=one: one)
        found.append(angle_deg(edge(depth, camera), exact))
    ditch, road = np.s_[160:180, 140:340], np.s_[220:300, 20:460]
    own, cells = (np.median(error[ditch]) for error in found)
    assert own < 0.65 * cells
    own, cells = (np.median(error[road]) for error in found)
    assert own < 1.4 * cells
