"""The noise of a depth image, told from the image: planes, roundings, and what is no noise."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep import Camera, estimate_normals
from nimprep.derive.noise import NO_NOISE, estimate_noise, noise_of_sigma
from nimprep.derive.window_noise import sigma_in_windows
from nimprep.kitti.calibration import read_calibration
from nimprep.kitti.depth import frame_depth
from nimprep.kitti.images import read_ground_truth
from nimprep.kitti.layout import list_road_files
from nimprep.readers import open_reader
from nimprep.synthetic.sensor import _correlated_noise
from tests.derive.test_normals import plane_depth, unit

CAMERA = Camera.from_fov(60, 320, 240)


def road():
    return plane_depth(unit((0.1, -1, -0.2)), 3.0, CAMERA)


def with_error(depth, error):
    inverse = 1 / np.where(depth > 0, depth, np.inf) + error
    return np.where(depth > 0, 1 / np.maximum(inverse, 1e-3), 0).astype(np.float32)


@pytest.mark.parametrize("sigma", [1e-4, 1e-3, 1e-2])
def test_independent_errors_of_inverse_depth_are_measured(sigma):
    error = np.random.default_rng(0).normal(0, sigma, CAMERA.shape)
    found = estimate_noise(with_error(road(), error))
    assert found.sigma == pytest.approx(sigma, rel=0.15)
    assert (found.power, found.length) == (0, 1)
    assert found.relative == pytest.approx(sigma * np.median(road()[road() > 0]), rel=0.25)


def test_errors_alike_over_a_matching_window_are_measured_with_their_length():
    # The window of a D415's matcher, 11 pixels of 1280, is 5.5 pixels here.
    camera = Camera.from_fov(69.4, 640, 480)
    error = 2e-3 * _correlated_noise(np.random.default_rng(1), camera)
    depth = plane_depth(unit((0.1, -1, -0.4)), 3.0, camera)
    found = estimate_noise(with_error(depth, error))
    assert found.sigma == pytest.approx(2e-3, rel=0.2)
    assert found.power == 0
    assert 4 < found.length < 8


def test_rounding_of_depth_is_told_by_its_growth_with_inverse_depth():
    depth = np.round(road() * 100) / np.float32(100)
    found = estimate_noise(depth)
    assert found.power == 2
    assert found.sigma == pytest.approx(0.01 / np.sqrt(12), rel=0.4)


def test_planes_have_no_noise_but_rounding_of_floats():
    found = estimate_noise(road())
    assert found.relative < 1e-6
    assert estimate_noise(road(), least=1e-6) == NO_NOISE


def test_curved_surfaces_are_no_noise():
    v, u = np.mgrid[:240, :320]
    depth = (4 + np.sin(u / 40) + np.cos(v / 50)).astype(np.float32)
    assert estimate_noise(depth) == NO_NOISE


def test_clutter_is_no_noise():
    v, u = np.mgrid[:240, :320]
    jumps = np.random.default_rng(0).uniform(2, 5, (30, 30))[v // 11, u // 11]
    depth = (jumps + 0.1 * np.sin(u / 7)).astype(np.float32)
    assert estimate_noise(depth) == NO_NOISE


def test_ground_whose_steps_grow_with_the_lag_is_no_noise():
    frequency = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256))
    frequency[0, 0] = np.inf
    # Second differences grow 2.8 times an octave. Rougher surfaces cannot be told from the errors
    # of a stereo camera, which grow 1.4 to 2 times.
    spectrum = np.fft.fft2(np.random.default_rng(0).normal(size=(256, 256))) / frequency**2.5
    ground = np.real(np.fft.ifft2(spectrum))
    depth = (5 + 0.1 * ground / ground.std()).astype(np.float32)
    assert estimate_noise(depth) == NO_NOISE


@pytest.mark.parametrize("depth", [np.zeros((50, 60)), np.ones((3, 4)), np.ones((1, 1))])
def test_images_with_nothing_to_measure_have_no_noise(depth):
    assert estimate_noise(depth.astype(np.float32)) == NO_NOISE


def test_noise_that_is_given_is_taken_and_its_length_measured():
    error = np.random.default_rng(0).normal(0, 1e-3, CAMERA.shape)
    depth = with_error(road(), error)
    found = noise_of_sigma(depth, 1e-3)
    assert (found.sigma, found.power, found.length) == (1e-3, 0, 1)
    assert noise_of_sigma(depth, 0) == NO_NOISE
    assert noise_of_sigma(np.zeros((50, 60), np.float32), 1e-3) == NO_NOISE


@pytest.mark.parametrize("sigma", [1e-4, 1e-3, 1e-2])
def test_windows_measure_errors_about_planes_between_trees_and_walls(sigma):
    rng = np.random.default_rng(0)
    depth = plane_depth(unit((0.1, -1, -0.4)), 1.5, Camera.from_fov(69.4, 640, 480))
    jumps = rng.uniform(2, 30, (60, 80))[:480, np.arange(640) // 8]
    depth = np.where(np.arange(480)[:, None] < 300, np.repeat(jumps, 8, axis=0), depth)
    noisy = with_error(depth, rng.normal(0, sigma, depth.shape))
    # 1.4 times what the flattest fifth leaves, which is a little less than all of it.
    assert sigma_in_windows(noisy) == pytest.approx(1.4 * sigma, rel=0.06)


def road_angle(depth_m, camera, road, **how):
    """Return the median angle, degrees, of a road's normals to their median."""
    normals = estimate_normals(depth_m, camera, **how)[road & (depth_m > 0)]
    middle = np.median(normals, axis=0)
    cosines = np.clip(normals @ middle / np.linalg.norm(middle), -1, 1)
    return np.degrees(np.median(np.arccos(cosines)))


def test_real_stereo_has_noise_and_its_roads_become_planes(reference_data):
    frames = [
        files
        for files in list_road_files(reference_data / "kitti_road")
        if files.split == "training" and files.right_image.is_file()
    ]
    assert len(frames) == 3
    for files in frames:
        depth = frame_depth(files, "stereo")
        found = estimate_noise(depth)
        assert 8e-4 < found.sigma < 1.3e-3
        truth = read_ground_truth(files.ground_truth("road"))
        camera = read_calibration(files.calibration).camera(*depth.shape)
        road = truth.evaluated & truth.positive
        assert road_angle(depth, camera, road) > 9
        assert road_angle(depth, camera, road, method="nim-edge") < 1.5


def test_windows_find_the_noise_of_a_d415_too(reference_data):
    frame = open_reader(reference_data / "gmrp").read("000001")
    sigma = sigma_in_windows(frame.depth_m)
    assert 5e-3 < sigma < 7e-3
    how = {"method": "nim-edge", "noise": sigma}
    assert road_angle(frame.depth_m, frame.camera, frame.label == 1, **how) < 2


@pytest.mark.parametrize("name", ["android", "demo"])
def test_clean_curved_scenes_have_no_noise(reference_data, name):
    path = reference_data / "normals_3f2n" / name / "depth.bin"
    depth = np.fromfile(path, np.float32).reshape(480, 640)
    depth[depth == 1] = 0
    assert estimate_noise(depth) == NO_NOISE
