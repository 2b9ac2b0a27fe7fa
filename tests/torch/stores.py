"""Small stores for the tests here."""

from __future__ import annotations

from pathlib import Path

import nimprep
from nimprep.frame import MODALITIES
from tests.fakes import write_gmrp

FRAMES = 10

CAMERA = (30.0, 31.0, 15.0, 11.0)
"""Of every frame: fx, fy, cx, cy."""


def make_store(root: Path, **changes: object) -> Path:
    """Convert `FRAMES` frames, noise in colour and depth, one hole; every modality by default."""
    raw = root / "raw"
    if not raw.exists():
        write_gmrp(raw, frames=FRAMES)
    target = root / f"{len(list(root.iterdir()))}.zarr"
    options = {"camera": CAMERA, "modalities": MODALITIES, **changes}
    return nimprep.convert(raw, target, **options).path


def make_mixed_store(root: Path) -> Path:
    """Convert two frames of 24x32 and two of 20x28."""
    raw, small = root / "mixed", root / "small"
    write_gmrp(raw, frames=2)
    write_gmrp(small, frames=4, size=(20, 28))
    for folder in ("rgb", "depth_u16", "label", "depth_u8"):
        for name in ("000002.png", "000003.png"):
            (small / folder / name).rename(raw / folder / name)
    return nimprep.convert(raw, root / "mixed.zarr", camera=CAMERA, modalities=MODALITIES).path
