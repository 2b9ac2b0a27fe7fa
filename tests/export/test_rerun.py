"""Export as a Rerun recording, read back by Rerun's own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.camera import Camera
from nimprep.cli import main
from nimprep.export import export_frames
from nimprep.export.rerun import point_cloud
from nimprep.store.reader import Store
from tests.fakes import write_gmrp

CAMERA = (30.0, 31.0, 15.5, 11.25)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("gmrp")
    return nimprep.convert(write_gmrp(root / "raw", frames=4), root / "s.zarr", camera=CAMERA)


@pytest.fixture(scope="module")
def rows(store: Store, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, int], Any]:
    """Return what the recording holds, by entity and frame; -1 = what holds for all."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    path = tmp_path_factory.mktemp("rrd") / "a.rrd"
    export_frames(store, path, "rerun", ["0:2", "3:4"])
    found: dict[tuple[str, int], Any] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        for row in chunk.to_record_batch().to_pylist():
            found.setdefault((chunk.entity_path, row.get("frame", -1)), {}).update(row)
    return found


def test_every_frame_has_its_camera_images_labels_and_points(rows: dict) -> None:
    entities = {entity for entity, frame in rows if frame >= 0}
    images = {f"/camera/{name}" for name in ("rgb", "depth", "normal", "hha", "label")}
    assert entities == {"/frame", "/camera", "/points"} | images
    for entity in entities:
        assert sorted(frame for name, frame in rows if name == entity) == [0, 1, 3]


def test_the_camera_is_the_stores(rows: dict) -> None:
    k = np.reshape(rows["/camera", 0]["Pinhole:image_from_camera"][0], (3, 3)).T
    np.testing.assert_allclose(k, [[30, 0, 15.5], [0, 31, 11.25], [0, 0, 1]])
    assert rows["/camera", 0]["Pinhole:resolution"][0] == [32, 24]


def test_images_are_the_stores_pixels(rows: dict, store: Store) -> None:
    for number in (0, 1, 3):
        frame = store[number]
        png = np.array(rows["/camera/rgb", number]["EncodedImage:blob"][0], np.uint8)
        rgb = cv2.imdecode(png, cv2.IMREAD_COLOR_RGB)
        np.testing.assert_array_equal(rgb, frame.rgb)
        label = np.array(rows["/camera/label", number]["SegmentationImage:buffer"][0], np.uint8)
        np.testing.assert_array_equal(label.reshape(24, 32), frame.label)
        depth = rows["/camera/depth", number]
        millimetres = np.array(depth["DepthImage:buffer"][0], np.uint8).view("<u2").reshape(24, 32)
        np.testing.assert_array_equal(
            millimetres / np.float32(depth["DepthImage:meter"][0]), frame.depth_m
        )


def test_points_are_the_pixels_with_depth_in_the_camera_frame(rows: dict, store: Store) -> None:
    frame, (fx, fy, cx, cy) = store[3], CAMERA
    expected, colors, classes = [], [], []
    for v, u in np.ndindex(24, 32):
        z = float(frame.depth_m[v, u])
        if z > 0:
            expected.append(((u - cx) * z / fx, (v - cy) * z / fy, z))
            colors.append(frame.rgb[v, u])
            classes.append(frame.label[v, u])
    points = rows["/points", 3]
    np.testing.assert_allclose(points["Points3D:positions"], expected, rtol=1e-5, atol=1e-6)
    assert points["Points3D:class_ids"] == classes
    rgba = np.array(points["Points3D:colors"], np.uint32)
    np.testing.assert_array_equal(rgba >> 24, [c[0] for c in colors])
    np.testing.assert_array_equal(rgba >> 8 & 255, [c[2] for c in colors])


def test_ids_splits_and_classes_are_in_it(rows: dict, store: Store) -> None:
    for number in (0, 1, 3):
        row = rows["/frame", number]
        assert row["id"] == [store.ids[number]]
        assert row["split"] == [store.splits[store.ids[number]]]
    named = rows["/", -1]["AnnotationContext:context"][0]
    names = {entry["class_id"]: entry["class_description"]["info"]["label"] for entry in named}
    assert names == {0: "background", 1: "drivable area", 2: "road anomaly", 255: "ignore"}


def test_many_points_are_thinned_evenly_and_stay_where_they_are() -> None:
    camera = Camera(100.0, 100.0, 49.5, 29.5, 100, 60)
    # Each pixel's depth is its own, so that no point can pass for another.
    depth_m = np.linspace(1, 9, 6000, dtype=np.float32).reshape(60, 100)
    depth_m[:, 50:] = 0
    full = point_cloud(depth_m, camera)
    thin = point_cloud(depth_m, camera, limit=700)
    assert len(full.positions) == 3000
    # Every third row and column of 6000 pixels; half of those have depth.
    assert len(thin.positions) == 20 * 17
    assert {tuple(p) for p in thin.positions} <= {tuple(p) for p in full.positions}
    assert full.colors is None
    assert full.class_ids is None


def test_a_frame_without_depth_or_label_has_what_there_is(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    raw = write_gmrp(tmp_path / "raw", frames=3)
    options = {"camera": CAMERA, "modalities": ["rgb"]}
    store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    export_frames(store, tmp_path / "a.rrd", "rerun")
    chunks = RrdReader(tmp_path / "a.rrd").stream().to_chunks()
    entities = {chunk.entity_path for chunk in chunks if not chunk.is_static}
    assert entities == {"/frame", "/camera", "/camera/rgb"}


def test_without_the_extra_one_line_says_how_to_get_it(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nimprep.export.rerun.find_spec", lambda name: None)
    arguments = ["export", str(store.path), str(tmp_path / "a.rrd"), "--format", "rerun"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert "pip install 'nimprep[rerun]'" in result.stderr
    assert list(tmp_path.iterdir()) == []
