"""Disparity, transformed disparity and elevation in a store."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
import zarr
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import OptionError
from nimprep.frame import MODALITIES, ON_REQUEST, PLANES
from nimprep.schema import schema_problems
from nimprep.store.info import info_text, store_info
from nimprep.store.metadata import read_attributes
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.checksums import renew_checksums
from tests.derive import roads
from tests.fakes import write_png

SIZE = roads.CAMERA.shape


def write_roads(root: Path, frames: int = 3) -> Path:
    """Write frames of exact roads with boards and a hole, in GMRP's layout with a camera."""
    for number, road in enumerate(list(roads.ROADS)[:frames]):
        plane = roads.plane_of(*roads.ROADS[road])
        road = roads.road_depth(plane)
        depth, covered = roads.with_boards(road, 0.3, number)
        depth[60:64, 20:40] = 0
        name = f"{number:06d}.png"
        write_png(root / "rgb" / name, np.full((*SIZE, 3), 90, np.uint8))
        write_png(root / "depth_u16" / name, np.rint(depth * 1000).astype(np.uint16))
        write_png(root / "label" / name, ((road > 0) & ~covered).astype(np.uint8))
    (root / "camera.json").write_text(json.dumps(roads.CAMERA.to_dict()))
    return root


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_roads(tmp_path_factory.mktemp("raw") / "gmrp")


@pytest.fixture(scope="module")
def made(raw: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("made") / "s.zarr"
    return nimprep.convert(raw, target, modalities=MODALITIES).path


def test_a_frame_has_what_the_functions_make_of_its_stored_depth(made: Path) -> None:
    for frame in nimprep.open_store(made):
        disparity = nimprep.disparity_from_depth(frame.depth_m, frame.camera, 0.055)
        transformed, _ = nimprep.transform_disparity(disparity)
        elevation = nimprep.estimate_elevation(frame.depth_m, frame.camera)
        some = frame.depth_m > 0
        assert np.array_equal(frame.disparity > 0, some)
        np.testing.assert_allclose(frame.disparity[some], disparity[some], atol=0.5 / 256 + 1e-6)
        for found, exact, steps in (
            (frame.transformed_disparity, transformed, 128),
            (frame.elevation, elevation, 1000),
        ):
            assert found.dtype == np.float32
            assert np.array_equal(np.isnan(found), ~some)
            np.testing.assert_allclose(found[some], exact[some], atol=0.5 / steps + 1e-5)


def test_the_road_is_at_0_within_what_whole_millimetres_allow(made: Path) -> None:
    for frame in nimprep.open_store(made):
        road = (frame.label == 1) & (frame.depth_m > 0) & (frame.depth_m < 20)
        assert np.abs(frame.elevation[road]).max() < 0.005
        assert np.abs(frame.transformed_disparity[road]).max() < 0.02


def test_xarray_decodes_to_pixels_and_metres_with_nan_for_none(made: Path) -> None:
    frame = nimprep.open_store(made)[1]
    with xr.open_zarr(made) as data:
        assert np.allclose(data.elevation[1], frame.elevation, atol=1e-6, equal_nan=True)
        transformed = data.transformed_disparity[1]
        assert np.allclose(transformed, frame.transformed_disparity, atol=1e-6, equal_nan=True)
        disparity = data.disparity.values[1]
        assert np.array_equal(np.isnan(disparity), frame.disparity == 0)
        assert np.allclose(np.nan_to_num(disparity), frame.disparity, atol=1e-6)
        assert data.elevation.attrs["units"] == "m"
        assert data.disparity.attrs["units"] == "pixel"
        assert data.elevation.frame_id[1] == "000001"


def test_both_spellings_name_the_modality_and_others_are_refused(raw: Path, tmp_path: Path) -> None:
    for number, name in enumerate(("transformed-disparity", "transformed_disparity")):
        target = tmp_path / f"{number}.zarr"
        arguments = ["convert", str(raw), str(target), "--modalities", f"rgb, {name}"]
        assert CliRunner().invoke(main, arguments).exit_code == 0
        assert nimprep.open_store(target).modalities == ("rgb", "transformed_disparity")
    arguments = ["convert", str(raw), str(tmp_path / "x"), "--modalities", "transformed"]
    refused = CliRunner().invoke(main, arguments)
    assert refused.exit_code == 2
    assert "transformed-disparity" in refused.stderr
    assert nimprep.ConvertOptions(modalities=("transformed-disparity",)).needs_depth
    with pytest.raises(OptionError, match="modalities: expected some of"):
        nimprep.convert(raw, tmp_path / "x", modalities=("transformed",))


def test_without_being_named_they_are_not_stored(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr")
    assert store.modalities == ("rgb", "depth", "normal", "hha", "label")
    assert {p.name for p in store.path.iterdir()}.isdisjoint(ON_REQUEST)
    assert store[0].elevation is None
    assert store[0].disparity is None
    assert "elevation" not in info_text(store_info(store.path))


def test_how_they_were_made_is_in_the_metadata_and_in_info(made: Path) -> None:
    attributes = read_attributes(made)
    assert schema_problems(attributes, "store") == []
    for name in ("disparity", "transformed_disparity"):
        assert attributes["modalities"][name]["parameters"]["virtual_baseline_m"] == 0.055
    info = store_info(made)
    assert schema_problems(info, "info") == []
    text = info_text(info)
    assert "road-profile" in text
    assert "road-plane" in text
    assert len({line.index(" int16 ") for line in text.splitlines() if " int16 " in line}) == 1
    del attributes["modalities"]["disparity"]["parameters"]["virtual_baseline_m"]
    assert schema_problems(attributes, "store") != []


def test_the_frames_own_baseline_and_calibration_are_taken(
    reference_data: Path, tmp_path: Path
) -> None:
    names = ("depth", "disparity", "elevation", "label")
    store = nimprep.convert(
        reference_data / "kitti_road", tmp_path / "s.zarr", modalities=names, depth_from="auto"
    )
    assert validate_store(store.path, deep=True).problems == []
    frame = store[store.ids.index("training/uu_000000")]
    some = frame.depth_m > 0
    assert 0.5 < frame.baseline_m < 0.6
    reach = frame.camera.fx * frame.baseline_m
    expected = np.minimum(reach / frame.depth_m[some], 65535 / 256)
    np.testing.assert_allclose(frame.disparity[some], expected, atol=0.51 / 256)
    v, u = np.argwhere(some)[1000]
    z = float(frame.depth_m[v, u])
    x = (u - frame.camera.cx) / frame.camera.fx * z
    y = (v - frame.camera.cy) / frame.camera.fy * z
    height = -(frame.cam_to_road @ [x, y, z, 1])[1]
    assert frame.elevation[v, u] == pytest.approx(height, abs=0.00051)


@pytest.mark.parametrize(
    "options",
    [{}, {"fill": "linear"}, {"fill": "nearest", "store_filled": True}, {"crop": (0, 3, 5, 0)}],
    ids=["plain", "filled", "stored filled", "cropped"],
)
def test_what_convert_writes_is_valid_in_depth_also_split_anew(
    raw: Path, tmp_path: Path, options: dict[str, object]
) -> None:
    names = ("depth", *ON_REQUEST)
    store = nimprep.convert(raw, tmp_path / "s.zarr", modalities=names, **options)
    resplit(store.path, seed=3)
    assert validate_store(store.path, deep=True).problems == []


def test_frames_of_several_sizes_are_padded_with_none(tmp_path: Path) -> None:
    root = write_roads(tmp_path / "mixed")
    (root / "camera.json").unlink()
    for folder in ("rgb", "depth_u16", "label"):
        path = root / folder / "000002.png"
        write_png(path, cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[:150, :200])
    with pytest.warns(UserWarning, match="nominal"):
        store = nimprep.convert(root, tmp_path / "s.zarr", modalities=ON_REQUEST)
    for name in ON_REQUEST:
        assert (store.arrays[name].read(2)[150:] == PLANES[name].none).all()
        assert getattr(store[2], name).shape == (150, 200)
    assert validate_store(store.path, deep=True).problems == []


def test_a_frame_without_a_road_has_none_and_does_not_stop_the_others(tmp_path: Path) -> None:
    root = write_roads(tmp_path / "wall", frames=2)
    write_png(root / "depth_u16" / "000001.png", np.full(SIZE, 1500, np.uint16))
    store = nimprep.convert(root, tmp_path / "s.zarr", modalities=("depth", *ON_REQUEST))
    assert np.isnan(store[1].elevation).all()
    assert np.isnan(store[1].transformed_disparity).all()
    assert (store[1].disparity > 0).all()
    assert not np.isnan(store[0].elevation).all()
    assert validate_store(store.path, deep=True).problems == []


@pytest.mark.parametrize("name", ON_REQUEST)
@pytest.mark.parametrize(
    ("value", "words"), [(5000, "expected what"), (None, "a value exactly where depth is")]
)
def test_deep_validation_finds_what_is_not_as_made(
    made: Path, tmp_path: Path, name: str, value: int | None, words: str
) -> None:
    copy = Path(shutil.copytree(made, tmp_path / "s.zarr"))
    array = zarr.open_group(copy, mode="r+")[name]
    values = np.array(array[...])
    values[1, 150, 100] = PLANES[name].none if value is None else value
    array[...] = values
    renew_checksums(copy)
    problems = validate_store(copy, deep=True).problems
    assert any(f"{name}: " in problem and words in problem for problem in problems), problems
