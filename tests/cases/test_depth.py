"""Cases 01 to 04, 06 to 08, 25, 43 and 47: what depth's numbers mean, and what holds them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError
from nimprep.images import read_plane
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader

Case = Callable[[str], Path]

FOCAL, BASELINE_M = 110, 0.54


def reader_of(root: Path, description: str, **depth: Any) -> Reader:
    """Return the reader of a case's description, its depth described anew where that is given."""
    document = json.loads((root / description).read_text())
    if depth:
        document["version"] = "1.1"
        document["depth"] = depth
    path = root / "described.json"
    path.write_text(json.dumps(document))
    return open_reader(root, ReaderOptions(description=path))


def depths(reader: Reader) -> list[np.ndarray]:
    assert len(reader.ids) == 4
    found = [reader.read(i).depth_m for i in reader.ids]
    return [depth for depth in found if depth is not None]


def truths(root: Path) -> list[np.ndarray]:
    return [np.load(root / f"true_{i}.npy") for i in range(4)]


def test_sunrgbd_s_rotated_bits_are_turned_back(case: Case) -> None:
    root = case("01-")
    described: dict[str, Any] = {"files": "depth/{id}.png", "scale_m": 0.001, "rotate_right": 3}
    found, true = depths(reader_of(root, "d.json", **described)), truths(root)
    for depth, wanted in zip(found, true, strict=True):
        assert np.abs(depth - wanted).max() <= 0.000501
    # Its own tools take what is beyond 8 m as 8 m: the frame that looks 12 m far.
    clipped = depths(reader_of(root, "d.json", **described, clip_m=8))
    assert found[3].max() > 11
    assert clipped[3].max() == 8
    assert np.array_equal(clipped[3], np.minimum(found[3], 8))


def test_nan_and_infinity_of_either_sign_are_no_depth(case: Case) -> None:
    root = case("02-")
    for i, depth in enumerate(depths(reader_of(root, "d.json"))):
        raw = np.load(root / f"depth/{i}.npy")
        assert (~np.isfinite(raw)).sum() > 1000
        assert np.array_equal(depth > 0, np.isfinite(raw))
        assert np.array_equal(depth[depth > 0], raw[depth > 0])


def test_a_finite_negative_depth_stays_an_error(case: Case) -> None:
    root = case("02-")
    raw = np.load(root / "depth/0.npy")
    raw[50, 60] = -0.5
    np.save(root / "depth/0.npy", raw)
    with pytest.raises(DecodeError, match=r"found -0.5.* or name what means none as 'invalid'"):
        reader_of(root, "d.json").read("0")
    described = {"files": "depth/{id}.npy", "scale_m": 1, "invalid": [[None, 0]]}
    depth = reader_of(root, "d.json", **described).read("0").depth_m
    assert depth is not None
    assert depth[50, 60] == 0


@pytest.mark.parametrize("kind", ["i16", "i64", "u32", "bin"])
def test_whole_numbers_of_any_kind_and_bare_ones_are_millimetres(case: Case, kind: str) -> None:
    root = case("03-")
    changed: dict[str, Any] = {}
    if kind == "bin":
        raw = {"dtype": "uint16", "width": 128, "height": 96}
        changed = {"files": "bin/{id}.bin", "scale_m": 0.001, "raw": raw}
    reader = reader_of(root, f"{kind}.json", **changed)
    assert reader.shape("0") == (96, 128)
    for i, depth in enumerate(depths(reader)):
        wanted = np.fromfile(root / f"bin/{i}.bin", "<u2").reshape(96, 128) / np.float32(1000)
        assert np.array_equal(depth, wanted)


def test_bare_numbers_that_are_not_described_are_refused(case: Case) -> None:
    with pytest.raises(DecodeError, match=r"found 24576 bytes that are none; .*'raw'"):
        reader_of(case("03-"), "bin.json").read("0")


def test_swapped_bytes_are_swapped_back(case: Case) -> None:
    root = case("04-")
    described = {"files": "depth/{id}.png", "scale_m": 0.001, "byte_order": "swapped"}
    for depth, wanted in zip(
        depths(reader_of(root, "d.json", **described)), truths(root), strict=True
    ):
        assert np.abs(depth - wanted).max() <= 0.000501


def test_a_colour_map_of_depth_is_refused_and_the_ways_out_named(case: Case) -> None:
    with pytest.raises(
        DecodeError, match=r"3 channels of uint8; use .* raw depth .*'bytes': 'RGB'"
    ):
        reader_of(case("06-"), "jet.json").read("0")


def test_three_equal_channels_of_16_bits_are_one(case: Case) -> None:
    for depth in depths(reader_of(case("06-"), "three.json")):
        assert depth.shape == (96, 128)
        assert 7 < np.median(depth) < 10


def test_carla_s_three_bytes_are_metres(case: Case) -> None:
    root = case("07-")
    with pytest.raises(DecodeError, match="'bytes': 'RGB' as CARLA has it"):
        reader_of(root, "d.json").read("0")
    described = {"files": "depth/{id}.png", "scale_m": 1000 / (2**24 - 1), "bytes": "RGB"}
    for i, depth in enumerate(depths(reader_of(root, "d.json", **described))):
        rgba = read_plane(root / f"depth/{i}.png").astype(np.float64)
        wanted = 1000 * (rgba[..., :3] @ [1, 256, 65536]) / (256**3 - 1)
        assert np.allclose(depth, wanted, rtol=1e-7, atol=0)
        assert 7 < np.median(depth) < 10


@pytest.mark.parametrize(("folder", "offset"), [("city", -1 / 256), ("kitti", 0.0)])
def test_disparity_becomes_depth_by_the_camera_s_baseline(
    case: Case, folder: str, offset: float
) -> None:
    root = case("08-")
    described: dict[str, Any] = {
        "files": folder + "/{id}.png",
        "values": "disparity",
        "scale_px": 1 / 256,
        "offset_px": offset,
    }
    # Half of 1/256 pixel, at the 9 m of the wall.
    most = 0.5 / 256 * 12**2 / (FOCAL * BASELINE_M)
    for depth, wanted in zip(
        depths(reader_of(root, f"{folder}.json", **described)), truths(root), strict=True
    ):
        assert np.abs(depth - wanted).max() < most
    described |= {"baseline_m": 2 * BASELINE_M, "fx": FOCAL / 2}
    for depth, wanted in zip(
        depths(reader_of(root, f"{folder}.json", **described)), truths(root), strict=True
    ):
        assert np.abs(depth - wanted).max() < most


@pytest.mark.parametrize("kind", ["le", "be"])
def test_pfm_s_last_row_comes_first_in_either_byte_order(case: Case, kind: str) -> None:
    root = case("25-")
    found = depths(reader_of(root, f"{kind}.json"))
    for depth, wanted in zip(found, truths(root), strict=True):
        assert np.array_equal(depth, wanted.astype(np.float32))


def test_a_pfm_header_with_crlf_is_named(case: Case) -> None:
    with pytest.raises(DecodeError, match="header that ends in CR LF; write"):
        reader_of(case("25-"), "crlf.json").read("0")


@pytest.mark.parametrize(("kind", "found"), [("gif", "a GIF"), ("heic", "a HEIC")])
def test_formats_that_are_not_read_are_named(case: Case, kind: str, found: str) -> None:
    root = case("43-")
    reader = open_reader(root / kind, ReaderOptions(description=root / kind / "d.json"))
    with pytest.raises(DecodeError, match=f"found {found}, which is not read here; convert it"):
        reader.read("0")


@pytest.mark.parametrize(
    ("description", "wanted"),
    [("k1000", "give metres per unit: 0.001, not 1000"), ("k1", "give the right one with")],
)
def test_a_scale_in_units_per_metre_is_told(case: Case, description: str, wanted: str) -> None:
    root = case("47-")
    with pytest.raises(DecodeError, match=wanted):
        reader_of(root, f"{description}.json").read("000000")


@pytest.mark.parametrize("scale", [5000, 2000])
def test_a_scale_beyond_any_unit_is_told_too(case: Case, scale: float) -> None:
    root = case("47-")
    document = json.loads((root / "k5000.json").read_text())
    document["depth"]["scale_m"] = scale
    (root / "k5000.json").write_text(json.dumps(document))
    with pytest.raises(LayoutError, match=f"metres per unit: {1 / scale:g}, not {scale}"):
        reader_of(root, "k5000.json")


def test_a_given_scale_that_counts_units_per_metre_is_told(case: Case) -> None:
    root = case("47-")
    options = ReaderOptions(description=root / "k1000.json", depth_scale=1000)
    with pytest.raises(DecodeError, match=r"give metres per unit: 0.001, not 1000"):
        open_reader(root, options).read("000000")
