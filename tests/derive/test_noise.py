"""The noise of a depth image, told from the image: planes, roundings, and what is no noise."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep import Camera
from nimprep.derive.noise import NO_NOISE, estimate_noise, noise_of_sigma
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


def test_rough_ground_whose_steps_grow_with_the_lag_is_no_noise():
    frequency = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.fftfreq(256))
    frequency[0, 0] = np.inf
    # A fractal surface of Hurst exponent 0.7: second differences grow 1.6 times an octave.
    spectrum = np.fft.fft2(np.random.default_rng(0).normal(size=(256, 256))) / frequency**1.7
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
