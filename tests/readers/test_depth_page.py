"""The page of depth's encodings: every example is one, and means what it says."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import LayoutError
from nimprep.readers.description import DepthSource
from nimprep.readers.description_file import description_from_document

PAGE = Path(__file__).parents[2] / "docs" / "depth-encodings.md"
EXAMPLES = [
    line
    for block in re.findall(r"```json\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    for line in block.splitlines()
]


def described(line: str) -> DepthSource:
    document = {"format": "nimprep-folder", "version": "1.1", "name": "a", "rgb": "{id}.png"}
    depth = description_from_document({**document, "depth": json.loads(line)}, "a").depth
    assert depth is not None
    return depth


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 15


@pytest.mark.parametrize("line", EXAMPLES)
def test_an_example_of_the_page_is_a_description_of_depth(line: str) -> None:
    assert described(line).files


def test_carla_s_highest_number_is_1000_m() -> None:
    (carla,) = (described(line) for line in EXAMPLES if '"RGB"' in line)
    assert np.float32(carla.scale * (2**24 - 1)) == 1000


@pytest.mark.parametrize(
    ("said", "wanted"),
    [
        ({"baseline_m": 0.5}, "'values': 'disparity' beside baseline_m"),
        ({"fx": 500, "baseline_m": 0.5}, "'values': 'disparity' beside baseline_m and fx"),
        ({"bytes": "RGB", "channel": "R"}, "'bytes' or 'channel'"),
        ({"bytes": "RGB", "bytes_as": "float32"}, "four channels as float32"),
        ({"bytes_as": "float32"}, "four channels as float32"),
        ({"bytes": "RGR"}, "each channel once in 'bytes'"),
    ],
    ids=str,
)
def test_what_contradicts_itself_is_refused(said: dict[str, object], wanted: str) -> None:
    with pytest.raises(LayoutError, match=f"^a: expected {wanted} of depth, found .*; mend"):
        described(json.dumps({"files": "{id}.png", "scale_m": 0.001, **said}))


@pytest.mark.parametrize("said", [{"range_m": [20, 0.3]}, {"invalid": [-1, [7, 5.0]]}], ids=str)
def test_a_range_from_more_to_less_is_refused(said: dict[str, object]) -> None:
    with pytest.raises(LayoutError, match=r"^a: expected a range from less to more in 'depth'"):
        described(json.dumps({"files": "{id}.png", "scale_m": 0.001, **said}))


def test_invalid_values_are_those_that_float32_and_uint32_can_have() -> None:
    most = float(np.finfo(np.float32).max)
    invalid = [4294967295, 1e10, -most, [most, None]]
    found = described(json.dumps({"files": "{id}.exr", "scale_m": 1, "invalid": invalid})).invalid
    assert found == (4294967295, 1e10, -most, (most, None))
