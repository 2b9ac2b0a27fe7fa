"""Tiny data sets of the kinds that are public, written by code, with known depth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

HEIGHT, WIDTH = 64, 96
FOCAL, ROW = 80.0, 20.0
FRAMES = 4

Plane = npt.NDArray[Any]


def street(seed: int, closer: float = 1.0) -> tuple[Plane, Plane]:
    """Return colour and depth, metres, 0 = none: a ground 1.5 m below, a wall, a box, a sky."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    depth = np.where(rows > ROW + 1, 1.5 * FOCAL / np.maximum(rows - ROW, 1e-6), 30.0)
    depth = np.minimum(depth, 30.0)
    left = int(rng.integers(10, 70))
    box = (columns >= left) & (columns < left + 12) & (rows >= 25) & (rows < 45)
    depth[box] = np.minimum(depth[box], 4.0)
    depth[:6] = 0
    color = (60 + 8 * rng.integers(0, 8, (HEIGHT, WIDTH, 3)) + 40 * (depth > 20)[..., None]).astype(
        np.uint8
    )
    return color, (depth / closer).astype(np.float32)


def units(depth: Plane, per_metre: float) -> npt.NDArray[np.uint16]:
    return np.clip(np.rint(depth * per_metre), 0, 65535).astype(np.uint16)


def disparity(depth: Plane, baseline: float = 0.54) -> Plane:
    return np.where(depth > 0, FOCAL * baseline / np.maximum(depth, 1e-3), 0)


def save(path: Path, image: Plane) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, image)
        return
    if image.ndim == 3:
        image = image[..., [2, 1, 0, 3][: image.shape[2]]]
    assert cv2.imwrite(str(path), np.ascontiguousarray(image))


def note(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def kitti_completion(root: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(FRAMES):
        color, depth = street(k)
        depth[rng.random(depth.shape) > 0.15] = 0
        drive = root / "train" / f"2011_09_26_drive_000{k // 2}_sync"
        save(drive / f"proj_depth/groundtruth/image_02/{k:010d}.png", units(depth, 256))
        save(drive / f"image_02/data/{k:010d}.png", color)


def diode(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        scan = root / f"train/outdoor/scene_0001{k // 2}/scan_00183"
        name = f"0001{k // 2}_00183_outdoor_{k:03d}_010"
        save(scan / f"{name}.png", color)
        save(scan / f"{name}_depth.npy", depth[..., None])
        save(scan / f"{name}_depth_mask.npy", (depth > 0).astype(np.float64))


def tartanair(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        depth[depth == 0] = 10000
        part = root / f"oldtown/Easy/P00{k // 2}"
        save(part / f"image_left/{k:06d}_left.png", color)
        save(part / f"image_right/{k:06d}_right.png", color)
        save(part / f"depth_left/{k:06d}_left_depth.npy", depth)
        note(part / "pose_left.txt", "0 0 0 0 0 0 1\n")


def tartanair_bytes(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        part = root / f"Cable/Data_easy/P00{k // 2}"
        save(part / f"image_lcam_front/{k:06d}_lcam_front.png", color)
        blue_first = depth.view(np.uint8).reshape(HEIGHT, WIDTH, 4)
        packed = blue_first[..., [2, 1, 0, 3]]
        save(part / f"depth_lcam_front/{k:06d}_lcam_front_depth.png", packed)


def replica(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=5)
        save(root / f"room0/results/frame{k:06d}.jpg", color)
        save(root / f"room0/results/depth{k:06d}.png", units(depth, 6553.5))
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 80.0, "fy": 80.0, "cx": 47.5, "cy": 20.0}
    note(root / "cam_params.json", json.dumps({"camera": {**camera, "scale": 6553.5}}))


def icl_nuim(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=3)
        save(root / f"rgb/{k}.png", color)
        save(root / f"depth/{k}.png", units(depth, 5000))
    lines = [f"{k} depth/{k}.png {k} rgb/{k}.png" for k in range(FRAMES)]
    note(root / "associations.txt", "\n".join(lines))


def eth3d(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=3)
        stamp = f"{1234.5 + k / 27:.6f}"
        save(root / f"rgb/{stamp}.png", color)
        save(root / f"depth/{stamp}.png", units(depth, 5000))
    note(root / "calibration.txt", "80 80 47.5 20\n")
    note(root / "associated.txt", "1234.5 rgb/1234.500000.png 1234.5 depth/1234.500000.png\n")


def middlebury(root: Path) -> None:
    for k, name in enumerate(("Adirondack-perfect", "Backpack-perfect", "Bicycle1-perfect")):
        color, depth = street(k, closer=5)
        pixels = disparity(depth, 0.2).astype(np.float32) - np.float32(1.5)
        pixels[depth == 0] = np.inf
        save(root / name / "im0.png", color)
        save(root / name / "im1.png", color)
        save(root / name / "disp0.pfm", pixels)
        matrix = "[80 0 47.5; 0 80 20; 0 0 1]"
        text = f"cam0={matrix}\ncam1={matrix}\ndoffs=1.5\nbaseline=200\nwidth={WIDTH}\n"
        note(root / name / "calib.txt", f"{text}height={HEIGHT}\nndisp=64\n")


def driving_stereo(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        name = f"2018-07-09-16-11-56_2018-07-09-16-12-0{k}-860"
        save(root / f"train-left-image/{name}.jpg", color)
        save(root / f"train-disparity-map/{name}.png", units(disparity(depth), 256))


def scannetpp(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=4)
        scene = root / "data" / ("0a5c013435", "1b75758486")[k // 2] / "iphone"
        save(scene / f"rgb/frame_{10 * k:06d}.jpg", cv2.resize(color, (2 * WIDTH, 2 * HEIGHT)))
        save(scene / f"depth/frame_{10 * k:06d}.png", units(depth, 1000))


def matterport(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=4)
        scan, name = root / "17DRP5sb8fy", f"00ebbf3782c64d74aaf7dd39cd561{k:03d}"
        save(scan / f"undistorted_color_images/{name}_i{k % 3}_{k}.jpg", color)
        save(scan / f"undistorted_depth_images/{name}_d{k % 3}_{k}.png", units(depth, 4000))


def seven_scenes(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=4)
        raw = units(depth, 1000)
        raw[raw == 0] = 65535
        save(root / f"seq-0{1 + k // 2}/frame-{k:06d}.color.png", color)
        save(root / f"seq-0{1 + k // 2}/frame-{k:06d}.depth.png", raw)
        note(root / f"seq-0{1 + k // 2}/frame-{k:06d}.pose.txt", "1 0 0 0\n")


def carla_alpha(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        whole = np.round(depth / 1000 * (256**3 - 1)).astype(np.int64)
        whole[depth == 0] = 256**3 - 1
        parts = [whole & 255, whole >> 8 & 255, whole >> 16, np.full_like(whole, 255)]
        save(root / f"rgb/{k:06d}.png", color)
        save(root / f"depth/{k:06d}.png", np.dstack(parts).astype(np.uint8))


def swapped(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        noise = np.random.default_rng(k).normal(0, 0.003, depth.shape) * (depth > 0)
        save(root / f"color/{k}.png", color)
        save(root / f"depth/{k}.png", units(depth + noise, 1000).byteswap())


def disparity_called_depth(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"img/{k}.png", color)
        save(root / f"depth/{k}.png", units(disparity(depth), 256))


def nameless(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"x/{k}.png", color)
        save(root / f"y/{k}.png", units(depth, 256))


def centimetres(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"x/{k}.png", color)
        save(root / f"y/{k}.npy", depth * 100)


def kinect_times_five(root: Path) -> None:
    """Depth as TUM's own: a sensor's whole millimetres times 5."""
    for k in range(FRAMES):
        color, depth = street(k, closer=4)
        save(root / f"a/{k}.png", color)
        save(root / f"b/{k}.png", 5 * units(depth, 1000))


def kitti_selection(root: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(FRAMES):
        color, depth = street(k)
        depth[rng.random(depth.shape) > 0.15] = 0
        name = f"2011_09_26_drive_0002_sync_{{}}_{k:010d}_image_02"
        part = root / "val_selection_cropped"
        save(part / f"image/{name.format('image')}.png", color)
        for kind in ("groundtruth_depth", "velodyne_raw"):
            save(part / f"{kind}/{name.format(kind)}.png", units(depth, 256))
        note(part / f"intrinsics/{name.format('image')}.txt", "80 0 47.5 0 80 20 0 0 1")


def carla_16_bit(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"Town03/rgb/{k}.png", color)
        save(root / f"Town03/depth/{k}.png", units(depth, 65.535))


def carla_normalised(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"Town03/rgb/{k}.png", color)
        save(root / f"Town03/depth/{k}.npy", depth / np.float32(1000))


def scene_flow(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        place = "15mm_focallength/scene_forwards/fast/{}/{:04d}".format
        for side in ("left", "right"):
            save(root / f"frames_cleanpass/{place(side, k)}.png", color)
            pixels = disparity(depth, 1.0).astype(np.float32)
            save(root / f"disparity/{place(side, k)}.pfm", pixels)


def stanford(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k, closer=4)
        raw = units(depth, 512)
        raw[raw == 0] = 65535
        name = f"camera_00d10d86db1e435081a837ced388375{k}_office_{k}_frame_{k}_domain_"
        save(root / f"area_1/data/rgb/{name}rgb.png", color)
        save(root / f"area_1/data/depth/{name}depth.png", raw)


def bare_numbers(root: Path) -> None:
    for k in range(FRAMES):
        color, depth = street(k)
        save(root / f"color/{k}.png", color)
        (root / "depth").mkdir(exist_ok=True)
        units(depth, 1000).tofile(root / f"depth/{k}.bin")


CARLA = 1000 / (256**3 - 1)

KINDS: dict[Callable[[Path], None], dict[str, Any]] = {
    kitti_completion: {"scale_m": 1 / 256},
    diode: {"scale_m": 1.0},
    tartanair: {"scale_m": 1.0, "invalid": [0, 10000]},
    tartanair_bytes: {"scale_m": 1.0, "bytes": "BGRA", "bytes_as": "float32"},
    replica: {"scale_m": 1 / 6553.5},
    icl_nuim: {"scale_m": 1 / 5000},
    eth3d: {"scale_m": 1 / 5000},
    middlebury: {"values": "disparity", "scale_px": 1.0, "offset_px": 1.5},
    driving_stereo: {"values": "disparity", "scale_px": 1 / 256},
    scannetpp: {"scale_m": 0.001},
    matterport: {"scale_m": 1 / 4000},
    seven_scenes: {"scale_m": 0.001, "invalid": [0, 65535]},
    carla_alpha: {"scale_m": CARLA, "bytes": "RGB", "invalid": [0, 16777215]},
    swapped: {"scale_m": 0.001, "byte_order": "swapped"},
    disparity_called_depth: {"values": "disparity", "scale_px": 1 / 256},
    nameless: {"scale_m": 1 / 256},
    centimetres: {"scale_m": 0.01},
    kinect_times_five: {"scale_m": 1 / 5000},
    bare_numbers: {"scale_m": 0.001},
    kitti_selection: {"scale_m": 1 / 256},
    carla_16_bit: {"scale_m": 1000 / 65535},
    carla_normalised: {"scale_m": 1000.0},
    scene_flow: {"values": "disparity", "scale_px": 1.0},
    stanford: {"scale_m": 1 / 512, "invalid": [0, 65535]},
}
"""What writes a data set, and what its depth must be told to be."""
