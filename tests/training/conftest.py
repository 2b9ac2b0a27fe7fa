"""Fixtures of the trainings."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.training.stores import make_store


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """Images this small take longer on several threads than on one."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store that no test changes."""
    return make_store(tmp_path_factory.mktemp("training"))
