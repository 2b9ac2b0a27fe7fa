"""Fixtures shared by every test."""

from __future__ import annotations

import os
import random
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from tests import leftovers
from tests.processes import Processes

PROJECT = Path(__file__).resolve().parent.parent

# Everywhere the same examples, for as long as they take: what fails once fails again.
settings.register_profile(
    "same", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same")


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


@pytest.fixture(autouse=True, scope="session")
def _files_are_left_to_the_cache() -> Iterator[None]:
    """Write to the disk whenever the system likes: no test cuts the power.

    Waiting for it takes most of a small conversion's time. Processes that tests start do wait, and
    that files are synced, and in which order, is tested with another in the place of `os.fsync`.
    """
    with pytest.MonkeyPatch.context() as patch:
        # It fails where fsync does: for what is not open.
        patch.setattr(os, "fsync", lambda descriptor: os.fstat(descriptor) and None)
        yield


@pytest.fixture
def processes() -> Iterator[Processes]:
    """Start processes that end with the test, however that ends."""
    with Processes() as started:
        yield started


@pytest.fixture(autouse=True)
def _same_chance_in_every_order() -> None:
    """Begin each test with the same random numbers, whichever tests came before."""
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002 - what libraries draw from
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(0)


READ_BY_NIMPREP = ("NIMPREP_", "NUMBA_", "AWS_", "AZURE_", "GOOGLE_", "PYTHON")
"""How variables begin that tell here; libraries set others as they are imported."""


@pytest.fixture(autouse=True)
def _folder_and_environment_are_left_as_they_were() -> Iterator[None]:
    def found() -> tuple[Path, dict[str, str]]:
        return Path.cwd(), {k: v for k, v in os.environ.items() if k.startswith(READ_BY_NIMPREP)}

    before = found()
    yield
    after = found()
    os.chdir(before[0])
    assert after == before


def pytest_configure(config: pytest.Config) -> None:
    """Prepare what no fixture can."""
    # A conftest's own hooks would not see the fixtures of a session.
    config.pluginmanager.register(leftovers, "leftovers")
    if sys.platform == "linux":
        from tests.hostile import counts

        # A conftest below here is not read where other processes run its tests.
        config.pluginmanager.register(counts, "counts")
    # What a shell starts in the background, and all that that starts, it makes deaf to Ctrl-C.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
