"""A small store to train on, and what all trainings here have in common."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import nimprep
from nimprep.modality import MODALITIES
from tests.fakes import write_gmrp

CAMERA = (60.0, 60.0, 31.5, 31.5)
FRAMES = 8
"""4 of them train, 2 val, 2 test."""

SMALL: dict[str, Any] = {"width": 0.125, "batch": 2, "threads": 1, "device": "cpu"}


def make_store(root: Path, frames: int = FRAMES, **options: Any) -> Path:
    """Convert frames of 64x64 with every modality."""
    raw = write_gmrp(root / "raw", frames, (64, 64))
    options = {"camera": CAMERA, "modalities": tuple(MODALITIES), **options}
    return Path(nimprep.convert(raw, root / "s.zarr", **options).path)


def weights(run: Path, name: str = "last.pt") -> dict[str, Tensor]:
    """Return a run's weights."""
    key = "network" if name == "last.pt" else "state"
    found: dict[str, Tensor] = torch.load(run / name, weights_only=True)[key]
    return found


def same_tensors(one: dict[str, Tensor], other: dict[str, Tensor]) -> bool:
    """Tell whether tensors are equal to the bit."""
    return one.keys() == other.keys() and all(torch.equal(one[k], other[k]) for k in one)


def log_lines(run: Path) -> list[dict[str, Any]]:
    """Return the lines of a run's log without the times."""
    lines = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    return [{name: value for name, value in line.items() if name != "time"} for line in lines]
