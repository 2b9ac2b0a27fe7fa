"""What windows leave of planes and quadrics, against least squares by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from nimprep.derive.window_noise import sigma_in_windows
from nimprep.kernels.inverse_depth_windows import fit_left, window_moments

HALF, STEP = 8, 2


def left_by_numpy(depth: np.ndarray, v0: int, u0: int, terms: int) -> float:
    """Return the standard deviation of 1 / depth that least squares leave."""
    y, x = np.mgrid[-HALF : HALF + 1 : STEP, -HALF : HALF + 1 : STEP]
    window = depth[v0 + y, u0 + x].astype(np.float64)
    some = window > 0
    x, y = x[some] / HALF, y[some] / HALF
    columns = np.stack([np.ones(x.size), x, y, x * x, x * y, y * y][:terms], axis=-1)
    inverse = 1 / window[some]
    rest = inverse - columns @ np.linalg.lstsq(columns, inverse, rcond=None)[0]
    return float(np.sqrt((rest**2).sum() / (x.size - terms)))


@pytest.mark.parametrize("terms", [3, 6], ids=["plane", "quadric"])
@pytest.mark.parametrize("share", [0, 0.4], ids=["whole", "holes"])
def test_what_is_left_is_what_least_squares_leave(terms: int, share: float) -> None:
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:40, :60]
    depth = (4 + np.sin(u / 9) + np.cos(v / 7) + rng.normal(0, 0.05, v.shape)).astype(np.float32)
    depth[rng.random(depth.shape) < share] = 0
    centres = np.array([(v, u) for v in (8, 20, 31) for u in (8, 30, 51)], np.int64)
    moments, sums, left = np.zeros((9, 2, 5, 5)), np.zeros((9, 2)), np.empty(9)
    window_moments(depth, centres, HALF, STEP, moments, sums)
    fit_left(moments, sums, terms, left)
    expected = [left_by_numpy(depth, *centre, terms) for centre in centres]
    np.testing.assert_allclose(left, expected, rtol=1e-8)


def test_pixels_in_one_line_leave_nothing_of_a_plane() -> None:
    depth = np.zeros((17, 17), np.float32)
    depth[8] = 1 / np.linspace(0.2, 0.5, 17)
    moments, sums, left = np.zeros((1, 2, 5, 5)), np.zeros((1, 2)), np.empty(1)
    window_moments(depth, np.array([[8, 8]]), HALF, STEP, moments, sums)
    fit_left(moments, sums, 3, left)
    assert left[0] < 1e-6


def test_a_noisy_plane_has_its_noise_and_an_image_without_windows_none() -> None:
    rng = np.random.default_rng(1)
    v, u = np.mgrid[:200, :300]
    inverse = 0.1 + 1e-3 * v + 2e-4 * u + rng.normal(0, 1e-3, v.shape)
    sigma = sigma_in_windows((1 / inverse).astype(np.float32))
    # 1.4 times what the flattest fifth of the windows leave.
    assert 1.2e-3 < sigma < 1.5e-3
    assert sigma_in_windows(np.zeros((200, 300), np.float32)) == 0
    assert sigma_in_windows(np.ones((30, 300), np.float32)) == 0
