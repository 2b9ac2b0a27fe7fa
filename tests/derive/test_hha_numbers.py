"""HHA where depths are of very different sizes: nothing spreads, and no index leaves its table."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from nimprep import encode_hha
from nimprep.arrays import LEAST_DEPTH_M
from nimprep.derive.gravity import scene_from_depth
from nimprep.derive.hha import _ANGLE_LEVELS
from nimprep.kernels import hha_channels
from nimprep.kernels.hha_planes import plane_block
from tests.derive.test_hha import CAMERA, room, tilted

DOWN = tilted(12.0, 3.0)


def windows_without(v: int, u: int, radius: int) -> np.ndarray:
    """Return which pixels' windows do not hold a pixel."""
    apart = np.ones(CAMERA.shape, bool)
    apart[max(v - radius, 0) : v + radius + 1, max(u - radius, 0) : u + radius + 1] = False
    return apart


def normals(depth: np.ndarray, radius: int) -> np.ndarray:
    scene = scene_from_depth(depth, CAMERA)
    out = np.empty((3, *depth.shape))
    for first, last in scene.blocks:
        plane_block(scene.inverse, first, last, radius, scene.camera, out, 0)
    return out


@pytest.mark.parametrize("place", [(0, 0), (40, 60), (20, 10)])
@pytest.mark.parametrize("metres", [LEAST_DEPTH_M, 1e-3, 1e30])
def test_one_absurd_depth_spoils_no_window_but_its_own(metres, place):
    depth = room(DOWN)[0].astype(np.float32)
    odd = depth.copy()
    odd[place] = metres
    for radius in (3, 10):
        apart = windows_without(*place, radius)
        turned = np.linalg.norm(normals(depth, radius) - normals(odd, radius), axis=0)
        # 1e-12 m turned them by up to 1 rad.
        assert turned[apart].max() < 1e-7
    found, expected = (encode_hha(d, CAMERA, gravity=DOWN) for d in (odd, depth))
    channels = [0, 2] if metres > 1 else [0, 1, 2]
    assert np.array_equal(
        found[windows_without(*place, 3)][:, channels],
        expected[windows_without(*place, 3)][:, channels],
    )


def test_very_far_depth_beside_near_depth_has_normals():
    # Sums of inverse depth run along rows and columns: after 1/m they leave 0 of 1e-30/m.
    depth = np.ones(CAMERA.shape, np.float32)
    depth[:, 65:] = 1e30
    for radius in (3, 10):
        assert np.isfinite(normals(depth, radius)).all()
    assert encode_hha(depth, CAMERA, gravity=DOWN)[..., 2].all()


def test_whatever_normals_are_the_angle_is_looked_up_within_its_table():
    # Numba checks bounds where told to: what would end the process then raises.
    checked = njit(boundscheck=True, error_model="numpy")(hha_channels._angle_row.py_func)
    numbers = [np.nan, np.inf, -np.inf, 0.0, 1e-320, 1e-170, 1.0, -1.0, 1.0 + 1e-15, 7.0, 1e200]
    x, y, z = (m.reshape(-1) for m in np.meshgrid(numbers, numbers, numbers))
    cosines, out = np.empty(x.size), np.full(x.size, 255, np.uint8)
    with np.errstate(all="ignore"):
        for gravity in [
            (0.0, 1.0, 0.0),
            (0.6, -0.8, 0.0),
            (np.nan, 0.0, np.inf),
            (1e300, 9.0, 0.0),
        ]:
            checked(x, y, z, gravity, *_ANGLE_LEVELS, cosines, out)
            assert out.max() <= 180
            assert ((cosines >= -1) & (cosines <= 1)).all()
