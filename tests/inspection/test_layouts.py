"""The public layouts are told for what they are, in folders whose names give nothing away."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nimprep.inspection.inspection import inspect_source
from nimprep.schema import schema_problems

pytestmark = pytest.mark.usefixtures("unknown")

CARLA = 1000 / (256**3 - 1)

ENCODINGS: dict[str, dict[str, Any]] = {
    "orfd": {"scale_m": 1 / 256},
    "cityscapes": {"values": "disparity", "scale_px": 1 / 256, "offset_px": -1 / 256},
    "kitti_semantics": {"values": "disparity", "scale_px": 1 / 256},
    "vkitti2": {"scale_m": 0.01, "invalid": [0, 65535]},
    "r2d": {"scale_m": CARLA, "bytes": "RGB", "invalid": [0, 16777215]},
    "nyuv2_nicr": {"scale_m": 0.001},
    "sunrgbd": {"scale_m": 0.001, "rotate_right": 3},
    "tum": {"scale_m": 1 / 5000, "invalid": [0, 65535]},
    "scannet": {"scale_m": 0.001},
    "drno": {"scale_m": 0.001},
}


@pytest.mark.parametrize("name", ENCODINGS)
def test_depth_has_the_encoding_that_it_was_written_in(
    layout: Callable[[str], Path], name: str
) -> None:
    found = inspect_source(layout(name)).to_dict()
    assert not schema_problems(found, "inspection")
    assert found["problems"] == []
    best = dict(found["depth"][0]["encodings"][0]["depth"])
    assert "sparse" not in best.pop("files")
    assert best == ENCODINGS[name]


@pytest.mark.parametrize("name", ["nyuv2_dformer", "mfnet", "rellis"])
def test_what_is_no_depth_gets_no_encoding(layout: Callable[[str], Path], name: str) -> None:
    found = inspect_source(layout(name)).to_dict()
    assert found["depth"] == []
    kinds = {row["kind"] for row in found["patterns"]}
    assert (
        kinds
        >= {
            "nyuv2_dformer": {"colour", "picture of depth", "hha", "label"},
            "mfnet": {"colour and thermal", "label"},
            "rellis": {"colour", "label", "points", "camera"},
        }[name]
    )


COUNTS = {
    "orfd": {"training": 4, "validation": 2, "testing": 2},
    "cityscapes": {"train": 4, "val": 2, "test": 2},
    "nyuv2_nicr": {"train": 3, "test": 1},
    "r2d": {"training": 4, "validation": 2, "testing": 2},
}


@pytest.mark.parametrize("name", COUNTS)
def test_splits_are_counted_by_folder(layout: Callable[[str], Path], name: str) -> None:
    assert inspect_source(layout(name)).to_dict()["splits"] == COUNTS[name]


def test_a_matlab_file_of_many_frames_is_told_array_by_array(layout: Callable[[str], Path]) -> None:
    pytest.importorskip("h5py")
    found = inspect_source(layout("nyuv2_mat")).to_dict()
    assert not schema_problems(found, "inspection")
    rows = {row["key"]: row for row in found["patterns"]}
    assert {key: row["kind"] for key, row in rows.items()} == {
        "images": "colour",
        "depths": "depth",
        "rawDepths": "depth",
        "labels": "label",
        "instances": "instances",
    }
    assert {row["count"] for row in rows.values()} == {4}
    best = found["depth"][0]["encodings"][0]["depth"]
    assert best == {
        "files": "nyu_depth_v2_labeled.mat",
        "key": "depths",
        "axes": "NWH",
        "scale_m": 1.0,
    }
    assert found["description"]["rgb"] == {
        "files": "nyu_depth_v2_labeled.mat",
        "key": "images",
        "axes": "NCWH",
    }
