"""Cases 23 and 24: what systems leave in folders, and endings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import LayoutError
from nimprep.readers import ReaderOptions, open_reader
from tests.cases.cases import case_scene, nimprep_run


def test_a_backslash_in_a_pattern_is_refused_by_name(case: Callable[[str], Path]) -> None:
    root = case("24-")
    with pytest.raises(LayoutError, match=r"found a backslash in 'rgb.*jpg'; use / on every"):
        open_reader(root, ReaderOptions(description=root / "back.json"))


def test_endings_of_any_kind_and_case_pair_with_a_star(case: Callable[[str], Path]) -> None:
    root = case("24-")
    reader = open_reader(root, ReaderOptions(description=root / "star.json"))
    assert reader.ids == tuple(f"frame {i} é" for i in range(4))
    assert [reader.sources(i)[0].suffix for i in reader.ids] == [".JPG", ".jpeg", ".png", ".jpg"]


def test_what_systems_leave_behind_is_passed_over_and_a_copy_is_named(
    case: Callable[[str], Path], tmp_path: Path
) -> None:
    root = case("23-")
    done = nimprep_run("convert", root, tmp_path / "s.zarr")
    assert done.exit_code == 1
    assert "depth_u16/000000 (1).png: expected depth of frame '000000 (1)'" in done.stderr
    (root / "rgb/000000 (1).png").unlink()
    store = nimprep.convert(root, tmp_path / "s.zarr")
    assert store.ids == tuple(f"{i:06d}" for i in range(4))
    for seed, frame in enumerate(store):
        rgb, depth_m, label = case_scene(seed)
        assert np.array_equal(frame["rgb"], rgb)
        assert np.abs(frame["depth"] - depth_m).max() <= 0.000501
        assert np.array_equal(frame["label"], label)
