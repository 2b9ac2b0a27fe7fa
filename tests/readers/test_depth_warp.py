"""Depth of another camera, warped into colour: planes and walls whose depth is known."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from nimprep.camera import Camera
from nimprep.errors import ArrayError, LayoutError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.depth_warp import warped_depth
from tests.fakes import write_png
from tests.naive import depth_warp as naive

Array = npt.NDArray[Any]

DEPTH_CAMERA = Camera(98, 98, 72.5, 47.5, 128, 96)
COLOR_CAMERA = Camera(110, 110, 63.5, 47.5, 128, 96)


def turned(degrees: float, shift: tuple[float, float, float]) -> Array:
    """Return the transform from depth to colour: a turn about y, then a shift."""
    a = np.radians(degrees)
    transform = np.eye(4)
    transform[:3, :3] = [[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]]
    transform[:3, 3] = shift
    return transform


NEAR = turned(2.0, (0.06, 0.01, -0.02))


def plane_depth(camera: Camera, normal: Array, offset: float, transform: Array) -> Array:
    """Return the depth that a camera sees of the plane n·p = offset of depth's frame.

    `transform` goes from depth's frame to the camera's.
    """
    n = transform[:3, :3] @ normal
    d = offset + n @ transform[:3, 3]
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0 + 0 * u], -1)
    along = rays @ n
    return np.where(along / d > 1e-6, d / along, 0)


SLANTED = {
    "wall": (np.array([0, 0, 1.0]), 5.0),
    "slanted wall": (np.array([0.5, 0, 0.85]), 4.0),
    "road": (np.array([0, 1.0, 0.2]), 1.3),
}


@pytest.mark.parametrize("name", SLANTED)
@pytest.mark.parametrize("by", [1, 3])
def test_a_plane_is_exactly_where_the_other_camera_sees_it(name: str, by: int) -> None:
    normal, offset = SLANTED[name]
    target = COLOR_CAMERA.resize(96 * by, 128 * by)
    depth = plane_depth(DEPTH_CAMERA, normal, offset, np.eye(4))
    depth[depth > 60] = 0
    found = warped_depth(depth.astype(np.float32), DEPTH_CAMERA, NEAR, target)
    true = plane_depth(target, normal, offset, NEAR)
    # Seen by the depth camera, two pixels and more from where its image or its range ends.
    back = np.linalg.inv(NEAR)
    v, u = np.mgrid[: target.height, : target.width]
    z = np.where(true > 0, true, 1)
    points = np.stack([(u - target.cx) / target.fx * z, (v - target.cy) / target.fy * z, z], -1)
    x, y, w = np.moveaxis(points @ back[:3, :3].T + back[:3, 3], -1, 0)
    at_u, at_v = 98 * x / w + 72.5, 98 * y / w + 47.5
    seen = (true > 0) & (w > 0) & (w < 25) & (at_u > 1) & (at_u < 126) & (at_v > 1) & (at_v < 94)
    assert seen.mean() > 0.2
    assert (found[seen] > 0).all(), "no holes"
    off = np.abs(1 / found[seen] - 1 / true[seen]) * true[seen]
    # Up to rounding; with a pixel's own depth for all of its surface, it is 0.3 % and more.
    assert off.max() < 1e-6


def test_a_near_wall_hides_the_far_one_and_uncovers_no_depth() -> None:
    depth = np.full((96, 128), 8, np.float32)
    depth[:, 40:80] = 2
    shift = turned(0, (0.4, 0, 0))
    found = warped_depth(depth, DEPTH_CAMERA, shift, DEPTH_CAMERA)
    # A shift of 0.4 m: 98 * 0.4 / 2 = 19.6 pixels for the near one, 4.9 for the far one.
    row = found[50]
    assert set(np.unique(row.round(4))) == {0, 2, 8}
    near = np.flatnonzero(row.round(4) == 2)
    assert (near[0], near[-1]) == (60, 99)
    assert np.array_equal(near, np.arange(60, 100))
    # Uncovered: from where the far wall on the left ends, 39.5 + 4.9, to the near one.
    assert np.flatnonzero(row == 0).tolist() == [*range(5), *range(45, 60)]
    assert np.array_equal(found, np.tile(row, (96, 1)))


def test_it_is_what_rays_against_every_triangle_give() -> None:
    rng = np.random.default_rng(5)
    camera, target = Camera(20, 21, 8.3, 6.1, 18, 13), Camera(26, 25, 10.7, 8.2, 23, 17)
    depth = plane_depth(camera, np.array([0.2, 0.9, 0.4]), 1.5, np.eye(4))
    depth = np.where((depth > 0) & (depth < 9), depth, 6).astype(np.float32)
    depth[3:7, 5:9] = 2
    depth[rng.random(depth.shape) < 0.1] = 0
    transform = turned(4, (0.1, -0.05, 0.03))
    found = warped_depth(depth, camera, transform, target)
    expected = naive.warped_depth(depth, camera, transform, target)
    both = (found > 0) & (expected > 0)
    assert not ((expected > 0) & (found == 0)).any()
    # A surface is drawn a twentieth of a pixel larger, so that neighbours leave no seam.
    assert ((found > 0) & (expected == 0)).mean() < 0.03
    off = np.abs(found[both] / expected[both] - 1)
    assert np.median(off) < 1e-6
    assert (off > 1e-5).mean() < 0.08
    assert (found[both] < expected[both] * (1 + 1e-5)).all(), "the nearest is seen"


def test_the_same_camera_in_the_same_place_changes_nothing() -> None:
    depth = np.random.default_rng(0).uniform(1, 60, (24, 32)).astype(np.float32)
    depth[::3, ::4] = 0
    camera = Camera(30, 30, 15.5, 11.5, 32, 24)
    found = warped_depth(depth, camera, np.eye(4), camera)
    assert np.array_equal(found > 0, depth > 0)
    some = (depth > 0) & (found > 0)
    assert np.abs(found[some] / depth[some] - 1).max() < 0.05


@pytest.mark.parametrize("depth", [1e-4, 1e-30, 1e30, np.float32(3e38)])
def test_any_depth_is_warped_in_time(depth: float) -> None:
    image = np.full((60, 80), depth, np.float32)
    camera = Camera(50, 50, 40, 30, 80, 60)
    for transform in (NEAR, turned(180, (0, 0, 0)), turned(90, (1, 0, 0))):
        found = warped_depth(image, camera, transform, Camera(5000, 5000, 40, 30, 400, 300))
        assert np.isfinite(found).all()
        assert (found >= 0).all()


def test_depth_of_another_size_than_its_camera_is_refused() -> None:
    with pytest.raises(ArrayError, match="like its camera"):
        warped_depth(np.ones((5, 6), np.float32), DEPTH_CAMERA, NEAR, COLOR_CAMERA)


def written(root: Path, **depth: Any) -> Path:
    """Write a dataset of a wall at 5 m, whose depth another camera took at half the size."""
    small = DEPTH_CAMERA.resize(48, 64)
    wall = plane_depth(small, np.array([0, 0, 1.0]), 5.0, np.eye(4))
    write_png(root / "rgb/0.png", np.full((96, 128, 3), 90, np.uint8))
    write_png(root / "depth/0.png", (wall * 1000).round().astype(np.uint16))
    described = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "own",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth/{id}.png", "scale_m": 0.001, **depth},
        "camera": {"fx": 110, "fy": 110, "cx": 63.5, "cy": 47.5},
    }
    path = root / "d.json"
    path.write_text(json.dumps(described))
    return path


def test_a_described_depth_camera_is_warped_into_colour(tmp_path: Path) -> None:
    small = DEPTH_CAMERA.resize(48, 64).to_dict()
    path = written(tmp_path, camera=small, depth_to_rgb=NEAR[:3].tolist())
    reader = open_reader(tmp_path, ReaderOptions(description=path))
    frame = reader.read("0")
    assert frame.camera == COLOR_CAMERA
    assert reader.shape("0") == (96, 128)
    assert frame.depth_m is not None
    true = plane_depth(COLOR_CAMERA, np.array([0, 0, 1.0]), 5.0, NEAR)
    some = frame.depth_m > 0
    assert some.mean() > 0.8
    # In whole millimetres.
    assert np.abs(frame.depth_m[some] - true[some]).max() < 2e-3
    only = reader.read("0", ("depth",)).depth_m
    assert only is not None
    assert np.array_equal(only, frame.depth_m)
    assert any("depth_to_rgb" in note for note in reader.info.notes)
    sized = open_reader(tmp_path, ReaderOptions(description=path, size="64x48")).read("0")
    assert sized.camera == COLOR_CAMERA.resize(48, 64)
    assert sized.depth_m is not None
    true = plane_depth(sized.camera, np.array([0, 0, 1.0]), 5.0, NEAR)
    some = sized.depth_m > 0
    assert np.abs(sized.depth_m[some] - true[some]).max() < 2e-3


REFUSED = {
    "camera alone": ({"camera": DEPTH_CAMERA.to_dict()}, "expected depth's depth_to_rgb"),
    "place alone": ({"depth_to_rgb": NEAR[:3].tolist()}, "expected depth's camera"),
    "no rotation": (
        {"camera": DEPTH_CAMERA.to_dict(), "depth_to_rgb": (2 * NEAR[:3]).tolist()},
        "expected a rotation",
    ),
    "millimetres": (
        {"camera": DEPTH_CAMERA.to_dict(), "depth_to_rgb": turned(0, (60, 0, 0))[:3].tolist()},
        "in metres",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_half_of_what_a_warp_needs_is_refused(tmp_path: Path, case: str) -> None:
    depth, words = REFUSED[case]
    path = written(tmp_path, **depth)
    with pytest.raises(LayoutError, match=words):
        open_reader(tmp_path, ReaderOptions(description=path))
