"""Frames that lack files: bad ones, optional depth, labels and planes, and data without depth."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError, NimprepError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.store.validate import validate_store
from tests.fakes import contents, write_gmrp

DESCRIBED: dict[str, Any] = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "own",
    "rgb": "rgb/{id}.png",
    "depth": {"files": "depth_u16/{id}.png", "scale_m": 0.001, "invalid": [65535]},
    "label": {"files": "label/{id}.png"},
    "camera": {"fx": 30, "fy": 30, "cx": 16, "cy": 12},
    "classes": [{"id": k, "name": f"class {k}", "color": [k, k, k]} for k in range(3)],
}
SMALL: dict[str, Any] = {"shard_length": 2, "workers": 1}


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return with_camera(write_gmrp(tmp_path / "raw", frames=5))


def with_camera(root: Path) -> Path:
    (root / "camera.json").write_text(json.dumps(DESCRIBED["camera"]))
    return root


def lacking(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).unlink()
    return root


def description(tmp_path: Path, **changes: Any) -> Path:
    document = {**DESCRIBED, **changes}
    path = tmp_path / "d.json"
    path.write_text(json.dumps({k: v for k, v in document.items() if v is not None}))
    return path


def optional(kind: str, missing: str) -> dict[str, Any]:
    return {kind: {**DESCRIBED[kind], "missing": missing}}


def test_a_frame_that_lacks_files_ends_a_conversion_before_it_begins(
    raw: Path, tmp_path: Path
) -> None:
    lacking(raw, "label/000001.png", "rgb/000003.png")
    with pytest.raises(DecodeError, match=r"label/000001\.png: expected label.*found none") as told:
        nimprep.convert(raw, tmp_path / "s.zarr")
    assert told.value.frame_id == "000001"
    assert told.value.__notes__ == [
        "2 of 5 frames lack a file",
        "--on-error skip leaves such frames out",
    ]
    assert not [path for path in tmp_path.glob(".*/*") if path.is_dir()]


def test_it_is_left_out_and_listed_and_the_others_are_as_alone(raw: Path, tmp_path: Path) -> None:
    lacking(raw, "depth_u16/000002.png")
    store = nimprep.convert(raw, tmp_path / "s.zarr", on_error="skip", **SMALL)
    assert store.about.skipped == [
        {
            "id": "000002",
            "reason": "depth_u16/000002.png: expected depth of frame '000002', found none",
        }
    ]
    lacking(raw, "rgb/000002.png", "label/000002.png")
    nimprep.convert(raw, tmp_path / "alone.zarr", **SMALL)
    shards = [
        {name: data for name, data in contents(tmp_path / store).items() if "/c/" in name}
        for store in ("s.zarr", "alone.zarr")
    ]
    assert shards[0] == shards[1]


def test_a_file_that_comes_later_mends_its_frame(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nimprep.convert(raw, tmp_path / "whole.zarr", **SMALL)
    for name in ("depth_u16/000001.png", "label/000004.png"):
        shutil.copy2(raw / name, tmp_path)
        lacking(raw, name)

    def full(*_: object) -> None:
        raise NimprepError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("nimprep.conversion.run.finish", full)
        with pytest.raises(NimprepError, match="full"):
            nimprep.convert(raw, tmp_path / "s.zarr", on_error="skip", **SMALL)
    shutil.copy2(tmp_path / "000001.png", raw / "depth_u16/000001.png")
    shutil.copy2(tmp_path / "000004.png", raw / "label/000004.png")
    store = nimprep.convert(raw, tmp_path / "s.zarr", on_error="skip", **SMALL)
    assert len(store) == 5
    assert store.about.skipped == []
    without_run = [
        {n: d for n, d in contents(tmp_path / s).items() if n != "zarr.json"}
        for s in ("s.zarr", "whole.zarr")
    ]
    assert without_run[0] == without_run[1]


def test_append_leaves_out_what_lacks_a_file(raw: Path, tmp_path: Path) -> None:
    store = nimprep.convert(raw, tmp_path / "s.zarr", **SMALL)
    more = with_camera(write_gmrp(tmp_path / "more", frames=7))
    lacking(more, "depth_u16/000005.png")
    with pytest.raises(DecodeError, match="000005") as told:
        nimprep.append_frames(more, store.path, skip_existing=True)
    assert told.value.__notes__ == ["--on-error skip leaves such frames out"]
    done = nimprep.append_frames(more, store.path, skip_existing=True, on_error="skip")
    assert done.ids == ("000006",)
    assert [frame.id for frame in done.skipped] == ["000005"]


def test_frames_without_depth_are_none_in_all_that_is_made_of_it(raw: Path, tmp_path: Path) -> None:
    whole = nimprep.convert(raw, tmp_path / "whole.zarr")
    lacking(raw, "depth_u16/000001.png", "depth_u16/000003.png")
    names = ["rgb", "depth", "normal", "hha", "disparity", "transformed_disparity", "elevation"]
    path = description(tmp_path, **optional("depth", "none"))
    with pytest.warns(UserWarning, match="2 of 5 frames have no depth$"):
        store = nimprep.convert(
            raw, tmp_path / "s.zarr", description=path, modalities=names, fill="nearest"
        )
    for number in range(5):
        frame = store[number]
        there = number not in (1, 3)
        assert np.array_equal(frame["rgb"], whole[number]["rgb"])
        assert bool(frame["depth"].any()) == there
        assert bool(frame["normal"].any()) == there
        assert bool(frame["hha"].any()) == there
        assert bool((frame["disparity"] > 0).any()) == there
        assert bool(np.isfinite(frame["elevation"]).any()) <= there


def test_frames_without_labels_are_255_where_that_is_said(raw: Path, tmp_path: Path) -> None:
    lacking(raw, "label/000001.png")
    path = description(tmp_path, **optional("label", "none"))
    with pytest.warns(UserWarning, match="1 of 5 frames have no label$"):
        store = nimprep.convert(raw, tmp_path / "s.zarr", description=path)
    assert (store[1]["label"] == 255).all()
    assert store[0]["label"].max() == 2


def test_frames_can_be_passed_over(raw: Path, tmp_path: Path) -> None:
    lacking(raw, "label/000001.png", "rgb/000002.png")
    path = description(
        tmp_path, rgb={"files": "rgb/{id}.png", "missing": "skip"}, **optional("label", "skip")
    )
    reader = open_reader(raw, ReaderOptions(description=path))
    assert reader.ids == ("000000", "000003", "000004")
    assert [note for note in reader.info.notes if "left out" in note] == [
        "1 of 5 frames are left out: they have no rgb",
        "1 of 5 frames are left out: they have no label",
    ]


def test_a_dataset_without_depth_is_converted_without(raw: Path, tmp_path: Path) -> None:
    path = description(tmp_path, depth=None)
    store = nimprep.convert(raw, tmp_path / "s.zarr", description=path)
    assert store.modalities == ("rgb", "label")
    with pytest.raises(LayoutError, match="found 'depth' where there is no depth"):
        nimprep.convert(raw, tmp_path / "t.zarr", description=path, modalities=["depth"])
    more = with_camera(write_gmrp(tmp_path / "more", frames=7))
    done = nimprep.append_frames(more, store.path, description=path, skip_existing=True)
    assert len(done.store) == 7


def test_what_cannot_be_none_is_refused(raw: Path, tmp_path: Path) -> None:
    path = description(tmp_path, rgb={"files": "rgb/{id}.png", "missing": "none"})
    with pytest.raises(LayoutError, match="every frame has colour"):
        open_reader(raw, ReaderOptions(description=path))
    plane = {"files": "depth_u8/{id}.png", "dtype": "uint8", "missing": "none"}
    path = description(tmp_path, planes={"haze": plane})
    with pytest.raises(LayoutError, match="expected \"fill\" of the plane 'haze'"):
        open_reader(raw, ReaderOptions(description=path))


def test_another_ending_is_told(raw: Path, tmp_path: Path) -> None:
    (raw / "rgb/000001.png").rename(raw / "rgb/000001.jpg")
    with pytest.raises(DecodeError, match=r"000001\.png: .* found none but '000001\.jpg'; an end"):
        nimprep.convert(raw, tmp_path / "s.zarr")


def test_a_store_with_frames_without_depth_is_valid(raw: Path, tmp_path: Path) -> None:
    lacking(raw, "depth_u16/000001.png")
    described = description(tmp_path, **optional("depth", "none"))
    names = ["rgb", "depth", "normal", "hha", "label"]
    with pytest.warns(UserWarning, match="1 of 5 frames have no depth"):
        store = nimprep.convert(raw, tmp_path / "s.zarr", description=described, modalities=names)
    assert not store[1]["depth"].any()
    assert np.isnan(store.tables.gravity).all(axis=1).tolist() == [False, True] + [False] * 3
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []
