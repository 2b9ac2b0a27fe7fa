"""Small stores to look into, each with something to see."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import nimprep
from nimprep.store.resplit import resplit
from tests.fakes import write_gmrp, write_png

CAMERA = (30.0, 31.0, 15.0, 11.0)
HEIGHT, WIDTH = 24, 32

EVIL_ID = "</script><img src=x onerror=window.hacked=1>"
EVIL_CLASS = "<b onclick=window.hacked=1>road</b>"


def convert(raw: Path, target: Path, **options: Any) -> Path:
    return nimprep.convert(raw, target, camera=CAMERA, **options).path


def gmrp_store(root: Path, frames: int = 10, **options: Any) -> Path:
    """Convert frames of noise with the fakes' one hole and saturated pixel."""
    write_gmrp(root / "raw", frames=frames)
    return convert(root / "raw", root / "store.zarr", **options)


def mixed_store(root: Path) -> Path:
    """Convert two frames of 24x32 and two of 20x28, which are padded."""
    write_gmrp(root / "raw", frames=2)
    write_gmrp(root / "small", frames=4, size=(20, 28))
    for folder in ("rgb", "depth_u16", "label", "depth_u8"):
        for name in ("000002.png", "000003.png"):
            (root / "small" / folder / name).rename(root / "raw" / folder / name)
    return convert(root / "raw", root / "store.zarr")


def photograph(seed: int) -> npt.NDArray[np.uint8]:
    """Return a smooth picture, as photographs are: unlike any of another seed."""
    cells = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(cells, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC))


class Folder:
    """Write a described dataset frame by frame; what is not given is as in every other frame."""

    def __init__(self, root: Path, class_names: tuple[str, ...] = ("other", "road", "cone")):
        self.root = root
        self.names = class_names
        self.split: dict[str, list[str]] = {"train": [], "val": [], "test": []}
        self.number = 0

    def add(
        self,
        split: str,
        frame_id: str | None = None,
        rgb: npt.NDArray[np.uint8] | None = None,
        depth_mm: npt.NDArray[np.uint16] | None = None,
        label: npt.NDArray[np.uint8] | None = None,
        scene: str | None = None,
    ) -> str:
        scene = f"{split} scene" if scene is None else scene
        frame_id = f"{scene}/{self.number:03d}" if frame_id is None else frame_id
        if depth_mm is None:
            rows = np.linspace(9000, 1500, HEIGHT)[:, None]
            depth_mm = (rows + np.arange(WIDTH) * 7).astype(np.uint16)
        if label is None:
            label = np.zeros((HEIGHT, WIDTH), np.uint8)
            label[12:], label[20:, :8] = 1, 2
        rgb = photograph(self.number) if rgb is None else rgb
        write_png(self.root / "rgb" / f"{frame_id}.png", rgb)
        write_png(self.root / "depth" / f"{frame_id}.png", depth_mm)
        write_png(self.root / "label" / f"{frame_id}.png", label)
        if split in self.split:
            self.split[split].append(frame_id)
        self.number += 1
        return frame_id

    def store(self) -> Path:
        """Convert, and split as the frames were added."""
        colors = [(0, 0, 0), (0, 200, 0), (220, 0, 0)]
        description = {
            "format": "nimprep-folder",
            "version": "1.1",
            "name": "planted",
            "split": False,
            "rgb": "rgb/{id}.png",
            "depth": {"files": "depth/{id}.png", "scale_m": 0.001},
            "label": {"files": "label/{id}.png"},
            "classes": [
                {"id": i, "name": name, "color": colors[i]} for i, name in enumerate(self.names)
            ],
            "group": "{group}/*",
        }
        path = self.root.parent / "description.json"
        path.write_text(json.dumps(description))
        store = convert(self.root, self.root.parent / "store.zarr", description=path)
        document = {"format": "nimprep-split", "version": "1.0", **self.split}
        splits = self.root.parent / "splits.json"
        splits.write_text(json.dumps(document))
        resplit(store, split_file=splits)
        return store
