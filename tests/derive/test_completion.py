"""Filling holes: analytic surfaces, the plain twins, what cannot be filled."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from nimprep.derive.completion import FILL_METHODS, fill_depth
from nimprep.errors import ArrayError, NimprepError
from nimprep.kernels.completion_delaunay import triangulate
from tests.naive import completion as naive

SHAPE = (40, 56)


def with_holes(depth: np.ndarray, share: float, seed: int = 0) -> np.ndarray:
    """Return depth as float32 with this share of the pixels set to 0."""
    holes = np.random.default_rng(seed).random(depth.shape) < share
    return np.where(holes, 0, depth).astype(np.float32)


def slope(shape: tuple[int, int] = SHAPE) -> np.ndarray:
    v, u = np.indices(shape)
    return 3 + 0.02 * v + 0.03 * u


def picture(shape: tuple[int, int] = SHAPE, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def fill(depth: np.ndarray, method: str, **options):
    rgb = picture(depth.shape) if method == "colorization" else None
    return fill_depth(depth, method, **{"rgb": rgb, **options})


@pytest.mark.parametrize("method", FILL_METHODS)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.9])
def test_known_depth_stays_and_the_mask_is_what_was_filled(method: str, share: float) -> None:
    depth = with_holes(slope(), share)
    before = depth.copy()
    filled, mask = fill(depth, method)
    np.testing.assert_array_equal(depth, before)
    assert filled.dtype == np.float32
    assert mask.dtype == np.bool_
    np.testing.assert_array_equal(filled[before > 0], before[before > 0])
    np.testing.assert_array_equal(mask, (before == 0) & (filled > 0))
    assert method == "linear" or (filled > 0).all()


@pytest.mark.parametrize("method", FILL_METHODS)
def test_a_constant_stays_constant(method: str) -> None:
    filled, _ = fill(with_holes(np.full(SHAPE, 4.0), 0.6), method)
    np.testing.assert_allclose(filled[filled > 0], 4.0, rtol=1e-6)


@pytest.mark.parametrize("share", [0.05, 0.6, 0.97])
def test_linear_gives_a_slope_back_inside_the_hull(share: float) -> None:
    depth = with_holes(slope(), share)
    depth[[0, 0, -1, -1], [0, -1, 0, -1]] = slope()[[0, 0, -1, -1], [0, -1, 0, -1]]
    filled, _ = fill_depth(depth, "linear")
    np.testing.assert_allclose(filled, slope(), rtol=1e-6)


def test_linear_leaves_what_lies_outside_the_hull() -> None:
    depth = np.zeros((9, 9), np.float32)
    depth[1, 4], depth[7, 1], depth[7, 7] = 1.0, 2.0, 3.0
    filled, mask = fill_depth(depth, "linear")
    v, u = np.indices(depth.shape)
    inside = (v >= 1) & (v <= 7) & (2 * np.abs(u - 4) <= v - 1)
    np.testing.assert_array_equal(filled > 0, inside)
    np.testing.assert_array_equal(mask, inside & (depth == 0))
    assert filled[7, 4] == 2.5


@pytest.mark.parametrize("points", [[(2, 3)], [(2, 3), (5, 3)], [(1, 1), (3, 2), (5, 3), (7, 4)]])
def test_points_on_one_line_span_no_triangle(points: list[tuple[int, int]]) -> None:
    depth = np.zeros((9, 9), np.float32)
    depth[tuple(zip(*points, strict=True))] = 2.0
    filled, mask = fill_depth(depth, "linear")
    np.testing.assert_array_equal(filled, depth)
    assert not mask.any()


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("seed", range(3))
def test_nearest_agrees_with_the_plain_twin(share: float, seed: int) -> None:
    depth = with_holes(np.random.default_rng(seed).uniform(1, 9, (17, 23)), share, seed)
    np.testing.assert_array_equal(fill_depth(depth, "nearest")[0], naive.fill_nearest(depth))


@pytest.mark.parametrize("count", [3, 4, 6, 12, 30, 50, 61])
@pytest.mark.parametrize("seed", range(3))
def test_linear_agrees_with_the_plain_twin(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = np.zeros(64, np.float32)
    depth[rng.choice(64, count, replace=False)] = rng.uniform(1, 9, count)
    depth = depth.reshape(8, 8)
    filled, mask = fill_depth(depth, "linear")
    values = naive.linear_values(depth)
    assert {tuple(p) for p in np.argwhere(mask)} == set(values)
    for pixel, admitted in values.items():
        assert np.abs(filled[pixel] / np.array(admitted) - 1).min() < 1e-6


@pytest.mark.parametrize("shape", [(9, 11), (24, 31)])
def test_colorization_agrees_with_the_plain_twin(shape: tuple[int, int]) -> None:
    pytest.importorskip("scipy")
    rng = np.random.default_rng(1)
    depth = with_holes(rng.uniform(1, 5, shape), 0.4)
    rgb = rng.integers(0, 256, (*shape, 3), np.uint8)
    rgb[4:8, 3:9] = 90
    gray = rgb @ np.array([0.2989, 0.5870, 0.1140]) / 255
    expected = naive.fill_colorization(depth, gray)
    np.testing.assert_allclose(fill_depth(depth, "colorization", rgb)[0], expected, rtol=1e-6)


def test_colorization_needs_no_more_than_the_surroundings_of_a_hole() -> None:
    pytest.importorskip("scipy")
    rng = np.random.default_rng(2)
    depth = rng.uniform(1, 5, (36, 38)).astype(np.float32)
    depth[16:20, 17:22] = 0
    gray = rng.integers(0, 256, depth.shape, np.uint8)
    expected = naive.fill_colorization(depth, gray / 255)
    np.testing.assert_allclose(
        fill_depth(depth, "colorization", gray)[0], expected, atol=1e-5, rtol=0
    )


def test_colorization_follows_the_edges_of_the_picture() -> None:
    pytest.importorskip("scipy")
    left = np.indices(SHAPE)[1] < 25
    depth = np.where(left, 2.0, 5.0)
    rgb = np.where(left, 60, 190).astype(np.uint8)
    holes = np.zeros(SHAPE, bool)
    holes[3:37, 15:40] = True
    filled, _ = fill_depth(np.where(holes, 0, depth), "colorization", np.dstack([rgb] * 3))
    np.testing.assert_allclose(filled, depth, rtol=0.01)
    nearest, _ = fill_depth(np.where(holes, 0, depth), "nearest")
    assert (nearest != depth).any()


@pytest.mark.parametrize("count", [2, 3, 4, 7, 40, 41, 150])
@pytest.mark.parametrize("side", [2, 5, 13, 20_000])
def test_triangles_have_empty_circles_and_cover_the_hull(count: int, side: int) -> None:
    rng = np.random.default_rng(count)
    pixels = rng.choice(side * side, min(count, side * side), replace=False)
    points = np.stack(np.divmod(np.sort(pixels), side), axis=1)
    triangles = np.empty((2 * len(points), 3), np.int32)
    triangles = triangles[: triangulate(points, triangles)]
    area = 0
    for a, b, c in triangles:
        corners = points[a], points[b], points[c]
        assert naive.turn(*corners) > 0
        assert not naive.inside_circle(*corners, points).any()
        area += naive.turn(*corners)
    # Each edge inside belongs to two triangles; those with one are the hull, whose area is theirs.
    edges = [(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)]
    assert len(set(edges)) == len(edges)
    hull = [edge for edge in edges if edge[::-1] not in set(edges)]
    origin = points[0]
    assert area == sum(naive.turn(origin, points[a], points[b]) for a, b in hull)
    assert all((naive_turns(points, a, b) >= 0).all() for a, b in hull)


def naive_turns(points: np.ndarray, a: int, b: int) -> np.ndarray:
    (va, ua), (vb, ub) = points[a], points[b]
    return (vb - va) * (points[:, 1] - ua) - (ub - ua) * (points[:, 0] - va)


@pytest.mark.parametrize("method", FILL_METHODS)
def test_threads_do_not_change_a_bit(method: str) -> None:
    depth = with_holes(np.random.default_rng(3).uniform(1, 9, (70, 300)), 0.7)
    expected = fill(depth, method, num_threads=1)
    for threads in (2, None):
        for found, one in zip(fill(depth, method, num_threads=threads), expected, strict=True):
            np.testing.assert_array_equal(found, one)


@pytest.mark.parametrize("method", FILL_METHODS)
def test_an_image_without_holes_comes_back_as_a_copy(method: str) -> None:
    depth = slope().astype(np.float32)
    filled, mask = fill(depth, method)
    np.testing.assert_array_equal(filled, depth)
    assert not np.shares_memory(filled, depth)
    assert not mask.any()


@pytest.mark.parametrize("method", FILL_METHODS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1)])
def test_lines_of_pixels_are_filled_or_left(method: str, shape: tuple[int, int]) -> None:
    depth = np.zeros(shape)
    depth.flat[-1] = 2.0
    filled, _ = fill(depth, method)
    assert set(filled.ravel()) == ({0.0, 2.0} if method == "linear" and max(shape) > 1 else {2.0})


@pytest.mark.parametrize("method", FILL_METHODS)
def test_nothing_known_is_an_error(method: str) -> None:
    with pytest.raises(ArrayError, match="expected at least one pixel with depth"):
        fill(np.zeros(SHAPE), method)


def test_nan_is_a_hole_and_read_only_arrays_are_read() -> None:
    depth = with_holes(slope(), 0.3)
    expected, _ = fill_depth(depth, "linear")
    depth[depth == 0] = np.nan
    depth.flags.writeable = False
    np.testing.assert_array_equal(fill_depth(depth, "linear")[0], expected)


def test_an_image_too_long_for_the_triangulations_integers_is_refused() -> None:
    depth = np.ones((2, 920_000), np.float32)
    depth[0, 5] = 0
    with pytest.raises(ArrayError, match=r"smaller image for 'linear', found 920000x2"):
        fill_depth(depth, "linear")
    assert fill_depth(depth, "nearest")[0].all()


def test_an_unknown_method_is_named() -> None:
    with pytest.raises(ArrayError, match=r"expected one of nearest, linear.*found 'cubic'"):
        fill_depth(slope(), "cubic")


@pytest.mark.parametrize(
    "rgb", [None, picture((3, 3)), picture().astype(float), np.zeros((*SHAPE, 4), np.uint8)]
)
def test_colorization_refuses_what_is_no_picture(rgb: np.ndarray | None) -> None:
    with pytest.raises(ArrayError, match="rgb: expected"):
        fill_depth(with_holes(slope(), 0.3), "colorization", rgb)


def test_colorization_without_scipy_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    monkeypatch.setitem(sys.modules, "scipy.sparse.linalg", None)
    with pytest.raises(NimprepError, match="expected SciPy, found none; pip install"):
        fill_depth(with_holes(slope(), 0.3), "colorization", picture())
