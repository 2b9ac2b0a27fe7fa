"""Images of one frame brought to one size and one camera, against what is known by analysis."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from nimprep.camera import Camera
from nimprep.errors import ArrayError, CameraError, DecodeError, NimprepError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader
from nimprep.readers.cameras import GivenCamera
from nimprep.readers.description import CameraSource
from nimprep.readers.description_file import description_from_file
from nimprep.readers.distortion import Distortion
from nimprep.readers.matching import Place
from nimprep.readers.registration import registered_shape
from nimprep.readers.resizing import resized_linear, resized_nearest
from nimprep.readers.undistortion import pixel_map, rays
from tests.fakes import write_png

Array = npt.NDArray[Any]

CLASSES = [
    {"id": 0, "name": "wall", "color": [0, 0, 0]},
    {"id": 1, "name": "road", "color": [0, 200, 0]},
]
CAM = {"fx": 110.0, "fy": 112.0, "cx": 66.0, "cy": 45.0}
BROWN = [-0.3, 0.09, 0.002, -0.001, 0.01]
PINCUSHION = [0.2, 0.05, 0.002, -0.001, 0.0, 0.01, -0.02, 0.003]
FISHEYE = [-0.02, 0.004, -0.001, 0.0002]


def distorted(x: Array, y: Array, model: str, c: list[float]) -> tuple[Array, Array]:
    """Return where a lens shows (x, y, 1), by the equations of OpenCV's documentation."""
    r2 = x * x + y * y
    if model == "equidistant":
        r = np.sqrt(r2)
        t = np.arctan(r)
        bent = t * (1 + c[0] * t**2 + c[1] * t**4 + c[2] * t**6 + c[3] * t**8)
        by = np.where(r > 0, bent / np.maximum(r, 1e-12), 1)
        return x * by, y * by
    k1, k2, p1, p2, k3, k4, k5, k6 = [*c, *[0.0] * (8 - len(c))]
    by = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    return (
        x * by + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * by + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def seen_by(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return colour, depth along z and label of a road, a wall and stripes, at rays (x, y, 1)."""
    road = np.where(y > 1e-6, 1.2 / np.maximum(y, 1e-6), np.inf)
    depth = np.minimum(road, 9.0)
    grey = 128 + 60 * np.sin(12 * x) * np.cos(9 * y)
    color = np.stack([grey, 255 - grey, 0.5 * grey], axis=-1)
    return color, depth, (road < 9).astype(np.uint8)


def through(model: str, c: list[float], h: int = 96, w: int = 128) -> tuple[Array, Array, Array]:
    """Return what the lens's image shows: rays found by bisection of nothing but `distorted`."""
    v, u = np.mgrid[:h, :w].astype(float)
    wx, wy = (u - CAM["cx"]) / CAM["fx"], (v - CAM["cy"]) / CAM["fy"]
    x, y = wx.copy(), wy.copy()
    for _ in range(200):
        dx, dy = distorted(x, y, model, c)
        x, y = x + 0.7 * (wx - dx), y + 0.7 * (wy - dy)
    dx, dy = distorted(x, y, model, c)
    assert np.abs(dx - wx).max() < 1e-9
    assert np.abs(dy - wy).max() < 1e-9
    return seen_by(x, y)


def write(root: Path, frame: tuple[Array, Array, Array], **changes: Any) -> Path:
    color, depth, label = frame
    write_png(root / "rgb/0.png", color.round().clip(0, 255).astype(np.uint8))
    write_png(root / "depth/0.png", (depth * 1000).round().astype(np.uint16))
    write_png(root / "label/0.png", label)
    described = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "own",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth/{id}.png", "scale_m": 0.001},
        "label": {"files": "label/{id}.png"},
        "classes": CLASSES,
        "camera": CAM,
        **changes,
    }
    path = root / "d.json"
    path.write_text(json.dumps(described))
    return path


def opened(root: Path, **options: Any) -> Reader:
    return open_reader(root, ReaderOptions(description=root / "d.json", **options))


LENSES = [
    ("plumb_bob", BROWN),
    ("plumb_bob", BROWN[:4]),
    ("rational_polynomial", PINCUSHION),
    ("equidistant", FISHEYE),
]


@pytest.mark.parametrize(("model", "lens"), LENSES)
def test_an_undistorted_frame_is_what_a_pinhole_sees(
    tmp_path: Path, model: str, lens: list[float]
) -> None:
    camera = {**CAM, "distortion": lens, "distortion_model": model}
    write(tmp_path, through(model, lens), camera=camera)
    reader = opened(tmp_path)
    frame = reader.read("0")
    assert (frame.camera.fx, frame.camera.cy) == (CAM["fx"], CAM["cy"])
    v, u = np.mgrid[:96, :128].astype(float)
    x, y = (u - CAM["cx"]) / CAM["fx"], (v - CAM["cy"]) / CAM["fy"]
    color, depth, label = seen_by(x, y)
    dx, dy = distorted(x, y, model, lens)
    at_u, at_v = dx * CAM["fx"] + CAM["cx"], dy * CAM["fy"] + CAM["cy"]
    inside = (at_u >= -0.5) & (at_u <= 127.5) & (at_v >= -0.5) & (at_v <= 95.5)
    edge = np.minimum.reduce(
        [abs(at_u + 0.5), abs(at_u - 127.5), abs(at_v + 0.5), abs(at_v - 95.5)]
    )
    sure = edge > 1e-3
    assert frame.rgb is not None
    assert frame.depth_m is not None
    assert frame.label is not None
    # Borders: none in every image, at the same pixels.
    assert np.array_equal((frame.label != 255)[sure], inside[sure])
    assert np.array_equal((frame.depth_m > 0)[sure], inside[sure])
    assert not frame.rgb[~inside & sure].any()
    # Colours by linear interpolation; a row off, they are 6 grey levels off in the mean.
    seen = inside & sure & (edge > 1)
    off = np.abs(frame.rgb.astype(float) - color)[seen]
    assert off.mean() < 0.8
    assert off.max() < 5
    # Depth of the nearest pixel: at most half a row of the road away; inverse depth is linear.
    inverse = np.abs(1 / np.where(inside, frame.depth_m, 1) - 1 / depth)[seen]
    assert inverse.max() < 0.75 / 1.2 / CAM["fy"]
    far_from_edge = seen & (np.abs(y - 1.2 / 9) * CAM["fy"] > 1)
    assert np.array_equal(frame.label[far_from_edge], label[far_from_edge])
    (note,) = [n for n in reader.info.notes if "distortion" in n]
    assert "undistorted" in note
    if not inside.all():
        assert f"{100 * (1 - inside.mean()):.1f} %" in note


def test_distortion_is_refused_or_left_on_request(tmp_path: Path) -> None:
    frame = through("plumb_bob", BROWN)
    write(tmp_path, frame, camera={**CAM, "distortion": BROWN})
    with pytest.raises(CameraError, match="expected a camera without distortion"):
        opened(tmp_path, distortion="refuse")
    left = opened(tmp_path, distortion="rectified").read("0")
    assert left.label is not None
    assert np.array_equal(left.label, frame[2])
    write(tmp_path, frame, camera={**CAM, "k1": -0.3, "distortion": "rectified"})
    left = opened(tmp_path).read("0")
    assert left.label is not None
    assert np.array_equal(left.label, frame[2])


def test_the_users_camera_file_is_undistorted_too(tmp_path: Path) -> None:
    write(tmp_path, through("plumb_bob", PINCUSHION))
    (tmp_path / "c.json").write_text(json.dumps({**CAM, "distortion": PINCUSHION}))
    frame = opened(tmp_path, camera=tmp_path / "c.json").read("0")
    assert frame.label is not None
    assert (frame.label == 255).any()
    with pytest.raises(CameraError, match="without distortion"):
        opened(tmp_path, camera=tmp_path / "c.json", distortion="refuse")
    left = opened(tmp_path, camera=tmp_path / "c.json", distortion="rectified").read("0")
    assert left.label is not None
    assert not (left.label == 255).any()


def test_what_a_polynomial_folds_back_is_none() -> None:
    # k1 alone: r (1 + k1 r²) turns back where 1 + 3 k1 r² is 0.
    camera, k1 = Camera(60, 60, 63.5, 47.5, 128, 96), -0.4
    found = pixel_map(camera, Distortion("brown", (k1, 0, 0, 0)))
    v, u = np.mgrid[:96, :128].astype(float)
    r2 = ((u - 63.5) / 60) ** 2 + ((v - 47.5) / 60) ** 2
    turned = 1 + 3 * k1 * r2 < 0
    assert turned.any()
    assert not (found.inside & turned & (np.abs(1 + 3 * k1 * r2) > 0.01)).any()
    assert found.inside[~turned & (r2 < 0.5)].all()


@pytest.mark.parametrize(("model", "lens"), LENSES)
def test_rays_through_a_lens_are_those_that_it_bends_there(model: str, lens: list[float]) -> None:
    camera = Camera(**CAM, width=128, height=96)
    kind = "fisheye" if model == "equidistant" else "brown"
    x, y = rays(camera, Distortion(kind, tuple(lens)))
    dx, dy = distorted(x, y, model, lens)
    v, u = np.mgrid[:96, :128]
    assert np.abs(dx * camera.fx + camera.cx - u).max() < 1e-3
    assert np.abs(dy * camera.fy + camera.cy - v).max() < 1e-3
    given = GivenCamera("file", "c", (110, 112, 66, 45), distortion=Distortion(kind, tuple(lens)))
    assert np.allclose(given.ray_lengths(96, 128, "a"), np.sqrt(1 + x * x + y * y))


def other_size(tmp_path: Path, camera: Any, **changes: Any) -> None:
    """Write a frame whose colour and label are twice as large as its depth."""
    color, _, label = pinhole(192, 256)
    _, depth, _ = pinhole(96, 128)
    write(tmp_path, (color, depth, label), camera=camera, **changes)


def pinhole(h: int, w: int) -> tuple[Array, Array, Array]:
    by = h / 96
    v, u = np.mgrid[:h, :w].astype(float)
    cx, cy = (CAM["cx"] + 0.5) * by - 0.5, (CAM["cy"] + 0.5) * by - 0.5
    return seen_by((u - cx) / (CAM["fx"] * by), (v - cy) / (CAM["fy"] * by))


SIZED = {**CAM, "width": 128, "height": 96}


def test_images_of_other_size_are_refused_and_the_option_named(tmp_path: Path) -> None:
    other_size(tmp_path, SIZED)
    with pytest.raises(DecodeError, match=r"found 128x96; if they are registered, give --size rgb"):
        opened(tmp_path).read("0")


@pytest.mark.parametrize("size", ["depth", "rgb", "64x48", (256, 192)])
def test_registered_images_are_brought_to_one_size_and_the_camera_along(
    tmp_path: Path, size: Any
) -> None:
    other_size(tmp_path, SIZED)
    reader = opened(tmp_path, size=size)
    w, h = {"depth": (128, 96), "rgb": (256, 192), "64x48": (64, 48)}.get(size, (256, 192))
    frame = reader.read("0")
    assert reader.shape("0") == frame.camera.shape == (h, w)
    assert frame.camera == Camera(**CAM, width=128, height=96).resize(h, w)
    color, depth, label = pinhole(h, w)
    assert frame.rgb is not None
    assert frame.depth_m is not None
    assert frame.label is not None
    assert frame.rgb.shape == (h, w, 3)
    off = np.abs(frame.rgb.astype(float) - color)
    assert off.mean() < 1.5
    # A pixel of depth covers two of colour: half a row of its own.
    inverse = np.abs(1 / frame.depth_m - 1 / depth)
    assert inverse.max() < 0.51 * max(1, 96 / h) / 1.2 / CAM["fy"]
    v = np.mgrid[:h, :w][0]
    row = frame.camera.cy + 1.2 / 9 * frame.camera.fy
    sure = np.abs(v - row) > 1
    assert np.array_equal(frame.label[sure], label[sure])
    only = reader.read("0", ("depth",))
    assert only.depth_m is not None
    assert np.array_equal(only.depth_m, frame.depth_m)


def test_a_camera_that_does_not_say_its_size_is_refused_with_images_of_two(tmp_path: Path) -> None:
    other_size(tmp_path, CAM)
    with pytest.raises(CameraError, match=r"rgb of 256x192, depth of 128x96 .*camera\.for_size"):
        opened(tmp_path, size="depth").read("0")
    (tmp_path / "c.txt").write_text("110 112 66 45")
    other_size(tmp_path, {"files": "c.txt", "for_size": [128, 96]}, size="rgb")
    frame = opened(tmp_path).read("0")
    assert frame.camera == Camera(**CAM, width=128, height=96).resize(192, 256)


def test_numbers_given_by_hand_are_those_of_images_of_one_size(tmp_path: Path) -> None:
    write(tmp_path, pinhole(96, 128))
    frame = opened(tmp_path, size=(64, 48), camera=(110, 112, 66, 45)).read("0")
    assert frame.camera == Camera(**CAM, width=128, height=96).resize(48, 64)


def test_another_aspect_is_refused(tmp_path: Path) -> None:
    color, _, label = pinhole(192, 256)
    write(tmp_path, (color, pinhole(96, 128)[1][:, :125], label), camera=SIZED)
    with pytest.raises(DecodeError, match="another aspect by more than a pixel"):
        opened(tmp_path, size="rgb").read("0")


@pytest.mark.parametrize("size", ["640", "0x5", "label", (1.5, 2), (3,), 7, "9999999x2"])
def test_a_size_that_is_none_is_refused(size: Any) -> None:
    with pytest.raises(ArrayError, match="size: expected rgb, depth or WxH"):
        ReaderOptions(size=size)


def test_resizing_and_undistorting_in_one_step_is_exact_to_half_a_pixel(tmp_path: Path) -> None:
    color, _, label = through("plumb_bob", BROWN)
    by = 2
    big = [np.kron(a, np.ones((by, by) + (1,) * (a.ndim - 2))) for a in (color, label)]
    depth = through("plumb_bob", BROWN)[1]
    write(
        tmp_path,
        (big[0], depth, big[1].astype(np.uint8)),
        camera={**SIZED, "distortion": BROWN},
        size="rgb",
    )
    frame = opened(tmp_path).read("0")
    _, true, _ = pinhole(192, 256)
    assert frame.depth_m is not None
    some = frame.depth_m > 0
    inverse = np.abs(1 / frame.depth_m[some] - 1 / true[some])
    assert inverse.max() < 0.75 / 1.2 / CAM["fy"]


def test_nearest_takes_the_pixel_that_a_centre_lies_in() -> None:
    image = np.arange(12).reshape(2, 6)
    assert resized_nearest(image, 1, 3).tolist() == [[7, 9, 11]]
    assert resized_nearest(image, 4, 6).tolist() == [*[list(range(6))] * 2, *[[*range(6, 12)]] * 2]


def test_linear_planes_do_not_mix_what_is_none_in() -> None:
    image = np.array([[10, 22, -1, 40]], np.int16)
    found = resized_linear(image, 1, 8, -1)
    assert found.tolist() == [[10, 13, 19, 22, -1, -1, 40, 40]]
    assert found.dtype == np.int16


def test_a_damaged_camera_file_of_a_frame_is_that_frames_fault(tmp_path: Path) -> None:
    write(tmp_path, pinhole(96, 128), camera="cam/{id}.txt")
    (tmp_path / "cam").mkdir()
    (tmp_path / "cam/0.txt").write_text("110 112 66")
    reader = opened(tmp_path)
    with pytest.raises(NimprepError, match=r"0\.txt: expected 4, 6, 9"):
        reader.read("0")
    (tmp_path / "cam/0.txt").write_text("110 112 66 45")
    assert opened(tmp_path).read("0").camera.fx == 110


def test_opencvs_own_projection_agrees_with_the_equations() -> None:
    points = np.array([[0.3, -0.2, 1.0], [-0.5, 0.4, 1.0]])
    zero = np.zeros(3)
    found, _ = cv2.projectPoints(points, zero, zero, np.eye(3), np.array(BROWN))
    dx, dy = distorted(points[:, 0], points[:, 1], "plumb_bob", BROWN)
    assert np.allclose(found[:, 0], np.stack([dx, dy], axis=-1))


def test_distance_along_the_ray_is_that_of_the_rays_the_lens_bends(tmp_path: Path) -> None:
    _, depth, _ = frame = through("plumb_bob", BROWN)
    x, y = rays(Camera(**CAM, width=128, height=96), Distortion("brown", tuple(BROWN)))
    far = depth * np.sqrt(1 + x * x + y * y)
    ray = {"files": "depth/{id}.png", "scale_m": 0.001, "values": "distance"}
    write(tmp_path, (frame[0], far, frame[2]), camera={**CAM, "distortion": BROWN}, depth=ray)
    found = opened(tmp_path).read("0").depth_m
    write(tmp_path, frame, camera={**CAM, "distortion": BROWN})
    expected = opened(tmp_path).read("0").depth_m
    assert found is not None
    assert expected is not None
    # Whole millimetres of distance; with the rays of a pinhole, a corner is 5 % off.
    assert np.abs(found - expected).max() < 2e-3


def test_disparity_of_distorted_images_is_refused(tmp_path: Path) -> None:
    depth = {"files": "depth/{id}.png", "scale_px": 0.01, "values": "disparity", "baseline_m": 0.1}
    write(tmp_path, pinhole(96, 128), camera={**CAM, "distortion": BROWN}, depth=depth)
    with pytest.raises(CameraError, match="disparity of rectified images"):
        opened(tmp_path).read("0")
    assert opened(tmp_path, distortion="rectified").read("0").depth_m is not None


@pytest.mark.parametrize("size", ["rgb", None])
def test_a_frame_without_the_image_whose_size_it_is_to_have_is_refused(
    tmp_path: Path, size: Any
) -> None:
    _, depth, _ = pinhole(96, 128)
    there = {"depth": Place(tmp_path / "depth/0.png")}
    write(tmp_path, pinhole(96, 128))
    described = description_from_file(tmp_path / "d.json")
    source = described.depth
    assert source is not None
    if size is None:
        source = replace(source, camera=CameraSource(numbers=SIZED))
    with pytest.raises(DecodeError, match=r"0\.png: expected rgb beside it"):
        registered_shape(there, replace(described, size=size, depth=source))
    assert registered_shape(there, replace(described, size=(7, 5))) == (5, 7)
    assert registered_shape(there, described) == depth.shape
