"""Case 11 and TUM's layout: colour and depth that have times of their own."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nimprep.errors import LayoutError
from nimprep.readers import Reader, ReaderOptions, open_reader

TUM: dict[str, Any] = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "tum",
    "rgb": "rgb/{id}.png",
    "depth": {"files": "depth/{id}.png", "scale_m": 0.0002},
    "camera": {"fx": 100, "fy": 100, "cx": 48, "cy": 32},
}
WAYS: dict[str, dict[str, Any]] = {
    "times in names": {"by": "{id}"},
    "lists": {"lists": {"rgb": "rgb.txt", "depth": "depth.txt"}},
    "pairs": {"pairs": "associations.txt", "columns": ["", "rgb", "", "depth"]},
}


def opened(root: Path, match: dict[str, Any], **changes: Any) -> Reader:
    path = root / "description.json"
    path.write_text(json.dumps({**TUM, "match": match, **changes}))
    return open_reader(root, ReaderOptions(description=path))


def partners(reader: Reader) -> list[tuple[str, str]]:
    return [(a.stem, b.stem) for a, b in map(reader.sources, reader.ids)]


@pytest.mark.parametrize("way", ["times in names", "pairs"])
def test_case_11_is_paired_by_time(case: Callable[[str], Path], way: str) -> None:
    root = case("11-")
    rgb = [f"{1305031102.175304 + i / 30:.6f}" for i in range(5)]
    depth = [f"{1305031102.160407 + i / 30.02:.6f}" for i in range(5)]
    reader = opened(root, WAYS[way])
    assert reader.ids == tuple(rgb)
    assert partners(reader) == list(zip(rgb, depth, strict=True))


@pytest.mark.parametrize("way", ["times in names", "lists"])
def test_tum_is_paired_by_its_lists_or_names(layout: Callable[[str], Path], way: str) -> None:
    root = layout("tum")
    reader = opened(root, WAYS[way])
    assert [round(float(a) - float(b), 6) for a, b in partners(reader)] == [0.014897] * 4


def test_what_has_no_partner_is_left_out_and_said(layout: Callable[[str], Path]) -> None:
    root = layout("tum")
    for path in sorted((root / "depth").iterdir())[1:3]:
        path.unlink()
    reader = opened(root, {"by": "{id}"})
    assert len(reader.ids) == 2
    (note,) = [note for note in reader.info.notes if "left out" in note]
    assert note.startswith("2 of 4 colour images have no depth within 0.02 s, first '1305031102.2")
    with pytest.raises(LayoutError, match=r"4 of 4 colour images have no depth within 0\.001 s"):
        opened(root, {"by": "{id}", "tolerance_s": 0.001})
    depth = {**TUM["depth"], "missing": "none"}
    reader = opened(root, {"by": "{id}"}, depth=depth)
    assert len(reader.ids) == 4


def test_a_name_that_is_no_time_is_refused(layout: Callable[[str], Path]) -> None:
    root = layout("tum")
    next((root / "depth").iterdir()).rename(root / "depth/first.png")
    with pytest.raises(LayoutError, match=r"first.png: expected a time stamp in place of \{id\}"):
        opened(root, {"by": "{id}"})
