"""Transforms: every modality and the camera move together."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep import (
    Camera,
    RoadProfile,
    disparity_from_depth,
    estimate_elevation,
    estimate_normals,
    transform_disparity,
)
from nimprep.errors import ArrayError
from nimprep.synthetic import render_frame
from tests.derive import roads
from tests.derive.test_normals import angle_deg, plane_depth, unit, with_holes

torch = pytest.importorskip("torch")

import nimprep.torch.transforms as T  # noqa: E402, N812

CAMERA = Camera(fx=60.0, fy=70.0, cx=28.3, cy=11.6, width=63, height=45)
FEW = settings(max_examples=25)


ROAD = np.array([-0.1, -0.9, -np.sqrt(0.18), 1.2])
"""The plane that elevation counts from: its normal and the camera's height."""

PROFILE = RoadProfile(3.0, (-1.0, 0.05, 0.0), (0.0, 60.0))


def sample_of(depth, camera=CAMERA, seed=0, plane=ROAD, profile=PROFILE, **more):
    """Return a sample with every modality, the pixel's own number in rgb, hha and label."""
    disparity = disparity_from_depth(depth, camera)
    transformed, _ = transform_disparity(disparity, profile)
    height, width = depth.shape
    v, u = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    normal = estimate_normals(depth, camera)
    rgb = torch.stack([u % 256, v % 256, (u + v) % 256]).to(torch.uint8)
    return {
        "rgb": rgb,
        "depth": torch.from_numpy(depth)[None],
        "normal": torch.from_numpy(normal).permute(2, 0, 1),
        "hha": rgb + 1,
        "disparity": torch.from_numpy(disparity)[None],
        "transformed_disparity": torch.from_numpy(transformed)[None],
        "elevation": torch.from_numpy(estimate_elevation(depth, camera, plane))[None],
        "label": (v * width + u) % 3,
        "intrinsics": torch.from_numpy(camera.matrix),
        "size": (height, width),
        "id": "scene/000007",
        "generator": torch.Generator().manual_seed(seed),
        **more,
    }


def plane_sample(normal=(-0.3, -0.8, -0.5), seed=0, camera=CAMERA):
    return sample_of(plane_depth(unit(normal), 2.0, camera), camera, seed)


def camera_of(sample):
    height, width = sample["depth"].shape[-2:]
    return Camera.from_matrix(sample["intrinsics"].numpy(), width, height)


def normals_of(sample):
    return sample["normal"].permute(1, 2, 0).numpy()


def error_deg(sample, margin=2):
    """Return the angle between the normals and those of the depth, inside."""
    found = estimate_normals(sample["depth"][0].numpy(), camera_of(sample))
    inside = (slice(margin, -margin), slice(margin, -margin))
    there = found.any(axis=-1)[inside]
    return angle_deg(normals_of(sample), found)[inside][there]


def same(a, b):
    """Tell whether two images are equal, NaN and all."""
    return a.shape == b.shape and bool(((a == b) | ((a != a) & (b != b))).all())


def is_padding(name, values):
    """Tell whether all of it is what stands outside the frame."""
    if name in ("transformed_disparity", "elevation"):
        return bool(values.isnan().all())
    return bool((values == (255 if name == "label" else 0)).all())


slopes = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.9, -0.3), st.just(-0.4))


@FEW
@given(slopes)
def test_the_normals_of_a_mirrored_plane_are_its_mirrored_normals(normal):
    assert error_deg(T.flip(plane_sample(normal))).max() < 0.01


@FEW
@given(slopes, st.integers(0, 30), st.integers(0, 30), st.integers(6, 60), st.integers(6, 60))
def test_the_normals_of_a_cropped_plane_are_its_cropped_normals(normal, top, left, height, width):
    cropped = T.crop(plane_sample(normal), top, left, height, width)
    # Depth ends at padding, where a pixel sees one side only; a plane does not mind.
    valid_height, valid_width = cropped["size"]
    assert error_deg(T.crop(cropped, 0, 0, valid_height, valid_width)).max() < 0.01


@pytest.mark.parametrize(("down", "across"), [(3, 3), (5, 9), (1, 3), (9, 1)])
def test_the_normals_of_a_plane_shrunk_by_whole_numbers_are_its_normals(down, across):
    # By odd numbers: then the nearest pixel's centre is the new pixel's.
    small = T.resize(plane_sample(), 45 // down, 63 // across)
    error = error_deg(small, margin=1)
    assert error.size > 0
    assert error.max() < 0.02


def test_the_transformed_normals_of_a_street_are_those_of_its_transformed_depth():
    camera = Camera.from_fov(69.4, 160, 120)
    frame = render_frame(3, 0, camera, noise=False)
    sample = sample_of(frame.depth_exact_m, camera)
    for changed in (T.flip(sample), T.crop(sample, 20, 30, 90, 100)):
        assert np.quantile(error_deg(changed), 0.999) < 0.05
    # 159 columns by 3, so that both axes shrink by an odd number.
    third = T.resize(T.crop(sample, 0, 0, 120, 159), 40, 53)
    assert np.median(error_deg(third)) < 0.5


def test_a_flip_mirrors_pixels_n_x_and_the_camera():
    sample = plane_sample()
    flipped = T.flip(sample)
    for name in T.IMAGES:
        if name != "normal":
            assert same(flipped[name], sample[name].flip(-1))
    mirrored = sample["normal"].flip(-1)
    assert torch.equal(flipped["normal"][0], -mirrored[0])
    assert torch.equal(flipped["normal"][1:], mirrored[1:])
    assert camera_of(flipped) == CAMERA.flip()


def test_two_flips_change_nothing():
    sample = plane_sample()
    twice = T.flip(T.flip(sample))
    for name in T.IMAGES:
        assert same(twice[name], sample[name])
    torch.testing.assert_close(twice["intrinsics"], sample["intrinsics"], rtol=0, atol=1e-12)


def test_a_crop_takes_the_window_of_every_image_and_of_the_camera():
    sample = plane_sample()
    cropped = T.crop(sample, 5, 7, 20, 30)
    for name in T.IMAGES:
        assert same(cropped[name], sample[name][..., 5:25, 7:37])
    assert camera_of(cropped) == CAMERA.crop(5, 7, 20, 30)
    assert cropped["size"] == (20, 30)


def test_a_crop_beyond_the_frame_pads_at_the_bottom_and_the_right():
    cropped = T.crop(plane_sample(), 40, 60, 10, 12)
    assert cropped["size"] == (5, 3)
    for name in T.IMAGES:
        outside = torch.ones(10, 12, dtype=torch.bool)
        outside[:5, :3] = False
        assert is_padding(name, cropped[name][..., outside])
        assert cropped[name].shape[-2:] == (10, 12)


any_size = st.tuples(st.integers(1, 120), st.integers(1, 120))


def road_scene(seed):
    """Return depth of a road with boards, and the road's plane."""
    rng = np.random.default_rng(seed)
    plane = roads.plane_of(rng.uniform(-10, 10), rng.uniform(5, 20), 1.0)
    depth, _ = roads.with_boards(roads.road_depth(plane, CAMERA), 0.3, seed, CAMERA)
    return depth.astype(np.float32), plane


@FEW
@given(st.floats(0, 0.4), any_size, st.integers(0, 5))
def test_the_transformed_disparity_image_is_that_of_the_transformed_depth(share, size, seed):
    sample = sample_of(with_holes(road_scene(seed)[0], share, seed))
    for changed in (T.flip(sample), T.crop(sample, 10, 7, 30, 40), T.resize(sample, *size)):
        again = disparity_from_depth(changed["depth"][0].numpy(), camera_of(changed))
        np.testing.assert_allclose(changed["disparity"][0].numpy(), again, rtol=1e-6)


@FEW
@given(st.integers(0, 20), st.floats(0, 0.4))
def test_the_elevation_of_the_transformed_depth_is_the_transformed_elevation(seed, share):
    depth, plane = road_scene(seed)
    sample = sample_of(with_holes(depth, share, seed), plane=plane)
    mirrored = plane * (-1, 1, 1, 1)
    # By odd whole numbers a new pixel's centre is an old one's.
    for changed, road in (
        (T.flip(sample), mirrored),
        (T.crop(sample, 10, 7, 30, 40), plane),
        (T.resize(sample, 15, 21), plane),
        (T.resize(T.flip(sample), 9, 63), mirrored),
    ):
        again = estimate_elevation(changed["depth"][0].numpy(), camera_of(changed), road)
        np.testing.assert_allclose(changed["elevation"][0].numpy(), again, atol=3e-5)


@FEW
@given(st.integers(0, 20))
def test_the_road_taken_out_of_the_transformed_disparity_is_the_transformed_road(seed):
    sample = sample_of(road_scene(seed)[0], profile=None)
    for changed in (T.flip(sample), T.crop(sample, 4, 2, 41, 60), T.resize(sample, 45, 21)):
        again, _ = transform_disparity(changed["disparity"][0].numpy())
        np.testing.assert_allclose(changed["transformed_disparity"][0].numpy(), again, atol=1e-4)


def test_a_resize_scales_disparities_with_the_width_and_not_elevation():
    sample = plane_sample()
    wide = T.resize(sample, 45, 126)
    for name, factor in (("disparity", 2), ("transformed_disparity", 2), ("elevation", 1)):
        assert torch.equal(wide[name][..., ::2], sample[name] * factor)
    tall = T.resize(sample, 90, 63)
    assert torch.equal(tall["disparity"][..., ::2, :], sample["disparity"])


def test_a_resize_moves_the_camera_with_the_outer_edges():
    resized = T.resize(plane_sample(), 90, 21)
    expected = CAMERA.resize(90, 21)
    np.testing.assert_allclose(resized["intrinsics"].numpy(), expected.matrix, rtol=1e-12)
    assert resized["size"] == (90, 21)
    assert {resized[name].shape[-2:] for name in T.IMAGES} == {(90, 21)}


def test_depth_and_label_take_the_pixel_that_a_centre_falls_in():
    sample = plane_sample()
    resized = T.resize(sample, 30, 100)
    for v in range(30):
        for u in range(0, 100, 9):
            row, column = int((v + 0.5) * 45 / 30), int((u + 0.5) * 63 / 100)
            assert resized["depth"][0, v, u] == sample["depth"][0, row, column]
            assert resized["label"][v, u] == sample["label"][row, column]


def test_a_resized_ramp_of_colours_is_the_ramp_at_the_new_size():
    wide = T.resize(plane_sample(), 45, 126)
    # Pixel u' lies at (u' + 1/2) / 2 - 1/2 of the old image.
    expected = (torch.arange(2, 124) + 0.5) / 2 - 0.5
    for name, more in (("rgb", 0), ("hha", 1)):
        found = wide[name][0, 20, 2:124].float() - more
        assert (found - expected).abs().max() <= 0.51


@pytest.mark.parametrize("size", [(1, 1), (1, 30), (30, 1), (2, 2), (17, 100)])
def test_colours_interpolated_in_bytes_are_those_interpolated_in_float(size):
    rgb = torch.randint(0, 256, (3, 20, 30), generator=torch.Generator().manual_seed(0))
    found = T.resize({"rgb": rgb.byte()}, *size)["rgb"]
    expected = torch.nn.functional.interpolate(
        rgb.float()[None], size, mode="bilinear", antialias=True
    )[0]
    assert (found - expected).abs().max() <= 1.01


@FEW
@given(st.integers(1, 120), st.integers(1, 120), st.integers(0, 5))
def test_normals_are_unit_vectors_exactly_where_depth_is_after_any_resize(height, width, seed):
    depth = with_holes(plane_depth(unit((0.2, -0.8, -0.5)), 2.0, CAMERA), 0.4, seed)
    # Without pixels that have no neighbour, and so no normal.
    depth *= estimate_normals(depth, CAMERA).any(axis=2)
    resized = T.resize(sample_of(depth), height, width)
    length = np.linalg.norm(normals_of(resized), axis=-1)
    there = resized["depth"][0].numpy() > 0
    assert np.abs(length[there] - 1).max(initial=0) < 1e-6
    assert not length[~there].any()


def test_holes_do_not_bleed_into_normals_or_hha():
    depth = plane_depth(unit((0, -0.8, -0.5)), 2.0, CAMERA)
    sample = sample_of(with_holes(depth, 0.4))
    seen = sample["depth"] > 0
    sample["normal"] = torch.where(seen, torch.tensor([0, -0.8, -0.6])[:, None, None], 0.0)
    sample["hha"] = torch.where(seen, torch.tensor([90, 120, 200])[:, None, None], 0).byte()
    resized = T.resize(sample, 70, 40)
    there = resized["depth"][0] > 0
    torch.testing.assert_close(
        resized["normal"][:, there].T, torch.tensor([[0, -0.8, -0.6]]).expand(there.sum(), 3)
    )
    assert torch.equal(resized["hha"][:, there].T.unique(dim=0), torch.tensor([[90, 120, 200]]))
    assert not resized["hha"][:, ~there].any()


def test_normals_that_cancel_out_become_the_nearest_one():
    sample = {"normal": torch.tensor([[[1.0, -1.0]], [[0, 0]], [[0, 0]]])}
    found = T.resize(sample, 1, 1)["normal"]
    assert found[:, 0, 0].tolist() == [-1, 0, 0]


def test_padding_stays_at_the_right_and_out_of_everything():
    """A frame in a larger padded tensor gives what the frame alone gives."""
    alone = plane_sample()
    padded = {**T.crop(alone, 0, 0, 60, 80), "generator": None}
    assert padded["size"] == (45, 63)
    for change in (
        T.flip,
        lambda s: T.resize(s, 30, 50),
        lambda s: T.crop(s, 3, 4, 20, 20),
        lambda s: T.jitter(s, 1.2, 0.8, 0.5, 0.1),
    ):
        one, other = change(alone), change(padded)
        assert one["size"] == other["size"]
        assert torch.equal(one["intrinsics"], other["intrinsics"])
        height, width = one["size"]
        for name in T.IMAGES:
            assert same(one[name], other[name][..., :height, :width])
            assert is_padding(name, other[name][..., height:, :])
            assert is_padding(name, other[name][..., width:])


def test_the_same_generator_gives_the_same_sample_and_another_one_another():
    transform = T.Compose(
        [
            T.RandomScale((0.5, 2.0)),
            T.RandomCrop(24, 32),
            T.RandomHorizontalFlip(),
            T.ColorJitter(0.4, 0.4, 0.4, 0.1),
        ]
    )
    torch.manual_seed(0)
    first, state = transform(plane_sample(seed=1)), torch.random.get_rng_state()
    again = pickle.loads(pickle.dumps(transform))(plane_sample(seed=1))
    other = transform(plane_sample(seed=2))
    assert torch.equal(torch.random.get_rng_state(), state)
    for name in (*T.IMAGES, "intrinsics"):
        assert same(first[name], again[name])
    assert not torch.equal(first["rgb"], other["rgb"])


def test_a_callable_of_ones_own_and_its_keys_pass_through():
    def darken(sample):
        return {**sample, "rgb": sample["rgb"] // 2, "note": "dark"}

    sample = plane_sample()
    changed = T.Compose([darken, T.RandomHorizontalFlip(1), T.Resize(9, 9)])(sample)
    assert changed["note"] == "dark"
    assert changed["id"] == sample["id"]
    assert changed["generator"] is sample["generator"]


@pytest.mark.parametrize(
    "transform",
    [
        T.RandomCrop(30, 90),
        T.Resize(20, 20),
        T.RandomScale((0.5, 0.6)),
        T.RandomHorizontalFlip(1.0),
        T.ColorJitter(0.5, 0.5, 0.5, 0.5),
    ],
    ids=lambda t: type(t).__name__,
)
def test_what_is_given_is_not_changed_and_parts_may_be_missing(transform):
    sample, twin = plane_sample(), plane_sample()
    transform(sample)
    assert sample.keys() == twin.keys()
    for name in (*T.IMAGES, "intrinsics"):
        assert same(sample[name], twin[name])
    alone = transform({"rgb": twin["rgb"]})
    assert "label" not in alone
    assert "intrinsics" not in alone


def test_random_crops_reach_every_place_and_nothing_beyond():
    crop = T.RandomCrop(44, 61)
    found = {tuple(crop(plane_sample(seed=s))["intrinsics"][:2, 2].tolist()) for s in range(80)}
    expected = {(CAMERA.cx - left, CAMERA.cy - top) for left in range(3) for top in range(2)}
    assert found == expected


def test_a_random_scale_keeps_the_aspect_and_stays_in_range():
    for seed in range(20):
        scaled = T.RandomScale((0.5, 2.0))(plane_sample(seed=seed))
        height, width = scaled["size"]
        assert 45 * 0.5 - 1 <= height <= 45 * 2 + 1
        assert abs(width / 63 - height / 45) < 1 / 45


def test_flips_happen_as_often_as_p_says():
    times = [
        torch.equal(T.RandomHorizontalFlip(0.3)(s)["rgb"], s["rgb"])
        for s in (plane_sample(seed=n) for n in range(100))
    ]
    assert 55 <= sum(times) <= 85


def test_jitter_touches_rgb_only():
    sample = plane_sample()
    changed = T.jitter(sample, 0.7, 1.3, 0.5, 0.2)
    assert not torch.equal(changed["rgb"], sample["rgb"])
    assert all(changed[name] is sample[name] for name in sample if name != "rgb")


def colour(*values):
    return {"rgb": torch.tensor(values, dtype=torch.uint8)[:, None, None].expand(3, 2, 2)}


def test_jitter_does_to_a_colour_what_its_options_say():
    def changed(sample, **options):
        return T.jitter(sample, **options)["rgb"][:, 0, 0].tolist()

    assert changed(colour(100, 50, 20), brightness=1.5) == [150, 75, 30]
    assert changed(colour(200, 50, 20), brightness=2) == [255, 100, 40]
    # Luma of (100, 50, 20) is 61.7; a frame of one colour has its own luma as mean.
    assert changed(colour(100, 50, 20), saturation=0) == [62, 62, 62]
    assert changed(colour(100, 50, 20), contrast=0) == [62, 62, 62]
    assert changed(colour(80, 80, 80), saturation=3, hue=0.3) == [80, 80, 80]
    assert changed(colour(100, 50, 20), hue=0) == [100, 50, 20]
    # Half a turn is the opposite colour of the same luma.
    assert changed(colour(100, 50, 20), hue=0.5) == [23, 73, 103]


def test_contrast_moves_values_away_from_the_mean():
    rgb = torch.tensor([50, 150], dtype=torch.uint8).expand(3, 1, 2)
    assert T.jitter({"rgb": rgb}, contrast=1.5)["rgb"][0, 0].tolist() == [25, 175]
    assert T.jitter({"rgb": rgb}, brightness=0.5, contrast=2)["rgb"][0, 0].tolist() == [0, 100]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: T.RandomCrop(0, 5), "positive height and width, found 0, 5"),
        (lambda: T.Resize(4, -1), "positive height and width"),
        (lambda: T.RandomScale((2, 1)), "expected 0 < low <= high"),
        (lambda: T.RandomHorizontalFlip(1.5), r"expected p in \[0, 1\], found 1.5"),
        (lambda: T.ColorJitter(hue=0.6), "a hue up to 0.5"),
        (lambda: T.flip({"id": "a"}), "expected images of one size, found no image"),
        (lambda: T.resize(plane_sample(), 0, 4), "expected a positive size"),
        (lambda: T.crop(plane_sample(), 45, 0, 4, 4), "starts inside 63x45"),
        (lambda: T.flip({**plane_sample(), "size": (99, 9)}), r"a size within \(45, 63\)"),
    ],
)
def test_what_makes_no_sense_is_refused(make, message):
    with pytest.raises(ArrayError, match=message):
        make()
