"""Cases 23 and 24: what systems leave in folders, and endings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from nimprep.errors import LayoutError
from nimprep.readers import ReaderOptions, open_reader


def test_a_backslash_in_a_pattern_is_refused_by_name(case: Callable[[str], Path]) -> None:
    root = case("24-")
    with pytest.raises(LayoutError, match=r"found a backslash in 'rgb.*jpg'; use / on every"):
        open_reader(root, ReaderOptions(description=root / "back.json"))


def test_endings_of_any_kind_and_case_pair_with_a_star(case: Callable[[str], Path]) -> None:
    root = case("24-")
    reader = open_reader(root, ReaderOptions(description=root / "star.json"))
    assert reader.ids == tuple(f"frame {i} é" for i in range(4))
    assert [reader.sources(i)[0].suffix for i in reader.ids] == [".JPG", ".jpeg", ".png", ".jpg"]
