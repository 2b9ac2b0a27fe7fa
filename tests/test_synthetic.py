"""Synthetic scenes: exact geometry, light, labels, and that a frame is always the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nimprep import Camera
from nimprep.errors import CameraError, NimprepError
from nimprep.synthetic import Scene, random_street, render_frame, render_scene
from nimprep.synthetic.ground import Pothole, Stretch, Strip
from nimprep.synthetic.raycast import FAR_M, NOTHING, Hits, cast, lit
from nimprep.synthetic.scene import ANOMALY, BACKGROUND, DRIVABLE, Light, Solid
from nimprep.synthetic.shapes import rotation_from_angles, unit
from nimprep.synthetic.solids import Ball, Box, Cylinder, Pose
from nimprep.synthetic.texture import Finish, Pattern
from tests.naive.street import is_solid

CAMERA = Camera.from_fov(69.4, 161, 121)
SMALL = Camera.from_fov(69.4, 64, 48)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
GREY = Finish(Pattern.PLAIN, (0.3, 0.3, 0.3), (0.3, 0.3, 0.3))
NOON = Light(
    to_sun=(0.0, -1.0, 0.0),
    sun=(1.0, 1.0, 1.0),
    ambient=(0.5, 0.5, 0.5),
    zenith=(0.3, 0.4, 0.7),
    horizon=(0.7, 0.7, 0.8),
    skyline=(0.1, 0.2, 0.1),
    skyline_height=0.05,
    clouds=0.3,
)


def plane_scene(
    *solids: Solid, gradient: float = 0.0, pitch_deg: float = 12.0, pothole: Pothole | None = None
) -> Scene:
    """A wide road 1 m below the camera, and what stands on it."""
    stretch = Stretch(-500.0, 500.0, 1.0, gradient)
    holes = () if pothole is None else (pothole,)
    road = Strip(stretch, -500.0, 500.0, GREY, DRIVABLE, potholes=holes)
    return Scene(rotation_from_angles(0, pitch_deg, 0), (road, *holes), solids, NOON)


def random_scene(index: int) -> Scene:
    return random_street(np.random.default_rng((7, index)))


def inner_pixels(owner: np.ndarray) -> np.ndarray:
    """Pixels all of whose neighbours belong to the same surface."""
    inner = np.zeros(owner.shape, dtype=bool)
    middle = owner[1:-1, 1:-1]
    inner[1:-1, 1:-1] = middle != NOTHING
    for v in range(3):
        for u in range(3):
            height, width = middle.shape
            inner[1:-1, 1:-1] &= owner[v : v + height, u : u + width] == middle
    return inner


def angle_to_differences(hits: Hits) -> np.ndarray:
    """Angle in degrees between the normals and those of the surface through the four neighbours."""
    points = np.stack([component * hits.depth for component in hits.direction], axis=-1)
    across = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    down = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    normal = np.cross(down, across)
    with np.errstate(invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    gap = np.linalg.norm(normal - np.stack(hits.normal, axis=-1), axis=-1)
    return np.degrees(2 * np.arcsin(np.clip(gap / 2, 0, 1)))


def turned(axis: str, angle_deg: float) -> np.ndarray:
    """Rotation about one axis, positive from each axis to the next: x to y to z to x."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    matrix[[first, first, second, second], [first, second, first, second]] = c, -s, s, c
    return matrix


@pytest.mark.parametrize(
    ("angles_deg", "gradient"),
    [((0.0, 12.0, 0.0), 0.0), ((0.0, 0.0, 0.0), 0.0), ((10.0, 20.0, 5.0), -0.1)],
)
def test_a_bare_plane_has_the_depth_and_normal_of_its_equation(angles_deg, gradient):
    scene = replace(plane_scene(gradient=gradient), rotation=rotation_from_angles(*angles_deg))
    frame = render_scene(scene, CAMERA, np.random.default_rng(0), noise=False)
    # In the camera frame the plane is upward . P = -1. Looking down turns z towards y.
    yaw, pitch, roll = angles_deg
    world_from_camera = turned("y", yaw) @ turned("x", -pitch) @ turned("z", roll)
    upward = np.array([0.0, -1.0, gradient]) @ world_from_camera
    u, v = np.meshgrid(np.arange(161) - CAMERA.cx, np.arange(121) - CAMERA.cy)
    rays = np.stack([u / CAMERA.fx, v / CAMERA.fy, np.ones_like(u)], axis=-1)
    with np.errstate(divide="ignore"):
        depth = -1 / (rays @ upward)
    seen = (depth > 0) & (depth <= FAR_M)
    assert 0.3 < seen.mean() < 1
    np.testing.assert_array_equal(frame.label, np.where(seen, DRIVABLE, BACKGROUND))
    np.testing.assert_allclose(frame.depth_exact_m, np.where(seen, depth, 0), rtol=1e-6)
    expected = np.where(seen[..., None], upward / np.linalg.norm(upward), 0)
    np.testing.assert_allclose(frame.normal, expected, atol=1e-7)


@pytest.mark.parametrize("index", range(4))
def test_normals_of_flat_surfaces_are_those_of_their_depth(index):
    scene = random_scene(index)
    hits = cast(scene, CAMERA)
    curved = [isinstance(s, Pothole | Ball | Cylinder) for s in scene.surfaces]
    flat = inner_pixels(hits.owner) & ~np.array([*curved, True])[hits.owner]
    assert flat.sum() > 5000
    # A box is one surface of several faces: its edges are left out.
    angle = angle_to_differences(hits)[flat]
    assert np.percentile(angle, 97) < 1e-6


@pytest.mark.parametrize(
    "thing",
    [
        Ball(Pose((0.1, 0.6, 2.5), LEVEL), 0.5, GREY, ANOMALY),
        Cylinder(Pose((0.0, 0.6, 2.5), LEVEL), 0.5, 0.4, GREY, ANOMALY),
        Cylinder(Pose((0.0, 0.6, 2.5), (LEVEL[1], LEVEL[0], LEVEL[2])), 0.4, 0.6, GREY, ANOMALY),
        Pothole(Stretch(-500.0, 500.0, 1.0, 0.0), 0.2, 2.5, 0.8, 1.1, 0.3, GREY, ANOMALY),
        Pothole(Stretch(-500.0, 500.0, 1.0, -0.1), 0.2, 2.5, 1.1, 0.8, 0.3, GREY, ANOMALY),
    ],
    ids=["ball", "standing cylinder", "lying cylinder", "pothole", "pothole on a slope"],
)
def test_normals_of_curved_surfaces_are_those_of_their_depth(thing):
    if isinstance(thing, Pothole):
        scene = plane_scene(pothole=thing, gradient=thing.stretch.gradient)
    else:
        scene = plane_scene(thing)
    camera = Camera.from_fov(69.4, 641, 481)
    hits = cast(scene, camera)
    on_it = inner_pixels(hits.owner) & (hits.owner == len(scene.surfaces) - 1)
    assert on_it.sum() > 4000
    # Central differences over 2 mm err by a few thousandths of a degree, more at the outline.
    assert np.median(angle_to_differences(hits)[on_it]) < 0.02


@pytest.mark.parametrize("index", range(6))
def test_a_ray_ends_where_the_first_thing_begins(index):
    scene = random_scene(index)
    hits = cast(scene, CAMERA)
    # Half of the pixels anywhere, half where two surfaces meet.
    rng = np.random.default_rng(index)
    borders = np.flatnonzero(~inner_pixels(hits.owner) & (hits.owner != NOTHING))
    chosen = np.concatenate([rng.integers(0, 121 * 161, 100), rng.choice(borders, 100)])
    for v, u in zip(*np.divmod(chosen, 161), strict=True):
        direction = [component[v, u] for component in hits.direction]
        depth = hits.depth[v, u]
        end = depth if depth > 0 else FAR_M
        before = np.linspace(0.05, end - 1e-6, 2000)
        assert not is_solid(scene, *(d * before for d in direction)).any(), (v, u)
        if depth > 0:
            behind = np.array([depth + 1e-6])
            assert is_solid(scene, *(d * behind for d in direction)).all(), (v, u)


def test_normals_are_unit_vectors_that_point_at_the_camera_wherever_there_is_depth():
    u, v = np.meshgrid(np.arange(64) - SMALL.cx, np.arange(48) - SMALL.cy)
    rays = np.stack([u / SMALL.fx, v / SMALL.fy, np.ones_like(u)], axis=-1)
    for index in range(30):
        frame = render_frame(1, index, SMALL)
        seen = frame.depth_exact_m > 0
        length = np.linalg.norm(frame.normal, axis=-1)
        np.testing.assert_allclose(length[seen], 1, atol=1e-6)
        assert (frame.normal[~seen] == 0).all()
        assert ((frame.normal * rays).sum(axis=-1) <= 1e-6).all()


def test_a_ray_along_a_cylinders_axis_meets_its_end():
    pipe = Cylinder(Pose((0.0, 0.0, 3.0), (LEVEL[0], LEVEL[2], LEVEL[1])), 0.5, 1.0, GREY, ANOMALY)
    hits = cast(plane_scene(pipe, pitch_deg=0.0), CAMERA)
    assert hits.depth[60, 80] == 2.0
    assert [component[60, 80] for component in hits.normal] == [0, 0, -1]


def test_the_sun_at_noon_leaves_in_shadow_just_what_is_below_a_box():
    half = (0.5, 0.1, 0.7)
    box = Box(Pose((0.3, 0.2, 4.0), LEVEL), half, GREY, ANOMALY)
    scene = plane_scene(box)
    hits = cast(scene, CAMERA)
    x, _, z = (component * hits.depth for component in hits.direction)
    road = hits.owner == 0
    below = (abs(x - 0.3) < half[0]) & (abs(z - 4.0) < half[2])
    assert (road & below).sum() > 200
    np.testing.assert_array_equal(lit(scene, CAMERA, hits)[road], ~below[road])


def test_the_shadow_of_a_low_sun_is_where_a_search_of_the_whole_image_finds_it():
    ball = Ball(Pose((-0.4, 0.7, 4.0), LEVEL), 0.3, GREY, ANOMALY)
    scene = plane_scene(ball)
    to_sun = unit((-1.0, -0.6, -0.3))
    scene = replace(scene, light=replace(NOON, to_sun=to_sun))
    hits = cast(scene, CAMERA)
    points = np.stack([component * hits.depth for component in hits.direction], axis=-1)
    gap = np.cross(points - np.array(ball.pose.centre), to_sun)
    dark = np.linalg.norm(gap, axis=-1) < ball.radius_m
    road = hits.owner == 0
    assert (road & dark).sum() > 60
    np.testing.assert_array_equal(lit(scene, CAMERA, hits)[road], ~dark[road])


def test_every_class_occurs_and_no_other():
    counts = np.zeros(256, dtype=int)
    for index in range(12):
        counts += np.bincount(render_frame(0, index, SMALL).label.ravel(), minlength=256)
    share = counts / counts.sum()
    assert share[3:].sum() == 0
    assert share[0] > 0.3
    assert share[1] > 0.3
    assert 0.003 < share[2] < 0.2


def test_a_frame_depends_on_seed_and_index_alone():
    first = render_frame(3, 5, SMALL)
    render_frame(3, 4, SMALL)
    again, other_index, other_seed = (
        render_frame(s, i, SMALL) for s, i in ((3, 5), (3, 6), (4, 5))
    )
    for name in ("rgb", "depth_m", "depth_exact_m", "normal", "label"):
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
        assert getattr(first, name).tobytes() != getattr(other_index, name).tobytes()
        assert getattr(first, name).tobytes() != getattr(other_seed, name).tobytes()


def test_noise_changes_what_the_sensors_see_and_not_the_scene():
    noisy, clean = (render_frame(0, 1, SMALL, noise=noise) for noise in (True, False))
    np.testing.assert_array_equal(clean.depth_m, clean.depth_exact_m)
    np.testing.assert_array_equal(noisy.depth_exact_m, clean.depth_exact_m)
    np.testing.assert_array_equal(noisy.label, clean.label)
    np.testing.assert_array_equal(noisy.normal, clean.normal)
    assert (noisy.depth_m != clean.depth_m).any()
    difference = noisy.rgb.astype(int) - clean.rgb
    assert 0.3 < difference.std() < 5
    assert abs(difference.mean()) < 0.3


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1)])
def test_a_negative_seed_or_index_is_refused(seed, index):
    with pytest.raises(NimprepError, match="expected a whole number >= 0, found -1"):
        render_frame(seed, index, SMALL)


def test_a_camera_of_too_few_pixels_is_refused():
    with pytest.raises(CameraError, match="expected at least 16x16 pixels, found 40x15"):
        render_frame(0, 0, Camera.from_fov(69.4, 40, 15))
