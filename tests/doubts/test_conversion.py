"""Doubts through `convert`, `append`, `merge`: warned of, kept, joined; always the same bytes."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.conversion.doubted import frame_signs, shows_road
from nimprep.errors import DoubtWarning
from nimprep.frame import Frame
from nimprep.readers.crop import Margins
from nimprep.schema import schema_problems
from nimprep.store.info import info_text, store_info
from nimprep.store.validate import validate_store
from tests.doubts.streets import CAMERA, rough_street, street
from tests.fakes import contents, write_png

LIDAR = np.zeros(CAMERA.shape, bool)
LIDAR[40::3, ::4] = True


def write_streets(root: Path, first: int = 0, frames: int = 3, *, keep: object = 1) -> Path:
    """Write frames in GMRP's layout with every class; `keep` is multiplied with the depth."""
    for number in range(first, first + frames):
        name = f"{number:06d}.png"
        write_png(root / "rgb" / name, np.full((*CAMERA.shape, 3), 90 + number, np.uint8))
        depth = rough_street(seed=number) * np.asarray(keep, np.uint16)
        write_png(root / "depth_u16" / name, depth)
        label = np.zeros(CAMERA.shape, np.uint8)
        label[60:], label[90:, :9] = 1, 2
        write_png(root / "label" / name, label)
    (root / "camera.json").write_text(json.dumps(CAMERA.to_dict()))
    return root


def convert_with_doubts(source: Path, target: Path, **options: object) -> nimprep.Store:
    with pytest.warns(DoubtWarning, match=r"--fill linear \(\d frames?, first '00000\d'\)$"):
        return nimprep.convert(source, target, **options)


def test_good_frames_are_converted_without_a_doubt(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DoubtWarning)
        store = nimprep.convert(write_streets(tmp_path / "a"), tmp_path / "a.zarr")
        demo = nimprep.append_frames(write_streets(tmp_path / "b", 3), tmp_path / "a.zarr")
    assert "doubts" not in store.attributes
    assert "doubts" not in demo.store.attributes
    assert store_info(store)["doubts"] == []


def test_a_doubt_is_warned_of_and_stands_in_the_attributes_and_in_info(tmp_path: Path) -> None:
    store = convert_with_doubts(write_streets(tmp_path / "a", keep=LIDAR), tmp_path / "a.zarr")
    (doubt,) = store.attributes["doubts"]
    assert (doubt["kind"], doubt["count"]) == ("sparse", 3)
    assert doubt["frames"] == ["000000", "000001", "000002"]
    assert schema_problems(store.attributes, "store") == []
    info = store_info(store)
    assert info["doubts"] == [doubt]
    assert schema_problems(info, "info") == []
    (line,) = [line for line in info_text(info).splitlines() if line.startswith("doubt")]
    assert line == f"doubt    {doubt['text']} (3 frames, first '000000')"
    assert validate_store(tmp_path / "a.zarr", deep=True).problems == []


def test_what_is_filled_is_not_doubted(tmp_path: Path) -> None:
    source = write_streets(tmp_path / "a", keep=LIDAR)
    store = nimprep.convert(source, tmp_path / "a.zarr", fill="linear")
    assert "doubts" not in store.attributes


def test_the_bytes_are_the_same_on_any_number_of_workers(tmp_path: Path) -> None:
    source = write_streets(tmp_path / "a", frames=5, keep=LIDAR)
    for workers in (1, 3):
        target = tmp_path / f"{workers}.zarr"
        convert_with_doubts(source, target, workers=workers, shard_length=2)
    assert contents(tmp_path / "1.zarr") == contents(tmp_path / "3.zarr")


def test_doubts_of_frames_that_join_are_joined_and_said(tmp_path: Path) -> None:
    nimprep.convert(write_streets(tmp_path / "a"), tmp_path / "s.zarr")
    with pytest.warns(DoubtWarning, match="fill linear"):
        nimprep.append_frames(write_streets(tmp_path / "b", 3, keep=LIDAR), tmp_path / "s.zarr")
    with pytest.warns(DoubtWarning, match=r"\(6 frames, first '000003'\)$"):
        done = nimprep.append_frames(
            write_streets(tmp_path / "c", 6, keep=LIDAR), tmp_path / "s.zarr"
        )
    (doubt,) = done.store.about.doubts
    assert doubt["frames"] == [f"00000{n}" for n in range(3, 8)]
    assert doubt["count"] == 6
    with warnings.catch_warnings():
        warnings.simplefilter("error", DoubtWarning)
        done = nimprep.append_frames(write_streets(tmp_path / "d", 9, 1), tmp_path / "s.zarr")
    assert done.store.about.doubts == [doubt]


def test_doubts_of_merged_stores_have_the_ids_of_their_frames(tmp_path: Path) -> None:
    stores = [tmp_path / "a.zarr", tmp_path / "b.zarr"]
    nimprep.convert(write_streets(tmp_path / "a"), stores[0])
    convert_with_doubts(write_streets(tmp_path / "b", keep=LIDAR), stores[1])
    merged = nimprep.merge_stores(stores, tmp_path / "m.zarr", prefixes=["day/", "night/"])
    (doubt,) = merged.about.doubts
    assert doubt["frames"] == [f"night/00000{n}" for n in range(3)]


def test_a_class_that_another_part_has_is_nowhere_missing(tmp_path: Path) -> None:
    source = write_streets(tmp_path / "a")
    for path in (source / "label").iterdir():
        write_png(path, np.zeros(CAMERA.shape, np.uint8))
    with pytest.warns(DoubtWarning, match=r"drivable area \(1\), road anomaly \(2\)"):
        store = nimprep.convert(source, tmp_path / "s.zarr")
    assert [doubt["kind"] for doubt in store.about.doubts] == ["class-missing"]
    done = nimprep.append_frames(write_streets(tmp_path / "b", 3), tmp_path / "s.zarr")
    assert "doubts" not in done.store.attributes
    again = nimprep.convert(write_streets(tmp_path / "b", 3), tmp_path / "b.zarr")
    with pytest.warns(DoubtWarning):
        nimprep.convert(source, tmp_path / "a.zarr")
    merged = nimprep.merge_stores([tmp_path / "a.zarr", again.path], tmp_path / "m.zarr")
    assert "doubts" not in merged.attributes


def test_the_camera_is_judged_by_the_image_before_it_was_cropped() -> None:
    margins = Margins(top=0, bottom=70, left=100, right=0)
    camera = CAMERA.crop(0, 100, 26, 28)
    frame = Frame("a", camera, depth_m=street()[:26, 100:], signs={"largest_raw": 9.0})
    assert frame_signs(frame, None)["cx_share"] < 0
    signs = frame_signs(frame, margins)
    assert (signs["cx_share"], signs["cy_share"], signs["largest_raw"]) == (0.5, 0.5, 9)


def test_the_road_is_looked_for_in_some_frames_of_many_and_in_all_of_few() -> None:
    ids = [f"{n:06d}" for n in range(4000)]
    assert all(shows_road(i, 127) for i in ids[:127])
    assert 32 <= sum(shows_road(i, 4000) for i in ids) <= 128
    frame = Frame("a", CAMERA, depth_m=street())
    with_road, without = (frame_signs(frame, None, road=road) for road in (True, False))
    assert with_road.keys() - without.keys() == {"camera_height_m"}
