"""The networks equal public implementations filled with the same weights, to the digit."""

import importlib.util
import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from nimprep.networks import Network, build_network, count_parameters
from nimprep.networks.depthaware import DepthAwareCNN

SINGLE = ("fcn8s", "segnet", "unet", "deeplabv3plus", "denseaspp", "dupsampling", "espnet", "gscnn")
FUSION: dict[str, dict[str, Any]] = {
    "mfnet_1": {"name": "mfnet", "inputs": (3, 1)},
    "rtfnet18_1": {"name": "rtfnet18", "inputs": (3, 1)},
    "rtfnet18_3": {"name": "rtfnet18", "inputs": (3, 3)},
    "rtfnet50_1": {"name": "rtfnet50", "inputs": (3, 1)},
    "nim_rtfnet18_kitti2": {"name": "rtfnet18", "inputs": (3, 3), "classes": 2},
    "fusenet_sf5_1": {"name": "fusenet", "inputs": (3, 1)},
    "fusenet_sf5_3": {"name": "fusenet", "inputs": (3, 3)},
    "fusenet_sf1_1": {"name": "fusenet", "inputs": (3, 1), "stages": 1},
    "depthaware_1": {"name": "depthaware", "inputs": (3, 1)},
}
EXACT = 1e-9
"""Of the largest output, where the golden is float64."""

ROUNDED = 2e-5
"""Of the standard deviation, where it is stored as float32."""


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> None:
    """Let networks of full width have every thread."""


@pytest.fixture(scope="module")
def folder(reference_data: Path) -> Path:
    return reference_data.parent / "networks"


@pytest.fixture(scope="module")
def filling(folder: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("filling", folder / "fill.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def index(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "golden" / "INDEX.json").read_text())
    return found


def golden(folder: Path, name: str) -> dict[str, Tensor]:
    with np.load(folder / "golden" / f"{name}.npz") as file:
        return {key: torch.from_numpy(np.asarray(file[key])) for key in file.files}


def apart(found: Tensor, wanted: Tensor) -> float:
    """Return the largest difference, by the largest value or, of float32, by the deviation."""
    assert found.shape == wanted.shape
    scale = wanted.std() if wanted.dtype == torch.float32 else wanted.abs().max()
    return float((found - wanted).abs().max() / scale)


def ready(filling: ModuleType, network: Network, recipe: str) -> Network:
    filled: Network = filling.fill(network, recipe)
    return filled.double().eval()


def canny_of(height: int, width: int) -> Tensor:
    """Return the edge map the goldens were made with: every eleventh pixel, rows shifted by 6."""
    v, u = np.mgrid[:height, :width]
    return torch.from_numpy((6 * v + u) % 11 == 0).double()[None, None] * 255


def test_every_golden_is_looked_at(index: dict[str, Any]) -> None:
    assert index.keys() == {*SINGLE, *FUSION, "depthaware_1_paperpool"}


@pytest.mark.parametrize("name", SINGLE)
def test_a_network_of_one_image_is_the_published_one(
    name: str, folder: Path, filling: ModuleType, index: dict[str, Any]
) -> None:
    wanted = golden(folder, name)
    network = build_network(name, 3, 3)
    assert count_parameters(network) == int(wanted["n_params"]) == index[name]["n_params"]
    ready(filling, network, "single")
    with torch.no_grad():
        x = filling.first_input(3).double()
        extra = [canny_of(96, 160)] if name == "gscnn" else []
        outputs = network.outputs(x, *extra)
        assert torch.equal(outputs.logits, network(x, *extra))
        assert apart(outputs.logits, wanted["output64"]) <= EXACT
        for key, field in (("auxiliary64", "auxiliary"), ("edge64", "edge")):
            if key in wanted:
                assert apart(getattr(outputs, field), wanted[key]) <= EXACT
        if (size := index[name]["big_input"]) is not None:
            step = int(wanted["output_big_stride"])
            extra = [canny_of(*size[2:])] if name == "gscnn" else []
            big = network(filling.first_input(3, *size[2:]).double(), *extra)
            assert apart(big[..., ::step, ::step], wanted["output_big"]) <= ROUNDED


# SegNet's is a float32 run, in which near-ties of pooling fell otherwise.
@pytest.mark.parametrize("name", ["unet", "deeplabv3plus", "denseaspp", "dupsampling", "espnet"])
def test_a_network_of_one_channel_is_the_published_one(
    name: str, folder: Path, filling: ModuleType
) -> None:
    wanted = golden(folder, name)
    network = ready(filling, build_network(name, 1, 3), "single")
    step = int(wanted["output_1ch_stride"])
    with torch.no_grad():
        found = network(filling.first_input(1).double())[..., ::step, ::step]
    assert apart(found, wanted["output_1ch"]) <= ROUNDED


@pytest.mark.parametrize("name", FUSION)
def test_a_network_that_fuses_is_the_published_one(
    name: str, folder: Path, filling: ModuleType
) -> None:
    wanted = golden(folder, name)
    how = {"classes": 3, **FUSION[name]}
    network = build_network(**how)
    assert count_parameters(network) == int(wanted["n_params"])
    ready(filling, network, "fusion")
    x, y = filling.first_input(3).double(), filling.second_input(how["inputs"][1]).double()
    with torch.no_grad():
        logits = network(x, y)
        if isinstance(network, DepthAwareCNN):
            assert apart(network.scores(x, y), wanted["output"]) <= ROUNDED
            wanted["output"] = wanted["output_up_align0"]
        assert apart(logits[..., ::4, ::4], wanted["output"]) <= ROUNDED


def test_the_depth_aware_pool_can_be_the_papers(folder: Path, filling: ModuleType) -> None:
    wanted = golden(folder, "depthaware_1_paperpool")
    network = ready(filling, DepthAwareCNN((3, 1), 3, authors_pool=False), "fusion")
    with torch.no_grad():
        found = network.scores(filling.first_input(3).double(), filling.second_input(1).double())
    assert apart(found, wanted["output"]) <= ROUNDED
