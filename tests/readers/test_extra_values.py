"""Planes of a described dataset, from their files to the store and to tensors."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError
from nimprep.readers.folder import FolderReader
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset
from tests.fakes import SIZE, contents, depth_image, write_png
from tests.thermal import degrees, raw_thermal

pytestmark = pytest.mark.filterwarnings("ignore:.*no calibration")

PLANES: dict[str, dict[str, Any]] = {
    "thermal": {
        "files": "thermal/{id}.png",
        "dtype": "uint16",
        "scale": 0.01,
        "offset": -273.15,
        "units": "degC",
        "long_name": "surface temperature",
        "fill": 0,
        "resize": "linear",
    },
    "flow": {"files": "flow/{id}.npy", "dtype": "int16", "scale": 0.05, "source_scale": 1},
    "alpha": {"files": "rgb/{id}.png", "channel": "A", "dtype": "uint8"},
}


def alpha(number: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(number).integers(0, 256, SIZE, dtype=np.uint8)


def flow(number: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(50 + number).normal(0, 20, SIZE).astype(np.float32)


def write_folder(root: Path, planes: Mapping[str, Any] = PLANES, frames: int = 4) -> Path:
    """Write a dataset of colour, depth and three planes; return its description."""
    for number in range(frames):
        rng = np.random.default_rng(number + 9)
        four = np.dstack([rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8), alpha(number)])
        (root / "rgb").mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(root / "rgb" / f"{number}.png"), four[..., [2, 1, 0, 3]])
        write_png(root / "depth" / f"{number}.png", depth_image(number))
        write_png(root / "thermal" / f"{number}.png", raw_thermal(number))
        (root / "flow").mkdir(exist_ok=True)
        np.save(root / "flow" / f"{number}.npy", flow(number))
    document = {
        "format": "nimprep-folder",
        "version": "1.1",
        "name": "rgbt",
        "rgb": "rgb/{id}.png",
        "depth": {"files": "depth/{id}.png", "scale_m": 0.001},
        "planes": planes,
    }
    description = root.parent / f"{root.name}.json"
    description.write_text(json.dumps(document))
    return description


def test_planes_reach_the_store_and_tensors_as_their_files_say(tmp_path: Path) -> None:
    description = write_folder(tmp_path / "raw")
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    assert store.modalities == ("rgb", "depth", "normal", "hha", "alpha", "flow", "thermal")
    for number, frame in enumerate(store):
        assert np.array_equal(frame["thermal"], degrees(raw_thermal(number)), equal_nan=True)
        assert np.array_equal(frame["alpha"], alpha(number))
        assert np.abs(frame["flow"] - flow(number)).max() <= 0.0251
    assert validate_store(store.path, deep=True).valid
    data = StoreDataset(store.path, None, "rgb+alpha", normalize="none")
    for number, sample in enumerate(data):
        four = cv2.imread(str(tmp_path / "raw" / "rgb" / f"{number}.png"), cv2.IMREAD_UNCHANGED)
        assert four is not None
        assert np.array_equal(sample["inputs"].numpy(), four[..., [2, 1, 0, 3]].transpose(2, 0, 1))


def test_values_that_are_not_said_to_be_values_are_refused(tmp_path: Path) -> None:
    planes = {"flow": {"files": "flow/{id}.npy", "dtype": "int16", "scale": 0.05}}
    description = write_folder(tmp_path / "raw", planes)
    reader = FolderReader(tmp_path / "raw", description)
    with pytest.raises(DecodeError, match=r"0.npy: expected whole numbers, .* \"source_scale\": 1"):
        reader.read("0", ("flow",))
    whole = np.rint(flow(0))
    np.save(tmp_path / "raw/flow/0.npy", whole)
    assert np.allclose(reader.read("0", ("flow",))["flow"], whole * 0.05)


def test_a_plane_alone_is_read_where_it_is_named(tmp_path: Path) -> None:
    description = write_folder(tmp_path / "raw")
    reader = FolderReader(tmp_path / "raw", description)
    assert [plane.name for plane in reader.info.planes] == list(PLANES)
    frame = reader.read("1", ("thermal",))
    assert list(frame) == ["thermal"]
    assert frame["thermal"].dtype == np.float32


def test_a_frame_without_a_plane_has_none_where_that_is_said(tmp_path: Path) -> None:
    planes = {"thermal": {**PLANES["thermal"], "missing": "none"}}
    description = write_folder(tmp_path / "raw", planes)
    (tmp_path / "raw" / "thermal" / "2.png").unlink()
    with pytest.warns(UserWarning, match="thermal"):
        store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    assert np.isnan(store[2]["thermal"]).all()
    assert not np.isnan(store[1]["thermal"]).all()
    assert validate_store(store.path, deep=True).valid


def test_planes_of_another_size_are_brought_to_the_frames(tmp_path: Path) -> None:
    description = write_folder(tmp_path / "raw", {"thermal": PLANES["thermal"]})
    document = json.loads(description.read_text())
    description.write_text(json.dumps({**document, "size": "rgb"}))
    half = np.full((SIZE[0] // 2, SIZE[1] // 2), 29315, np.uint16)
    half[:, :4] = 0
    for number in range(4):
        write_png(tmp_path / "raw" / "thermal" / f"{number}.png", half)
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    thermal = store[0]["thermal"]
    assert thermal.shape == SIZE
    assert np.isnan(thermal[:, :8]).all()
    assert np.allclose(thermal[:, 8:], 20, atol=1e-3)


def test_append_refuses_a_folder_whose_plane_is_described_otherwise(tmp_path: Path) -> None:
    first = write_folder(tmp_path / "some", frames=2)
    store = nimprep.convert(tmp_path / "some", tmp_path / "s.zarr", description=first)
    before = contents(store.path)
    changed = {**PLANES, "thermal": {**PLANES["thermal"], "scale": 0.02}}
    description = write_folder(tmp_path / "all", changed)
    with pytest.raises(LayoutError, match=r"expected the plane 'thermal' .*'scale': 0\.02"):
        nimprep.append_frames(
            tmp_path / "all", store.path, description=description, skip_existing=True
        )
    assert contents(store.path) == before
    description = write_folder(tmp_path / "all")
    grown = nimprep.append_frames(
        tmp_path / "all", store.path, description=description, skip_existing=True
    )
    assert np.array_equal(grown.store[3]["alpha"], alpha(3))


@pytest.mark.parametrize(
    ("name", "change", "error", "words"),
    [
        ("rgb2", {"files": "rgb/{id}.png"}, DecodeError, r"0\.png: expected one number per pixel"),
        ("flow", {"dtype": "uint8"}, DecodeError, r"0\.npy: flow: expected 0 to 12\.75"),
        ("mask", {}, LayoutError, "raw: plane 'mask': expected a name"),
        ("thermal", {"offset": 1e9}, LayoutError, "steps that float32 can tell apart"),
        ("thermal", {"fill": 70000}, LayoutError, "fill"),
    ],
)
def test_what_the_store_could_not_say_is_refused(
    tmp_path: Path, name: str, change: dict[str, Any], error: type[Exception], words: str
) -> None:
    described = {**PLANES.get(name, {**PLANES["alpha"], "channel": "R"}), **change}
    if name == "rgb2":
        del described["channel"]
    description = write_folder(tmp_path / "raw", {name: described}, 1)
    with pytest.raises(error, match=words):
        nimprep.convert(
            tmp_path / "raw", tmp_path / "s.zarr", description=description, split_by="frame"
        )
    assert not (tmp_path / "s.zarr").exists()
