"""Fixtures of the cases: `case("12-")` and `layout("orfd")` give a fresh dataset's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cases.cases import make_case, make_layout

Make = Callable[[str], Path]


@pytest.fixture
def case(tmp_path: Path) -> Make:
    """Write a case's dataset by the beginning of its name."""
    return lambda name: make_case(name, tmp_path / "cases")


@pytest.fixture
def layout(tmp_path: Path) -> Make:
    """Write the fake of a public layout."""
    return lambda name: make_layout(name, tmp_path / "layouts")
