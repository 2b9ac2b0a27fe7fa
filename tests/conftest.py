"""Fixtures shared by every test."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import leftovers
from tests.processes import Processes

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Folder of real frames and reference outputs; CI requires it, elsewhere it may be absent."""
    folder = Path(os.environ.get("NIMPREP_REFERENCE_DATA", PROJECT.parent / "shared" / "data"))
    if not (folder / "README.md").is_file():
        reason = f"no reference data at {folder}; set NIMPREP_REFERENCE_DATA to its folder"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture
def processes() -> Iterator[Processes]:
    """Start processes that end with the test, however that ends."""
    with Processes() as started:
        yield started


def pytest_configure(config: pytest.Config) -> None:
    """See every fixture made: a conftest's own hooks do not see those of a session."""
    config.pluginmanager.register(leftovers, "leftovers")
