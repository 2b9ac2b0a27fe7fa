"""Exports and pages of stores with planes of a dataset's own."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.export.formats import export_frames
from nimprep.report.artist import Artist
from nimprep.report.collect import collect, physical
from nimprep.report.contents import legends
from nimprep.report.store_page import write_report
from nimprep.schema import schema_problems
from tests.readers.test_extra_values import write_folder
from tests.thermal import degrees, raw_confidence, raw_thermal, use_reader, write_thermal

pytestmark = pytest.mark.filterwarnings("ignore:.*no calibration")


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    raw = write_thermal(tmp_path_factory.mktemp("raw") / "raw", 3)
    made = tmp_path_factory.mktemp("made")
    wanted = {"all": None, "rgbt": ("rgb", "thermal"), "thermal": ("thermal",)}
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        return {
            name: nimprep.convert(raw, made / f"{name}.zarr", modalities=names).path
            for name, names in wanted.items()
        }


def test_an_archive_has_planes_in_their_units(stores: dict[str, Path], tmp_path: Path) -> None:
    export_frames(stores["all"], tmp_path / "npz", "npz")
    with np.load(tmp_path / "npz" / "000001.npz") as found:
        assert np.array_equal(found["thermal"], degrees(raw_thermal(1)), equal_nan=True)
        assert np.array_equal(found["confidence"], raw_confidence(1))
        assert "depth_m" in found


def test_pngs_of_planes_convert_back_by_their_description(
    stores: dict[str, Path], tmp_path: Path
) -> None:
    export_frames(stores["all"], tmp_path / "png")
    folder, store = tmp_path / "png", nimprep.open_store(stores["all"])
    assert schema_problems(json.loads((folder / "description.json").read_text()), "folder") == []
    description = folder / "description.json"
    again = nimprep.convert(folder, tmp_path / "s.zarr", description=description)
    assert again.planes == store.planes
    for name in store.modalities:
        for number in range(len(store)):
            stored = store.arrays[name].read(number)
            assert np.array_equal(again.arrays[name].read(number), stored)
    with pytest.raises(StoreError, match="found thermal; name what to write"):
        export_frames(stores["thermal"], tmp_path / "none")


def test_planes_of_negative_integers_convert_back_or_are_said_to_be_left_out(
    tmp_path: Path,
) -> None:
    signed = {"files": "flow/{id}.npy", "dtype": "int16", "scale": 0.05, "source_scale": 1}
    planes = {"flow": signed, "flow_with_none": {**signed, "fill": -32768}}
    description = write_folder(tmp_path / "raw", planes)
    store = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", description=description)
    with pytest.warns(UserWarning, match="flow_with_none: .* left out; name them"):
        export_frames(store, tmp_path / "png")
    assert not (tmp_path / "png" / "flow_with_none").exists()
    description = tmp_path / "png" / "description.json"
    again = nimprep.convert(tmp_path / "png", tmp_path / "t.zarr", description=description)
    assert [plane.name for plane in again.planes] == ["flow"]
    assert again.modality("flow") == store.modality("flow")
    for number in range(len(store)):
        assert np.array_equal(again[number]["flow"], store[number]["flow"])


def test_pngs_of_planes_that_are_named_hold_the_stored_integers(
    stores: dict[str, Path], tmp_path: Path
) -> None:
    export_frames(stores["all"], tmp_path / "png", modalities=["thermal"])
    image = cv2.imread(str(tmp_path / "png" / "thermal" / "000002.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(image, raw_thermal(2))
    said = json.loads((tmp_path / "png" / "encodings.json").read_text())["modalities"]["thermal"]
    assert (said["scale"], said["offset"], said["none"]) == (0.01, -273.15, 0)


def test_a_recording_has_planes(stores: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    export_frames(stores["all"], tmp_path / "all.rrd", "rerun")
    assert b"camera/thermal" in (tmp_path / "all.rrd").read_bytes()


@pytest.mark.parametrize("name", ["all", "rgbt", "thermal"])
def test_pages_show_planes_on_a_scale_of_their_own(
    stores: dict[str, Path], tmp_path: Path, name: str
) -> None:
    store = nimprep.open_store(stores[name])
    artist = Artist(store, collect(store))
    scale = artist.looks["thermal"].scale
    assert scale is not None
    assert scale.unit == "degC"
    known = degrees(np.stack([raw_thermal(n) for n in range(3)]))
    assert np.nanmin(known) <= scale.low < scale.high <= np.nanmax(known)
    picture = artist.draw(0, "thermal")
    assert picture.shape == (24, 32, 3)
    assert len(np.unique(picture[:3, :4].reshape(-1, 3), axis=0)) == 1
    assert {legend["name"] for legend in legends(store, artist)} == set(store.modalities)
    write_report(store, tmp_path / "report.html")
    assert "Thermal" in (tmp_path / "report.html").read_text("utf-8")
    values = physical(store, "thermal", store.arrays["thermal"].read(0))
    assert np.allclose(values, degrees(raw_thermal(0)), atol=1e-4, equal_nan=True)
