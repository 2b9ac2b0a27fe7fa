"""Fixtures for tests of conversions."""

from collections.abc import Iterator

import pytest

from tests.conversion.mortal import Mortals
from tests.processes import Processes


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
