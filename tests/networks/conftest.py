"""A store that the tests here look at."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

import nimprep
from nimprep.modality import MODALITIES
from tests.fakes import write_gmrp
from tests.networks.frames import CAMERA


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> Iterator[None]:
    """Networks this small take longer on several threads than on one."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("store")
    raw = write_gmrp(root / "raw", frames=6, size=(64, 80))
    return nimprep.convert(raw, root / "a.zarr", camera=CAMERA, modalities=tuple(MODALITIES)).path
