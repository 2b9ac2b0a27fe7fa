"""Fixtures for tests of conversions."""

import os

import pytest


@pytest.fixture
def unsynced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave files to the cache: no test cuts the power, and waiting takes most of the time."""
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
