"""Frames as a data set serves them and as a robot has them, and networks for them."""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

import nimprep
from nimprep.networks import Network, build_network
from nimprep.torch import StoreDataset
from nimprep.torch.setups import select

CAMERA = (70.0, 75.0, 38.0, 30.0)
"""Of every frame, 64x80: fx, fy, cx, cy."""


def made(network: str, setup: Any, fusion: bool = False) -> Network:
    torch.manual_seed(0)
    channels = select(setup, fusion=fusion).channels
    return build_network(network, channels, 3, width=0.125).eval()


def served(path: Path, setup: Any, fusion: bool = False, **options: Any) -> tuple[Tensor, ...]:
    """Return what a data set has for a network: a batch of two frames."""
    data = StoreDataset(path, split=None, setup=setup, fusion=fusion, **options)
    inputs = data.__getitems__([0, 1])["inputs"]
    return inputs if isinstance(inputs, tuple) else (inputs,)


def taken(path: Path) -> dict[str, Tensor]:
    """Return the same two frames as a robot has them."""
    frames = [nimprep.open_store(path)[i] for i in range(2)]
    return {
        "rgb": torch.from_numpy(np.stack([f["rgb"] for f in frames])).permute(0, 3, 1, 2),
        "depth_m": torch.from_numpy(np.stack([f["depth"] for f in frames])),
        "intrinsics": torch.from_numpy(np.stack([f.camera.matrix for f in frames])),
    }
