"""Tiny datasets in the layouts the readers know, written by code so that none is shipped."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

SIZE = (24, 32)


def write_png(path: Path, image: npt.NDArray[np.generic]) -> Path:
    """Write an image, (H, W) or (H, W, 3) R, G, B, and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)
    return path


def depth_image(seed: int, size: tuple[int, int] = SIZE) -> npt.NDArray[np.uint16]:
    """Return a sloped ground in millimetres with noise, a hole and a saturated pixel."""
    rng = np.random.default_rng(seed)
    rows = np.linspace(6000, 1500, size[0])[:, None]
    depth = (rows + rng.normal(0, 5, size)).astype(np.uint16)
    depth[:3, 5:9] = 0
    depth[-1, -1] = 65535
    return depth


def write_gmrp(
    root: Path, frames: int = 5, size: tuple[int, int] = SIZE, labels: bool = True
) -> Path:
    """Write a dataset in GMRP's layout, its folder depth_u8 included."""
    for number in range(frames):
        rng = np.random.default_rng(number)
        name = f"{number:06d}.png"
        depth = depth_image(number, size)
        write_png(root / "rgb" / name, rng.integers(0, 256, (*size, 3), dtype=np.uint8))
        write_png(root / "depth_u16" / name, depth)
        write_png(root / "depth_u8" / name, (depth >> 8).astype(np.uint8))
        if labels:
            label = np.zeros(size, np.uint8)
            label[size[0] // 2 :] = 1
            label[-4:, :4] = 2
            write_png(root / "label" / name, label)
    return root


NYU_LIKE = {
    "format": "nimprep-folder",
    "version": "1.0",
    "name": "nyu-like",
    "rgb": "color/{id}.png",
    "depth": {"files": "depth/{id}.png", "scale_m": 0.0001, "invalid": [0]},
    "label": {"files": "label/{id}.png", "map": {"40": 1, "300": 255}, "default": 0},
    "classes": [
        {"id": 0, "name": "other", "color": [0, 0, 0]},
        {"id": 1, "name": "floor", "color": [0, 255, 0]},
    ],
    "camera": "camera/{id}.json",
    "group": "{group}/*",
}


def write_nyu_like(root: Path, **changes: object) -> tuple[Path, Path]:
    """Write scenes of 1/10000 m depth, 1-based cameras and mapped labels.

    Returns the dataset's folder and its description with `changes`.
    """
    for frame_id in ("kitchen/0", "kitchen/1", "office/0", "office/1"):
        rng = np.random.default_rng(len(frame_id))
        write_png(
            root / "color" / f"{frame_id}.png", rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
        )
        write_png(root / "depth" / f"{frame_id}.png", depth_image(7) * np.uint16(5))
        label = np.full(SIZE, 40, np.uint16)
        label[:4], label[4:6] = 300, 7
        write_png(root / "label" / f"{frame_id}.png", label)
        camera = {"fx": 30.0, "fy": 31.0, "cx": 17.0, "cy": 13.0, "pixel_origin": 1}
        path = root / "camera" / f"{frame_id}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(camera))
    description = root.parent / f"{root.name}.json"
    description.write_text(json.dumps({**NYU_LIKE, **changes}))
    return root, description


def contents(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
