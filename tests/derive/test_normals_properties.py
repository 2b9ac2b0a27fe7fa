"""Normals: what holds for every depth image, and how the function takes its arguments."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from nimprep import Camera, estimate_normals
from nimprep.errors import ArrayError
from tests.derive.test_normals import measured
from tests.processes import PATIENCE_S

METRES = st.one_of(
    st.just(0.0),
    st.integers(1, 65534).map(lambda mm: float(np.float32(mm) / np.float32(1000))),
    st.floats(2**-10, 128, width=32),
    st.sampled_from([1.0, 1.0 + 2**-23, 1.0 - 2**-24]),
)
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=40)


def camera_of(depth):
    height, width = depth.shape
    return Camera(fx=500, fy=400, cx=width / 3, cy=height / 4, width=width, height=height)


def rays(camera):
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=-1)


def big_scene():
    """Return an image of several blocks, so that threads have something to share."""
    v, u = np.mgrid[:300, :400]
    depth = (5 + np.sin(u / 17) + np.cos(v / 13)).astype(np.float32)
    depth[np.random.default_rng(3).random(depth.shape) < 0.2] = 0
    return depth


@settings(max_examples=100)
@given(hnp.arrays(np.float32, SHAPES, elements=METRES), st.booleans())
def test_normals_are_unit_where_depth_is_and_look_at_the_camera(depth, sign_filter):
    camera = camera_of(depth)
    found = estimate_normals(depth, camera, sign_filter=sign_filter)
    assert found.shape == (*depth.shape, 3)
    assert found.dtype == np.float32
    length = np.linalg.norm(found.astype(np.float64), axis=-1)
    some = measured(depth)
    assert np.all(found[~some] == 0)
    assert np.all(np.abs(length[some] - 1) < 1e-6)
    assert np.all(np.sum(found * rays(camera), axis=-1) < 1e-6)


@settings(max_examples=50)
@given(
    hnp.arrays(
        np.float32, SHAPES, elements=st.floats(0, width=32, allow_infinity=False, allow_nan=False)
    ),
    st.booleans(),
)
def test_even_absurd_depths_give_unit_vectors(depth, sign_filter):
    found = estimate_normals(depth, camera_of(depth), sign_filter=sign_filter)
    length = np.linalg.norm(found.astype(np.float64), axis=-1)
    assert np.array_equal(np.round(length, 5), measured(depth >= 1e-4).astype(np.float64))


@pytest.mark.parametrize("sign_filter", [False, True])
@pytest.mark.parametrize("exponent", [-14, -10, 1, 30])
def test_a_scene_any_times_as_large_has_the_same_normals(exponent, sign_filter):
    depth = big_scene()
    camera = camera_of(depth)
    found = estimate_normals(depth, camera, sign_filter=sign_filter)
    scaled = estimate_normals(depth * np.float32(2.0**exponent), camera, sign_filter=sign_filter)
    assert np.array_equal(found, scaled)


@pytest.mark.parametrize("width", [1, 7, 16, 31, 33, 100])
def test_a_pixel_has_the_same_normal_wherever_the_row_ends(width):
    depth = big_scene()
    whole = estimate_normals(depth, camera_of(depth))
    camera = camera_of(depth).crop(0, 0, 300, width)
    part = estimate_normals(depth[:, :width], camera)
    # Not the same bits: the last few pixels of a row are left over when it goes by sixteens.
    np.testing.assert_allclose(part[:, : width - 1], whole[:, : width - 1], rtol=0, atol=1e-6)


@pytest.mark.parametrize("sign_filter", [False, True])
@pytest.mark.parametrize("num_threads", [2, 3, None])
def test_any_number_of_threads_gives_the_same_bits(num_threads, sign_filter):
    depth = big_scene()
    camera = camera_of(depth)
    alone = estimate_normals(depth, camera, sign_filter=sign_filter, num_threads=1)
    shared = estimate_normals(depth, camera, sign_filter=sign_filter, num_threads=num_threads)
    assert np.array_equal(alone, shared)


def test_many_threads_may_call_at_once():
    depth = big_scene()
    camera = camera_of(depth)
    expected = estimate_normals(depth, camera)
    with ThreadPoolExecutor(8) as pool:
        found = list(
            pool.map(lambda n: estimate_normals(depth, camera, num_threads=n), [1, None] * 12)
        )
    assert all(np.array_equal(one, expected) for one in found)


FORK = """
import os, sys
import numpy as np
import nimprep
depth = np.random.default_rng(0).uniform(1, 2, (300, 400)).astype(np.float32)
camera = nimprep.Camera.from_fov(60, 400, 300)
before = nimprep.estimate_normals(depth, camera, num_threads=2)
child = os.fork()
if child == 0:
    after = nimprep.estimate_normals(depth, camera, num_threads=2)
    os._exit(0 if np.array_equal(before, after) else 1)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no fork there")
def test_a_forked_process_computes_on():
    done = subprocess.run([sys.executable, "-c", FORK], timeout=PATIENCE_S, check=False)
    assert done.returncode == 0


def test_out_is_written_and_returned():
    depth = big_scene()
    camera = camera_of(depth)
    out = np.full((*depth.shape, 3), np.nan, np.float32)
    assert estimate_normals(depth, camera, out=out) is out
    assert np.array_equal(out, estimate_normals(depth, camera))


def read_only():
    array = np.empty((4, 5, 3), np.float32)
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "out",
    [
        np.empty((5, 4, 3), np.float32),
        np.empty((4, 5), np.float32),
        np.empty((4, 5, 3), np.float64),
        np.empty((4, 10, 3), np.float32)[:, ::2],
        read_only(),
        [[[0.0]]],
        np.ma.zeros((4, 5, 3), np.float32),
        np.empty((4, 5, 3), ">f4"),
    ],
    ids=["size", "dimensions", "dtype", "strides", "read only", "list", "masked", "bytes"],
)
def test_an_out_that_does_not_fit_is_refused(out):
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ArrayError, match=r"^out: expected .*, found "):
        estimate_normals(depth, camera_of(depth), out=out)


def test_an_out_that_overlaps_the_depth_is_refused():
    memory = np.ones(4 * 5 * 3, np.float32)
    depth, out = memory[:20].reshape(4, 5), memory.reshape(4, 5, 3)
    with pytest.raises(ArrayError, match=r"^out: expected memory of its own"):
        estimate_normals(depth, camera_of(depth), out=out)


def test_an_unknown_method_is_refused_with_the_known_ones():
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ArrayError, match=r"^method: expected one of 'nim'.*, found 'pca'$"):
        estimate_normals(depth, camera_of(depth), method="pca")


@pytest.mark.parametrize("num_threads", [0, -1, 1.5])
def test_a_number_of_threads_that_is_none_is_refused(num_threads):
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ArrayError, match=r"^num_threads: expected "):
        estimate_normals(depth, camera_of(depth), num_threads=num_threads)


def test_the_camera_must_have_the_images_size():
    depth = np.ones((4, 5), np.float32)
    with pytest.raises(ArrayError, match=r"^depth_m: expected the camera's size"):
        estimate_normals(depth, camera_of(depth.T))


def test_nan_is_no_depth_and_the_input_stays_as_it_is():
    depth = big_scene().astype(np.float64)
    camera = camera_of(depth)
    expected = estimate_normals(depth, camera)
    with_nan = np.where(depth == 0, np.nan, depth)
    before = with_nan.copy()
    assert np.array_equal(estimate_normals(with_nan, camera), expected)
    assert np.array_equal(with_nan, before, equal_nan=True)
