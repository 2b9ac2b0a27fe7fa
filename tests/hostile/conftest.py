"""Limits around every test here."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import nimprep
from tests.fakes import write_gmrp
from tests.hostile.fuzzing import limited_memory

CAMERA = '{"fx": 30, "fy": 31, "cx": 15, "cy": 11}'


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave the tests out where there is no /proc and no RLIMIT_AS to rely on."""
    if sys.platform != "linux":
        for item in items:
            if Path(__file__).parent in item.path.parents:
                item.add_marker(pytest.mark.skip(reason="limits are set by Linux's means"))


@pytest.fixture(autouse=True)
def memory() -> Iterator[None]:
    """Let no test here take a gigabyte."""
    with limited_memory():
        yield


@pytest.fixture(scope="session")
def made_store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a small store of every modality, in two shards."""
    folder = tmp_path_factory.mktemp("hostile")
    root = write_gmrp(folder / "gmrp", frames=3)
    (root / "camera.json").write_text(CAMERA)
    nimprep.convert(root, folder / "s.zarr", shard_length=2)
    return folder / "s.zarr"
