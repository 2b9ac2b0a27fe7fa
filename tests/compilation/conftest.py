"""Fixtures for tests of compiled kernels."""

import pytest

from nimprep.compilation.folders import SAID


@pytest.fixture(autouse=True)
def _what_was_said_ends_with_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take back what a process says to its children by the environment."""
    monkeypatch.setenv(SAID, "1")
    monkeypatch.delenv(SAID)
