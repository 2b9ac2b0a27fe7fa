import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import tensorstore
import xarray as xr
import zarr

import nimprep
from nimprep.errors import StoreError
from nimprep.store.info import info_text, store_info
from nimprep.store.metadata import read_attributes, write_attributes
from nimprep.store.resplit import resplit
from tests.fakes import SIZE, depth_image, write_gmrp, write_nyu_like


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(write_gmrp(folder / "gmrp", frames=7), folder / "s.zarr", shard_length=3)
    return folder / "s.zarr"


def test_a_frame_is_what_was_converted(made: Path) -> None:
    frame = nimprep.open_store(made)[4]
    raw = depth_image(4)
    assert frame.id == "000004"
    assert frame.depth_m is not None
    assert np.array_equal(frame.depth_m, np.where(raw == 65535, 0, raw) / np.float32(1000))
    assert frame.normal is not None
    lengths = np.linalg.norm(frame.normal, axis=2)
    assert np.allclose(lengths[frame.depth_m > 0], 1, atol=1e-6)
    assert (lengths[frame.depth_m == 0] == 0).all()
    assert frame.label is not None
    assert frame.hha is None or frame.hha.shape == (*SIZE, 3)
    assert np.isnan(frame.baseline_m)
    assert frame.cam_to_road is None


def test_a_store_counts_from_both_ends_and_iterates(made: Path) -> None:
    store = nimprep.open_store(made)
    assert len(store) == 7
    assert store[-1].id == store.ids[6]
    assert [frame.id for frame in store] == list(store.ids)
    with pytest.raises(IndexError):
        store[7]
    with pytest.raises(TypeError):
        store["000001"]  # type: ignore[index]


def test_stored_normals_are_within_a_rounding_step_of_the_exact_ones(made: Path) -> None:
    frame = nimprep.open_store(made)[0]
    assert frame.depth_m is not None
    assert frame.normal is not None
    exact = nimprep.estimate_normals(frame.depth_m, frame.camera)
    assert np.abs(exact - frame.normal).max() < 1.5 / 127


def test_xarray_shows_metres_with_nan_and_unit_normals(made: Path) -> None:
    with xr.open_zarr(made) as data:
        assert set(data.coords) == {"frame_id", "split", "group"}
        assert data.sizes["frame"] == 7
        depth = data.depth.values[2]
        raw = depth_image(2)
        none = (raw == 0) | (raw == 65535)
        assert np.isnan(depth[none]).all()
        assert np.allclose(depth[~none], raw[~none] / 1000)
        assert data.depth.attrs["units"] == "m"
        lengths = np.linalg.norm(data.normal.values[2], axis=2)
        assert np.allclose(lengths[~none], 1, atol=0.01)
        assert data.label.dtype == np.uint8
        assert data.label.attrs["flag_meanings"].split()[1] == "drivable_area"


def test_zarr_and_tensorstore_read_the_same_pixels(made: Path) -> None:
    store = nimprep.open_store(made)
    group = zarr.open_group(made, mode="r")
    for name, array in store.arrays.items():
        stored = np.stack([array.read(i) for i in range(len(store))])
        assert np.array_equal(group[name][...], stored)
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": str(made / name)}}
        assert np.array_equal(tensorstore.open(spec).result().read().result(), stored)


def test_an_image_that_another_program_wrote_into_a_store_is_refused_by_name(
    made: Path, tmp_path: Path
) -> None:
    copy = copied(made, tmp_path)
    array = zarr.open_group(copy, mode="r+")["label"]
    array[0] = 255  # all fill value: zarr leaves the chunk out of the shard
    array[1] = 1
    store = nimprep.open_store(copy)
    with pytest.raises(StoreError, match=r"label/c/0/0/0: frame '000000': expected .* found none"):
        store[0]
    with pytest.raises(StoreError, match=r"'000001': expected the image .* another version's"):
        store[1]
    assert np.array_equal(store[2].label, nimprep.open_store(made)[2].label)


def copied(store: Path, folder: Path) -> Path:
    import shutil

    return Path(shutil.copytree(store, folder / "copy.zarr"))


def test_frames_of_several_sizes_are_padded_and_come_back_as_they_were(tmp_path: Path) -> None:
    root = write_gmrp(tmp_path / "gmrp", frames=2)
    write_gmrp(root, frames=1, size=(20, 40))
    with pytest.warns(UserWarning, match="nominal"):
        store = nimprep.convert(root, tmp_path / "s.zarr")
    assert store.arrays["rgb"].shape == (2, 24, 40, 3)
    assert store[0].rgb is not None
    assert store[0].rgb.shape == (20, 40, 3)
    assert store[1].depth_m is not None
    assert store[1].depth_m.shape == (24, 32)
    assert (store.arrays["label"].read(0)[20:] == 255).all()
    assert (store.arrays["depth"].read(1)[:, 32:] == 0).all()
    assert store[0].camera.width == 40


def test_only_the_modalities_asked_for_are_read(made: Path) -> None:
    frame = nimprep.open_store(made, modalities=("depth",))[0]
    assert frame.rgb is None
    assert frame.depth_m is not None
    with pytest.raises(StoreError, match="expected one of the stored modalities"):
        nimprep.open_store(made, modalities=("disparity",))


def test_a_store_and_its_frames_pickle(made: Path) -> None:
    store = pickle.loads(pickle.dumps(nimprep.open_store(made)))
    frame = pickle.loads(pickle.dumps(store[3]))
    assert np.array_equal(frame.rgb, store[3].rgb)


def test_scenes_and_cameras_of_a_described_folder_are_in_the_store(tmp_path: Path) -> None:
    root, description = write_nyu_like(tmp_path / "nyu")
    store = nimprep.convert(root, tmp_path / "s.zarr", description=description)
    assert store.tables.group == ("kitchen", "kitchen", "office", "office")
    assert store[0].camera.cx == 16
    assert store.attributes["dataset"] == "nyu-like"
    assert store.attributes["calibration"] == {"origin": "file"}


def test_a_split_selects_its_frames(made: Path) -> None:
    store = nimprep.open_store(made)
    chosen = [set(store.indices(name)) for name in ("train", "val", "test")]
    assert [len(c) for c in chosen] == [3, 2, 2]
    assert set.union(*chosen) == set(range(7))
    assert len(store.indices()) == 7
    with pytest.raises(StoreError, match="found 'trian'"):
        store.indices("trian")


def test_splitting_anew_touches_the_split_alone(made: Path, tmp_path: Path) -> None:
    copy = copied(made, tmp_path)
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    splits = resplit(copy, seed=5)
    changed = {str(p.relative_to(copy)) for p, data in before.items() if p.read_bytes() != data}
    assert changed == {"zarr.json", "split/c/0"}
    store = nimprep.open_store(copy)
    assert store.splits == splits
    assert store.attributes["split"] == {"rule": "frame", "seed": 5}


def test_info_as_text_shows_what_info_as_json_holds(made: Path) -> None:
    info = store_info(made)
    text = info_text(info)
    assert info["frames"] == 7
    assert info["split"]["frames"] == {"train": 3, "val": 2, "test": 2}
    assert "7 frames of 32x24 pixels" in text
    assert "nominal, not calibrated" in text
    for percentile in info["depth_percentiles_m"].values():
        assert f"{percentile:.3f} m" in text


def test_depth_percentiles_are_those_of_all_valid_pixels(made: Path) -> None:
    images = [depth_image(n) for n in range(7)]
    valid = np.concatenate([i[(i > 0) & (i < 65535)] for i in images])
    found = store_info(made)["depth_percentiles_m"]
    for percentile in (5, 50, 95):
        expected = np.percentile(valid, percentile, method="inverted_cdf") / 1000
        assert found[str(percentile)] == expected


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"complete": False}, "cut short"),
        ({"format_version": "2.0"}, "a newer nimprep"),
        ({"format_version": "3.0"}, "a newer nimprep"),
        ({"format_version": None}, "a newer nimprep"),
        ({"classes": 3}, "schema 'store'"),
        ({"modalities": ["rgb"]}, "schema 'store'"),
    ],
)
def test_a_store_that_is_not_whole_or_not_ours_is_refused(
    made: Path, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    copy = copied(made, tmp_path)
    write_attributes(copy, {**read_attributes(copy), **change})
    with pytest.raises(StoreError, match=words):
        nimprep.open_store(copy)


def test_what_is_no_store_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="found nothing"):
        nimprep.open_store(tmp_path / "none.zarr")
    with pytest.raises(StoreError, match=r"found no zarr\.json"):
        nimprep.open_store(tmp_path)
    (tmp_path / "zarr.json").write_text("{")
    with pytest.raises(StoreError, match="expected JSON"):
        nimprep.open_store(tmp_path)
    (tmp_path / "zarr.json").write_text(json.dumps({"zarr_format": 3, "attributes": {}}))
    with pytest.raises(StoreError, match="without 'nimprep' attributes"):
        nimprep.open_store(tmp_path)


def test_a_damaged_chunk_is_an_error_when_its_frame_is_asked_for(
    made: Path, tmp_path: Path
) -> None:
    copy = copied(made, tmp_path)
    path = copy / "depth" / "c" / "0" / "0" / "0"
    data = bytearray(path.read_bytes())
    data[30] ^= 1
    path.write_bytes(data)
    store = nimprep.open_store(copy)
    with pytest.raises(StoreError, match="expected chunk 0 undamaged"):
        store[0]
    assert store[1].depth_m is not None


def test_a_damaged_normal_is_an_error_when_it_is_asked_for(made: Path, tmp_path: Path) -> None:
    copy = copied(made, tmp_path)
    path = copy / "normal" / "c" / "0" / "0" / "0" / "0"
    data = bytearray(path.read_bytes())
    data[30] ^= 1
    path.write_bytes(data)
    frame = nimprep.open_store(copy)[0]
    assert frame.rgb is not None
    with pytest.raises(StoreError, match="expected chunk 0 undamaged"):
        _ = frame.normal
