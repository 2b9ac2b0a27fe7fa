"""Fixtures shared by every test."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

from tests.processes import Child, Processes, adopt_orphans, children, end_child

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


_shared: dict[Child, str] = {}
"""Processes that fixtures of more than one test started, by whom."""


class _FixturesProcesses:
    """Note which processes belong to fixtures that outlive a test."""

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Generator[None, object, object]:
        """Compare the processes before and after a fixture is made."""
        before = children() if fixturedef.scope != "function" else {}
        result = yield
        if fixturedef.scope != "function":
            for child in children().keys() - before.keys():
                _shared.setdefault(child, f"fixture {fixturedef.argname} of {request.node.nodeid}")
        return result


def pytest_configure(config: pytest.Config) -> None:
    """Let no process that a test leaves go out of sight."""
    adopt_orphans()
    # Not as a function of this file: pytest asks a folder's own hooks of what lies in it, and a
    # fixture of the whole session lies nowhere.
    config.pluginmanager.register(_FixturesProcesses())


def _end(left: dict[Child, str]) -> list[str]:
    """End processes; return what those that would not have ended were."""
    return [f"process {child[0]}: {left[child]}" for child in left if not end_child(child)]


@pytest.fixture(autouse=True)
def _no_process_is_left_by_a_test(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    left = {child: what for child, what in children().items() if child not in _shared}
    if said := _end(left):
        pytest.fail(f"{request.node.nodeid} left {'; '.join(said)}", pytrace=False)


@pytest.fixture(autouse=True, scope="session")
def _no_process_is_left_by_a_fixture() -> Iterator[None]:
    yield
    left = {child: f"{_shared.get(child)}, {what}" for child, what in children().items()}
    if said := _end(left):
        pytest.fail(f"the tests left {'; '.join(said)}", pytrace=False)
