"""Cases 10, 30 and 44: images of other size, calibration files, and depth of another camera."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep.camera import Camera
from nimprep.errors import CameraError, DecodeError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader
from tests.cases.cases import case_scene, folder, layout_scene

Make = Callable[[str], Path]

SCENE = Camera(110, 110, 63.5, 47.5, 128, 96)
LAYOUT = Camera(80, 80, 47.5, 20, 96, 64)


def described(root: Path, out: Path | None = None, **description: Any) -> Reader:
    path = out or root / "described.json"
    full = {"format": "nimprep-folder", "version": "1.1", "name": "own", **description}
    path.write_text(json.dumps(full))
    return open_reader(root, ReaderOptions(description=path))


def test_case_10_registered_images_of_other_size_are_brought_to_one(case: Make) -> None:
    root = case("10-")
    document = json.loads((root / "d.json").read_text())
    with pytest.raises(DecodeError, match="give --size rgb or --size depth"):
        open_reader(root, ReaderOptions(description=root / "d.json")).read("0")
    with pytest.raises(CameraError, match=r"camera\.for_size"):
        open_reader(root, ReaderOptions(description=root / "d.json", size="depth")).read("0")
    camera = {**document["camera"], "width": 128, "height": 96}
    for size, expected in (("depth", SCENE), ("rgb", SCENE.resize(192, 256))):
        frame = described(root, **{**document, "camera": camera, "size": size}).read("0")
        assert frame.camera == expected
        _, depth, label = case_scene(
            0, expected.height, expected.width, fx=expected.fx, fy=expected.fy
        )
        assert frame.depth_m is not None
        assert frame.label is not None
        assert frame.rgb is not None
        assert (frame.label == label).mean() > 0.98
        assert np.median(np.abs(frame.depth_m - depth) / depth) < 0.01
        large, _, _ = case_scene(0, 192, 256, fx=220, fy=220)
        by = 192 // expected.height
        means = large.reshape(expected.height, by, expected.width, by, 3).mean(axis=(1, 3))
        assert np.abs(frame.rgb - means).max() <= 0.5


READ = {
    "open3d.json": None,
    "colmap_cameras.txt": None,
    "cam_K.txt": None,
    "ros.yaml": (-0.15, 0.3, 0.001, 0.002, 0.0),
    "camera_info.json": (-0.3, 0.1, 0.0, 0.0, 0.0),
    "distorted.json": (-0.35, 0.12, 0.0, 0.0),
}


@pytest.mark.parametrize("name", READ)
def test_case_30_calibration_files_give_their_camera(case: Make, name: str) -> None:
    root = case("30-")
    lens = READ[name]
    reader = open_reader(root, ReaderOptions(camera=root / "cams" / name))
    frame = reader.read("000000")
    assert frame.camera == SCENE
    assert frame.label is not None
    _, _, label = case_scene(0)
    assert np.array_equal(frame.label, label) == (lens is None)
    notes = [n for n in reader.info.notes if "distortion" in n]
    assert bool(notes) == (lens is not None)
    if lens is not None:
        assert f"({', '.join(f'{c:g}' for c in lens)})" in notes[0]
        with pytest.raises(CameraError, match="without distortion"):
            open_reader(root, ReaderOptions(camera=root / "cams" / name, distortion="refuse"))


def test_case_30_what_no_one_can_read_is_refused(case: Make) -> None:
    root = case("30-")
    cams = root / "cams"
    with pytest.raises(CameraError, match=r"Inverse Brown Conrady.*--distortion rectified"):
        open_reader(root, ReaderOptions(camera=cams / "realsense.json"))
    rectified = ReaderOptions(camera=cams / "realsense.json", distortion="rectified")
    assert open_reader(root, rectified).read("000000").camera == SCENE
    with pytest.raises(CameraError, match="found one of 96x128; check the width and height"):
        open_reader(root, ReaderOptions(camera=cams / "swapped.json")).read("000000")


def test_case_44_depth_of_another_camera_is_brought_to_colours_place(case: Make) -> None:
    root = case("44-")
    depth = {
        "files": "depth_u16/{id}.png",
        "scale_m": 0.001,
        "camera": {"fx": 98, "fy": 98, "cx": 72.5, "cy": 47.5},
        "depth_to_rgb": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]],
    }
    camera = json.loads((root / "camera.json").read_text())
    reader = described(root, rgb="rgb/{id}.png", depth=depth, camera=camera)
    for seed, frame_id in enumerate(reader.ids):
        frame = reader.read(frame_id)
        assert frame.camera == SCENE
        assert frame.depth_m is not None
        _, true, label = case_scene(seed)
        seen = frame.depth_m > 0
        assert seen.mean() > 0.9
        off = np.abs(frame.depth_m - true)[seen] / true[seen]
        # Where surfaces meet, a pixel may be of either; as it was read before, half are off.
        assert np.median(off) < 1e-3
        assert (off > 0.01).mean() < 0.03
        box = np.abs(frame.depth_m - true)[(label == 2) & seen] < 0.02
        assert box.mean() > 0.85


LAYOUTS: dict[str, dict[str, Any]] = {
    "orfd": {
        "rgb": "{split}/{scene}/image_data/{name}.png",
        "depth": {"files": "{split}/{scene}/dense_depth/{name}.png", "scale_m": 1 / 256},
        "camera": "{split}/{scene}/calib/{name}.txt",
        "id": "{split}/{scene}/{name}",
    },
    "cityscapes": {
        "rgb": "leftImg8bit/{split}/{city}/{name}_leftImg8bit.png",
        "depth": {
            "files": "disparity/{split}/{city}/{name}_disparity.png",
            "values": "disparity",
            "scale_px": 1 / 256,
            "offset_px": -1 / 256,
        },
        "camera": "camera/{split}/{city}/{name}_camera.json",
        "id": "{split}/{city}/{name}",
    },
    "kitti_semantics": {
        "rgb": "training/image_2/{id}_10.png",
        "depth": {
            "files": "training/disp_occ_0/{id}_10.png",
            "values": "disparity",
            "scale_px": 1 / 256,
        },
        "camera": {"files": "training/calib_cam_to_cam/{id}.txt", "key": "P_rect_02"},
    },
    "vkitti2": {
        "rgb": "{scene}/{variation}/frames/rgb/Camera_{cameraID}/rgb_{frame}.jpg",
        "depth": {
            "files": "{scene}/{variation}/frames/depth/Camera_{cameraID}/depth_{frame}.png",
            "scale_m": 0.01,
            "invalid": [65535],
        },
        "camera": {"files": "{scene}/{variation}/intrinsic.txt"},
        "id": "{scene}/{variation}/{cameraID}/{frame}",
    },
    "sunrgbd": {
        "rgb": "{id}/image/*.jpg",
        "depth": {
            "files": "{id}/depth_bfx/*.png",
            "scale_m": 0.001,
            "rotate_right": 3,
        },
        "camera": "{id}/intrinsics.txt",
    },
    "rellis": {
        "rgb": "{scene}/pylon_camera_node/{name}.jpg",
        "camera": "calibration/{scene}/camera_info.txt",
        "id": "{scene}/{name}",
        # The fake's three lists name one frame.
        "split": False,
    },
    "scannet": {
        "rgb": "scans/{scene}/color/{name}.jpg",
        "depth": {"files": "scans/{scene}/depth/{name}.png", "scale_m": 0.001},
        "camera": {
            "files": "scans/{scene}/intrinsic/intrinsic_depth.txt",
            "for_size": [96, 64],
        },
        "size": "depth",
        "id": "{scene}/{name}",
    },
}

CAMERAS = {
    "cityscapes": replace(LAYOUT, fx=2262.52 * 96 / 2048, fy=2265.3 * 96 / 2048),
    "vkitti2": replace(LAYOUT, fx=725.0087, fy=725.0087, cx=620.5, cy=187),
}
BASELINES = {"cityscapes": 0.209313, "kitti_semantics": 0.54}


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_public_layouts_cameras_are_read(layout: Make, name: str) -> None:
    root = layout(name)
    reader = described(root, **LAYOUTS[name])
    assert len(reader.ids) >= 3
    assert reader.info.calibration == "file"
    for frame_id in reader.ids:
        frame = reader.read(frame_id)
        assert frame.camera == CAMERAS.get(name, LAYOUT)
        if name in BASELINES:
            assert frame.baseline_m == pytest.approx(BASELINES[name])
    if "depth" in LAYOUTS[name] and name != "sunrgbd":
        seeds = {"scannet": 20 if reader.ids[-1].endswith("20") else 0}
        if name in seeds:
            _, true, _ = layout_scene(seeds[name])
            assert frame.depth_m is not None
            some = true > 0
            assert np.abs(frame.depth_m - true)[some].max() < 2e-3


def test_the_camera_of_a_real_frame_of_orfd_is_read(tmp_path: Path) -> None:
    root = folder("cases").parent / "data" / "orfd"
    (text,) = [path.read_text() for path in root.rglob("calib/*.txt")]
    numbers = text.split("cam_K:")[1].split()
    reader = described(
        root,
        tmp_path / "d.json",
        rgb="{split}/{scene}/image_data/{name}.png",
        camera="{split}/{scene}/calib/{name}.txt",
        id="{scene}/{name}",
    )
    camera = reader.read(reader.ids[0]).camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == tuple(
        float(numbers[i]) for i in (0, 4, 2, 5)
    )
    assert camera.shape == (720, 1280)


RELLIS_LENS = (-0.134313, -0.025905, 0.002181, 0.00084, 0.0)


def test_a_real_frame_of_rellis_is_undistorted_as_opencv_does(tmp_path: Path) -> None:
    import cv2

    root = folder("cases").parent / "data" / "rellis"
    fx, fy, cx, cy = map(float, (root / "calibration/00000/camera_info.txt").read_text().split())
    own = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "distortion": RELLIS_LENS}
    (tmp_path / "camera.json").write_text(json.dumps(own))
    frames = {
        "rgb": "{scene}/pylon_camera_node/{name}.jpg",
        "camera": "calibration/{scene}/camera_info.txt",
        "id": "{scene}/{name}",
    }
    plain = described(root, tmp_path / "d.json", **frames)
    lens = ReaderOptions(description=tmp_path / "d.json", camera=tmp_path / "camera.json")
    reader = open_reader(root, lens)
    before, frame = plain.read(plain.ids[0]), reader.read(plain.ids[0])
    assert before.rgb is not None
    assert frame.rgb is not None
    assert frame.camera == before.camera == Camera(fx, fy, cx, cy, 1920, 1200)
    expected = cv2.undistort(before.rgb, frame.camera.matrix, np.array(RELLIS_LENS))
    inside = frame.rgb.any(axis=2) & expected.any(axis=2)
    assert inside.mean() > 0.99
    assert np.abs(frame.rgb.astype(int) - expected)[inside].mean() < 0.1
    # The lens moves a corner by some 12 pixels.
    assert np.abs(before.rgb.astype(int) - frame.rgb).mean() > 2
