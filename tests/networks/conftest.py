"""A store that the tests here look at."""

from pathlib import Path

import pytest

import nimprep
from nimprep.modality import MODALITIES
from tests.fakes import write_gmrp
from tests.networks.frames import CAMERA


@pytest.fixture(scope="session")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("store")
    raw = write_gmrp(root / "raw", frames=6, size=(64, 80))
    return nimprep.convert(raw, root / "a.zarr", camera=CAMERA, modalities=tuple(MODALITIES)).path
