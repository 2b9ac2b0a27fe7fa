"""Cases 01, 04, 08, 17, 28, 30 and 39: what can be read wrongly without an error is doubted."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import pytest

import nimprep
from nimprep.errors import DecodeError, DoubtWarning
from tests.fakes import write_png

Case = Callable[[str], Path]


def doubts_of(root: Path, description: str | None = None, **options: Any) -> dict[str, str]:
    """Convert a case's dataset; return its doubts, each of which was warned of, by kind."""
    if description is not None:
        options["description"] = root / description
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        store = nimprep.convert(root, root.parent / "out.zarr", **options)
    found = {doubt["kind"]: doubt["text"] for doubt in store.about.doubts}
    lines = [str(warning.message) for warning in said if warning.category is DoubtWarning]
    assert len(lines) == len(found)
    assert all(text in line for text, line in zip(found.values(), lines, strict=True))
    return found


def described(root: Path, description: str, **depth: Any) -> str:
    """Write a case's description with more said of depth; return its name."""
    document = json.loads((root / description).read_text())
    document["version"] = "1.1"
    document["depth"] |= depth
    (root / "described.json").write_text(json.dumps(document))
    return "described.json"


@pytest.mark.parametrize("description", ["d.json", "d8000.json"])
def test_rotated_bits_are_doubted_as_millimetres_and_at_8000_to_a_metre(
    case: Case, description: str
) -> None:
    found = doubts_of(case("01-"), description)
    assert 'SUN RGB-D); if so, give "rotate_right": 3' in found.pop("rotated-bits")
    # As millimetres, the camera is 8 times as high as it is.
    assert found.keys() == ({"camera-height"} if description == "d.json" else set())


def test_rotated_bits_are_not_doubted_once_they_are_turned_back(case: Case) -> None:
    root = case("01-")
    assert doubts_of(root, described(root, "d.json", rotate_right=3)) == {}


def test_swapped_bytes_are_refused_whatever_the_scale(case: Case) -> None:
    root = case("04-")
    for options in ({}, {"depth_scale": 0.001}):
        with pytest.raises(DecodeError, match=r'0\.png: .* times as smooth .*"byte_order"'):
            doubts_of(root, "d.json", **options)
    assert doubts_of(root, described(root, "d.json", byte_order="swapped")) == {}


def test_bytes_that_a_description_swaps_wrongly_are_refused_too(case: Case) -> None:
    root = case("39-")
    with pytest.raises(DecodeError, match=r'leave "byte_order" out of the description\b'):
        doubts_of(root, described(root, "d.json", byte_order="swapped"))


@pytest.mark.parametrize("description", ["city.json", "kitti.json"])
def test_disparity_read_as_depth_is_doubted(case: Case, description: str) -> None:
    found = doubts_of(case("08-"), description)
    assert found.keys() == {"grows-downwards"}
    assert "lower half 1.00)" in found["grows-downwards"]
    assert '"values": "disparity"' in found["grows-downwards"]


def test_disparity_is_doubted_by_its_name_unless_it_is_described_as_disparity(case: Case) -> None:
    root = case("08-")
    (root / "kitti").rename(root / "disp_noc_0")
    files = "disp_noc_0/{id}.png"
    found = doubts_of(root, described(root, "kitti.json", files=files))
    assert found.keys() == {"disparity-name", "grows-downwards"}
    document = json.loads((root / "described.json").read_text())
    document["depth"] = {"files": files, "values": "disparity", "scale_px": 1 / 256}
    (root / "described.json").write_text(json.dumps(document))
    assert doubts_of(root, "described.json", overwrite=True) == {}


def test_ids_counted_from_1_are_doubted_where_they_are_classes_too(case: Case) -> None:
    root = case("17-")
    for path in (root / "b" / "label").iterdir():
        write_png(path, cv2.imread(str(path), cv2.IMREAD_UNCHANGED).clip(1, 2))
    found = doubts_of(root, "b.json")
    assert found.keys() == {"class-missing"}
    assert "background (0); if ids are counted from 1, map them" in found["class-missing"]


def test_lidar_is_doubted_unless_it_is_filled(case: Case) -> None:
    root = case("28-")
    found = doubts_of(root, "d.json")
    assert found.keys() == {"sparse"}
    assert found["sparse"].endswith("; convert with --fill linear")
    assert doubts_of(root, "d.json", fill="linear", overwrite=True) == {}


def test_the_share_of_depth_beyond_the_range_is_said(case: Case) -> None:
    found = doubts_of(case("39-"), "d.json", depth_unit="mm")
    assert found.keys() == {"beyond-range"}
    # By the case's own count: 50.0 of 68.8 % are left.
    assert found["beyond-range"].startswith("27% of the depth lies beyond 65.535 m")


def test_far_depth_is_stored_as_it_is_in_its_own_unit(case: Case) -> None:
    root = case("39-")
    assert doubts_of(root, "d.json") == {}
    store = nimprep.open_store(root.parent / "out.zarr")
    assert store.about.depth_lost is None
    for frame in store:
        raw = cv2.imread(str(root / f"depth/{frame.id}.png"), cv2.IMREAD_UNCHANGED)
        raw[raw == 65535] = 0
        assert frame.depth_m is not None
        assert (frame.depth_m > 65.535).mean() > 0.15
        assert abs(frame.depth_m - raw / 100).max() < 1e-4


def test_cameras_in_other_numbers_and_of_other_images_are_doubted(case: Case) -> None:
    root = case("30-")
    assert doubts_of(root, camera=root / "cams" / "open3d.json") == {}
    found = doubts_of(root, camera=root / "cams" / "normalised.json", overwrite=True)
    assert found.keys() == {"normalised-camera"}
    found = doubts_of(root, camera=root / "cams" / "half.json", overwrite=True)
    assert found.keys() >= {"principal-point", "field-of-view"}
