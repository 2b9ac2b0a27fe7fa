"""Fixtures for tests of conversions."""

import os
from collections.abc import Iterator

import pytest

from tests.conversion.mortal import Mortals
from tests.processes import Processes


@pytest.fixture
def unsynced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave files to the cache: no test cuts the power, and waiting takes most of the time."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


@pytest.fixture(scope="session")
def mortal_server() -> Iterator[Mortals]:
    """Start what starts processes that can be killed."""
    with Processes() as processes:
        yield Mortals(processes)


@pytest.fixture
def mortals(mortal_server: Mortals) -> Iterator[Mortals]:
    """Return what starts processes that can be killed; one that is left is."""
    yield mortal_server
    mortal_server.end()
