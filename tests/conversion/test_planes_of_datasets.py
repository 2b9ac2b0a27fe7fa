"""Converting planes that a dataset describes: stored, resumed, appended, merged, refused."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import nimprep
from nimprep.conversion import encode
from nimprep.errors import DecodeError, LayoutError, NimprepError, OptionError, StoreError
from nimprep.frame import Frame
from nimprep.plane import plane_from
from nimprep.schema import schema_problems
from nimprep.store.info import info_text, store_info
from nimprep.store.statistics import channel_statistics
from nimprep.store.validate import validate_store
from tests.checksums import renew_checksums
from tests.fakes import contents
from tests.thermal import (
    THERMAL,
    ThermalReader,
    degrees,
    raw_confidence,
    raw_thermal,
    use_reader,
    write_thermal,
)

pytestmark = pytest.mark.filterwarnings("ignore:.*no calibration")


class OtherReader(ThermalReader):
    planes = (plane_from("thermal", {**THERMAL, "offset": 0}), ThermalReader.planes[1])


class LackingReader(ThermalReader):
    planes = ThermalReader.planes[1:]


@pytest.fixture(autouse=True)
def _reader(monkeypatch: pytest.MonkeyPatch) -> None:
    use_reader(monkeypatch)


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return write_thermal(tmp_path / "raw")


def test_planes_are_stored_last_and_read_as_their_numbers(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr")
    assert store.modalities[-3:] == ("label", "confidence", "thermal")
    assert [plane.name for plane in store.planes] == ["confidence", "thermal"]
    assert store.modality("thermal").units == "degC"
    for number, frame in enumerate(store):
        thermal = frame.image("thermal")
        assert thermal.dtype == np.float32
        assert np.array_equal(thermal, degrees(raw_thermal(number)), equal_nan=True)
        assert np.array_equal(frame.others["confidence"], raw_confidence(number))
    described = store.about.modalities["thermal"]
    assert described == {"method": "source", "parameters": {}, "kind": "plane", **THERMAL}
    with pytest.raises(StoreError, match=r"expected one of rgb, .*, found 'infrared'"):
        store.modality("infrared")


def test_xarray_reads_a_plane_in_its_units(raw: Path, tmp_path: Path) -> None:
    path = nimprep.convert(raw, tmp_path / "s.zarr").path
    with xr.open_zarr(path) as data:
        assert data.thermal.attrs["units"] == "degC"
        assert data.thermal.attrs["long_name"] == "surface temperature"
        found = data.thermal.values[2].astype(np.float32)
        assert np.array_equal(found, degrees(raw_thermal(2)), equal_nan=True)
        assert data.confidence.dtype == np.uint8


def test_the_bytes_are_the_same_on_any_number_of_workers(raw: Path, tmp_path: Path) -> None:
    one, three = (
        contents(nimprep.convert(raw, tmp_path / f"{n}.zarr", workers=n, shard_length=2).path)
        for n in (1, 3)
    )
    assert one == three


def test_modalities_name_planes_and_others_are_refused(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr", modalities=("thermal", "rgb"))
    assert store.modalities == ("rgb", "thermal")
    with pytest.raises(OptionError, match=r"expected some of rgb, .*, thermal, found 'termal'"):
        nimprep.convert(raw, tmp_path / "t.zarr", modalities=("termal",))
    alone = nimprep.convert(raw, tmp_path / "a.zarr", modalities=("thermal",))
    assert alone.modalities == ("thermal",)
    assert validate_store(alone.path, deep=True).valid


def test_planes_are_padded_with_what_means_none_or_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw = write_thermal(tmp_path / "raw", 2)
    write_thermal(raw, 1, (20, 30))
    store = nimprep.convert(raw, tmp_path / "s.zarr", labels=False)
    assert (store.arrays["thermal"].read(0)[20:] == 0).all()
    assert store[0].others["thermal"].shape == (20, 30)
    assert validate_store(store.path, deep=True).valid


def test_margins_are_cut_off_planes_too(raw: Path, tmp_path: Path) -> None:
    frame = nimprep.convert(raw, tmp_path / "s.zarr", crop=(3, 1, 4, 2))[1]
    whole = degrees(raw_thermal(1))
    assert np.array_equal(frame.others["thermal"], whole[3:-1, 4:-2], equal_nan=True)


def test_statistics_of_planes_are_those_of_their_numbers(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr")
    found = channel_statistics(store, None)
    thermal = np.stack([raw_thermal(n) for n in range(5)])
    values = thermal[thermal > 0] * 0.01 - 273.15
    assert found["thermal"].mean == pytest.approx([values.mean()])
    assert found["thermal"].std == pytest.approx([values.std()])
    every = np.stack([raw_confidence(n) for n in range(5)])
    assert found["confidence"].mean == pytest.approx([every.mean()])
    # Rows of the table are those of all planes, whichever the store was opened with.
    some = nimprep.open_store(store.path, ["rgb"])
    assert channel_statistics(some, None)["thermal"] == found["thermal"]


def test_info_lists_planes(raw: Path, tmp_path: Path) -> None:
    info = store_info(nimprep.convert(raw, tmp_path / "s.zarr"))
    assert info["modalities"]["thermal"]["scale"] == 0.01
    assert schema_problems(info, "info") == []
    assert "\nthermal    uint16  copied" in info_text(info)


def test_a_conversion_cut_short_goes_on_with_planes(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = nimprep.convert(raw, tmp_path / "whole.zarr", shard_length=2).path
    target, encoded = tmp_path / "s.zarr", []
    real = encode.encode_frame

    def failing(job, reader, frame_id):  # type: ignore[no-untyped-def]
        encoded.append(frame_id)
        if frame_id == "000003":
            raise DecodeError(f"frame {frame_id!r}: expected luck, found none; try again")
        return real(job, reader, frame_id)

    with monkeypatch.context() as patch:
        patch.setattr(encode, "encode_frame", failing)
        with pytest.raises(NimprepError, match="luck"):
            nimprep.convert(raw, target, shard_length=2, workers=1)
        encoded.clear()
        patch.setattr(encode, "encode_frame", lambda *a: encoded.append(a[2]) or real(*a))
        nimprep.convert(raw, target, shard_length=2, workers=1)
    assert encoded == ["000002", "000003", "000004"]
    assert contents(target) == contents(whole)


def test_what_was_done_of_other_planes_is_done_again(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "s.zarr"
    (raw / "rgb" / "000003.png").rename(raw / "kept.png")
    (raw / "rgb" / "000003.png").write_bytes(b"")
    with pytest.raises(NimprepError):
        nimprep.convert(raw, target, shard_length=2, workers=1)
    (raw / "kept.png").replace(raw / "rgb" / "000003.png")
    use_reader(monkeypatch, OtherReader)
    store = nimprep.convert(raw, target, shard_length=2, workers=1)
    found, given = store[0].others["thermal"], degrees(raw_thermal(0))
    assert np.allclose(found, given, atol=0.0051, equal_nan=True)
    assert store.modality("thermal").offset == 0
    assert validate_store(target, deep=True).valid


def test_frames_of_the_same_planes_are_appended(tmp_path: Path) -> None:
    whole = write_thermal(tmp_path / "whole")
    store = nimprep.convert(
        write_thermal(tmp_path / "some", 3), tmp_path / "s.zarr", shard_length=2
    )
    grown = nimprep.append_frames(whole, store.path, skip_existing=True).store
    assert len(grown) == 5
    for number, frame in enumerate(grown):
        assert np.array_equal(frame.others["thermal"], degrees(raw_thermal(number)), equal_nan=True)
    assert validate_store(grown.path, deep=True).valid


@pytest.mark.parametrize(
    ("kind", "found"), [(OtherReader, "'offset': 0.0"), (LackingReader, "none of that name")]
)
def test_frames_of_other_planes_are_not_appended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[ThermalReader], found: str
) -> None:
    store = nimprep.convert(write_thermal(tmp_path / "some", 3), tmp_path / "s.zarr")
    before, whole = contents(store.path), write_thermal(tmp_path / "whole")
    use_reader(monkeypatch, kind)
    with pytest.raises(LayoutError, match=f"expected the plane 'thermal' .*found .*{found}"):
        nimprep.append_frames(whole, store.path, skip_existing=True)
    assert contents(store.path) == before


def test_planes_that_a_store_lacks_are_said_to_be_left_out(tmp_path: Path) -> None:
    some, more = write_thermal(tmp_path / "a", 3), write_thermal(tmp_path / "b", 5)
    nimprep.convert(some, tmp_path / "s.zarr", modalities=("rgb", "depth", "confidence"))
    with pytest.warns(UserWarning, match="the store has no thermal: these are not appended"):
        nimprep.append_frames(more, tmp_path / "s.zarr", skip_existing=True)


def test_stores_of_the_same_planes_are_merged_and_of_others_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw = write_thermal(tmp_path / "raw", 3)
    one = nimprep.convert(raw, tmp_path / "one.zarr", shard_length=2).path
    pair = nimprep.merge_stores([one, one], tmp_path / "pair.zarr", prefixes=["a/", "b/"])
    assert np.array_equal(pair[5].others["thermal"], degrees(raw_thermal(2)), equal_nan=True)
    assert validate_store(pair.path, deep=True).valid
    use_reader(monkeypatch, OtherReader)
    other = nimprep.convert(raw, tmp_path / "other.zarr").path
    with pytest.raises(StoreError, match=r"expected thermal .*-273\.15.* found .*'offset': 0\.0"):
        nimprep.merge_stores([one, other], tmp_path / "no.zarr", prefixes=["a/", "b/"])


def test_an_image_of_another_size_or_beyond_the_integers_is_refused(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Small(ThermalReader):
        def read(self, *args) -> Frame:  # type: ignore[no-untyped-def]
            frame = super().read(*args)
            return replace(frame, others={**frame.others, "thermal": np.zeros((2, 3))})

    class Hot(ThermalReader):
        def read(self, *args) -> Frame:  # type: ignore[no-untyped-def]
            frame = super().read(*args)
            return replace(frame, others={**frame.others, "thermal": np.full((24, 32), 1e4)})

    class Without(ThermalReader):
        def read(self, *args) -> Frame:  # type: ignore[no-untyped-def]
            return replace(super().read(*args), others={})

    for kind, words in (
        (Small, "frame '000000': thermal: expected a number per pixel"),
        (Hot, "frame '000000': thermal: expected -273.15 to 382.2"),
        (Without, "frame '000000': expected .*, found none"),
    ):
        use_reader(monkeypatch, kind)
        with pytest.raises(DecodeError, match=words):
            nimprep.convert(raw, tmp_path / "s.zarr", workers=1, restart=True)


def test_validate_finds_damage_in_a_plane(raw: Path, tmp_path: Path) -> None:
    path = nimprep.convert(raw, tmp_path / "s.zarr").path
    shard = path / "thermal" / "c" / "0" / "0" / "0"
    data = bytearray(shard.read_bytes())
    data[200] ^= 1
    shard.write_bytes(data)
    assert validate_store(path).valid
    assert any("thermal" in p for p in validate_store(path, deep=True).problems)
    data[-40] ^= 1
    shard.write_bytes(data)
    assert any("thermal" in p for p in validate_store(path).problems)
    shard.unlink()
    assert any("thermal" in p for p in validate_store(path).problems)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"offset": -273}, "add_offset"),
        ({"scale": 1e-9, "offset": 1e3}, "steps that float32 can tell apart"),
        ({"kind": "image"}, "and not 'plane'"),
        ({"fill": 70000}, "expected a fill from 0 to 65535"),
    ],
)
def test_validate_finds_another_definition_than_the_arrays(
    raw: Path, tmp_path: Path, change: dict[str, object], words: str
) -> None:
    path = nimprep.convert(raw, tmp_path / "s.zarr").path
    root = json.loads((path / "zarr.json").read_text())
    root["attributes"]["nimprep"]["modalities"]["thermal"].update(change)
    (path / "zarr.json").write_text(json.dumps(root))
    renew_checksums(path)
    problems = validate_store(path).problems
    assert any(words in problem for problem in problems), problems


def test_the_order_of_planes_in_the_attributes_does_not_matter(raw: Path, tmp_path: Path) -> None:
    path = nimprep.convert(raw, tmp_path / "s.zarr").path
    root = json.loads((path / "zarr.json").read_text())
    described = root["attributes"]["nimprep"]["modalities"]
    root["attributes"]["nimprep"]["modalities"] = dict(reversed(described.items()))
    (path / "zarr.json").write_text(json.dumps(root))
    found = nimprep.open_store(path)[1].others["thermal"]
    assert np.array_equal(found, degrees(raw_thermal(1)), equal_nan=True)


def test_an_open_store_and_a_layout_of_planes_pickle(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr")
    again = pickle.loads(pickle.dumps(store))
    assert again.planes == store.planes
    assert np.array_equal(again[0].others["confidence"], raw_confidence(0))
