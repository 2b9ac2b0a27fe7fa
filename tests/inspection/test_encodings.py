"""Depth of other public kinds is told by its values, and by names where those cannot tell."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep.inspection.inspection import inspect_source
from nimprep.schema import schema_problems
from tests.inspection import scenes


def _rounded(value: Any) -> Any:
    return float(f"{value:.9g}") if isinstance(value, float) else value


@pytest.mark.parametrize(
    ("write", "expected"),
    scenes.KINDS.items(),
    ids=[write.__name__ for write in scenes.KINDS],
)
def test_depth_has_the_encoding_that_it_was_written_in(
    tmp_path: Path, write: Callable[[Path], None], expected: dict[str, Any]
) -> None:
    write(tmp_path / "raw")
    found = inspect_source(tmp_path / "raw").to_dict()
    assert not schema_problems(found, "inspection")
    best = dict(found["depth"][0]["encodings"][0]["depth"])
    best.pop("files")
    assert {name: _rounded(value) for name, value in best.items()} == {
        name: _rounded(value) for name, value in expected.items()
    }
    assert found["depth"][0]["encodings"][0]["reasons"]
    assert not schema_problems(found["description"], "folder")
    described = found["description"]["depth"]
    assert {name: described[name] for name in expected} == best


@pytest.mark.parametrize(
    ("name", "scale"),
    [("orfd", 1 / 256), ("gmrp", 0.001), ("kitti_road", 0.001), ("nyu_hha", 0.0001)],
)
def test_real_depth_is_told(reference_data: Path, name: str, scale: float) -> None:
    found = inspect_source(reference_data / name).to_dict()
    assert found["depth"][0]["encodings"][0]["depth"]["scale_m"] == scale


def test_real_scans_are_points_and_no_depth(reference_data: Path) -> None:
    found = inspect_source(reference_data / "rellis").to_dict()
    kinds = {row["files"].rpartition(".")[2]: row["kind"] for row in found["patterns"]}
    assert (kinds["bin"], kinds["jpg"], kinds["png"]) == ("points", "colour", "label")
    assert found["depth"] == []


@pytest.mark.parametrize("scale", [1 / 256, 1 / 1000, 1 / 5000])
def test_a_stated_scale_beats_what_is_common(tmp_path: Path, scale: float) -> None:
    for k in range(3):
        color, depth = scenes.street(k, closer=4)
        scenes.save(tmp_path / f"rgb/{k}.png", color)
        scenes.save(tmp_path / f"depth/{k}.png", scenes.units(depth, 1 / scale))
    scenes.note(
        tmp_path / "camera.json",
        f'{{"fx": 80, "fy": 80, "cx": 47, "cy": 20, "depth_scale": {1 / scale}}}',
    )
    best = inspect_source(tmp_path).to_dict()["depth"][0]["encodings"][0]
    assert best["depth"]["scale_m"] == pytest.approx(scale)
    assert any("camera.json states" in reason for reason in best["reasons"])


def test_no_encoding_where_no_pixel_has_depth(tmp_path: Path) -> None:
    scenes.save(tmp_path / "rgb/0.png", scenes.street(0)[0])
    scenes.save(tmp_path / "depth/0.png", np.zeros((24, 32), np.uint16))
    found = inspect_source(tmp_path).to_dict()
    assert [depth["encodings"] for depth in found["depth"] or [{"encodings": []}]] == [[]]
