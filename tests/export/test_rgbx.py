"""The layout of CMX, DFormer and Sigma: a loader of each gets what the store has."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.export import export_frames
from nimprep.export.normal_pictures import normal_numbers
from nimprep.export.places import id_of
from nimprep.export.rgbx import depth_numbers
from nimprep.schema import schema_problems
from nimprep.splits import split_document
from nimprep.store.reader import Store
from tests.export.networks import Rgbx
from tests.fakes import write_gmrp, write_nyu_like

NETWORKS = ("cmx", "dformer", "sigma")
ALL = ("rgb", "depth", "hha", "label")

pytestmark = pytest.mark.filterwarnings("ignore:.*(8 bits|not in the store|is empty|have no depth)")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Frames in folders, labels with ignored pixels, every split."""
    root = tmp_path_factory.mktemp("rgbx")
    raw, description = write_nyu_like(root / "raw")
    return nimprep.convert(
        raw, root / "s.zarr", description=description, split_by="frame", modalities=ALL
    )


@pytest.fixture(scope="module")
def out(store: Store, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "rgbx"
    with pytest.warns(UserWarning, match="depth is in 8 bits"):
        assert export_frames(store, folder, "rgbx") == list(store.ids)
    return folder


@pytest.mark.parametrize("network", NETWORKS)
def test_a_loader_of_each_network_gets_every_frame(store: Store, out: Path, network: str) -> None:
    depth, hha = Rgbx(network, out), Rgbx(network, out, "HHA", single=False)
    step = json.loads((out / "encodings.json").read_text())["modalities"]["depth"]["scale"]
    seen = {}
    for split in ("train", "val", "test"):
        for name in depth.names(f"{split}.txt"):
            frame = store[store.ids.index(id_of(name.removeprefix("./")))]
            seen[frame.id] = split
            got = depth.load(name)
            np.testing.assert_array_equal(got.rgb, frame["rgb"][:, :, ::-1])
            np.testing.assert_array_equal(got.label, frame["label"])
            assert set(np.unique(got.label)) == {0, 1, 255}
            # One number in all channels: 0 where there is none, else 1 to 255, never stretched.
            np.testing.assert_array_equal(got.x.min(axis=2), got.x.max(axis=2))
            x, depth_m = got.x[:, :, 0].astype(np.float64), frame["depth"]
            np.testing.assert_array_equal(x == 0, depth_m == 0)
            near = (depth_m > 0) & (depth_m < 254 * step)
            assert near.mean() > 0.9
            assert np.abs(x * step - depth_m)[near].max() <= step * 0.501
            assert (x[(depth_m > 255 * step)] == 255).all()
            # OpenCV has the file's red, the horizontal disparity, last.
            np.testing.assert_array_equal(hha.load(name).x, frame["hha"][:, :, ::-1])
    assert seen == store.splits


def test_there_are_these_files_and_no_other(store: Store, out: Path) -> None:
    names = {path.name for path in out.iterdir()}
    lists = {"train.txt", "val.txt", "test.txt", "classes.txt", "encodings.json"}
    assert names == {"RGB", "Depth", "HHA", "Label", *lists}
    assert {p.name for p in (out / "RGB").iterdir()} == {
        f"{frame_id.replace('/', '%2F')}.png" for frame_id in store.ids
    }
    assert (out / "classes.txt").read_text() == "other\nfloor\n"
    document = json.loads((out / "encodings.json").read_text())
    assert schema_problems(document, "encodings") == []
    assert document["modalities"]["label"]["value"] == "png - 1"


def test_depth_in_8_bits_is_what_it_is_by_hand() -> None:
    depth_m = np.array([[0, 0.001, 0.02, 0.04, 2.55, 2.56, 60]], np.float32)
    np.testing.assert_array_equal(depth_numbers(depth_m, 2.55), [[0, 1, 2, 4, 255, 255, 255]])


def test_normals_are_what_they_are_by_hand() -> None:
    vectors = np.array([[[0, 0, 0], [1, 0, -1], [0, -1, 0]]], np.float32)
    np.testing.assert_array_equal(
        normal_numbers(vectors, 8), [[[128, 128, 128], [255, 128, 0], [128, 0, 128]]]
    )
    assert normal_numbers(vectors, 16)[0].tolist() == [
        [32768, 32768, 32768],
        [65535, 32768, 0],
        [32768, 0, 32768],
    ]


def test_what_the_store_lacks_is_made_from_its_depth(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", 4)
    options = {"camera": (30, 30, 15, 11)}
    whole = nimprep.convert(raw, tmp_path / "whole.zarr", modalities=ALL, **options)
    less = nimprep.convert(
        raw, tmp_path / "s.zarr", modalities=["rgb", "depth", "label"], **options
    )
    with pytest.warns(UserWarning, match="hha: not in the store, made from its depth"):
        export_frames(less, tmp_path / "out", "rgbx")
    loader = Rgbx("cmx", tmp_path / "out", "HHA", single=False)
    for frame in whole:
        np.testing.assert_array_equal(loader.load(frame.id).x, frame["hha"][:, :, ::-1])


def test_a_frame_without_depth_has_nothing_made_of_it(tmp_path: Path) -> None:
    depth = {"files": "depth/{id}.png", "scale_m": 0.0001, "invalid": [0], "missing": "none"}
    raw, description = write_nyu_like(tmp_path / "raw", depth=depth)
    (raw / "depth" / "office" / "1.png").unlink()
    store = nimprep.convert(
        raw,
        tmp_path / "s.zarr",
        description=description,
        split_by="frame",
        modalities=["rgb", "depth", "label"],
    )
    export_frames(store, tmp_path / "out", "rgbx")
    loader = Rgbx("sigma", tmp_path / "out", "HHA", single=False)
    assert not loader.load("office%2F1").x.any()
    assert loader.load("office%2F0").x.any()


def test_frames_without_a_split_are_left_out_and_said(store: Store, tmp_path: Path) -> None:
    path = tmp_path / "split.json"
    ids = store.ids
    path.write_text(json.dumps(split_document({ids[0]: "train", ids[1]: "val", ids[2]: "val"})))
    raw, description = write_nyu_like(tmp_path / "raw")
    other = nimprep.convert(
        raw, tmp_path / "s.zarr", description=description, split_file=path, modalities=ALL
    )
    with pytest.warns(UserWarning, match="have no split") as said:
        assert export_frames(other, tmp_path / "out", "rgbx") == list(ids[:3])
    texts = [str(warning.message) for warning in said]
    assert sum("1 of 4 frames have no split and are left out" in text for text in texts) == 1
    assert sum("test.txt is empty" in text and "val.txt" in text for text in texts) == 1
    assert (tmp_path / "out" / "test.txt").read_text() == ""
    assert len(list((tmp_path / "out" / "Label").iterdir())) == 3
    with pytest.raises(StoreError, match="expected frames of a split for --format rgbx, found 1"):
        export_frames(other, tmp_path / "none", "rgbx", frames=[ids[3]])
    assert not (tmp_path / "none").exists()


def test_the_modalities_asked_for_are_written(store: Store, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="normal: not in the store"):
        export_frames(store, tmp_path / "out", "rgbx", modalities=["label", "normal"])
    folders = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert folders == {"Normal", "Label"}
    entry = json.loads((tmp_path / "out" / "encodings.json").read_text())["modalities"]["normal"]
    assert entry["none"] == [128, 128, 128]
    with pytest.raises(StoreError, match=r"expected modalities of .* for --format rgbx, found 'x'"):
        export_frames(store, tmp_path / "none", "rgbx", modalities=["x"])
    call = ["export", str(store.path), str(tmp_path / "none"), "--format", "rgbx"]
    result = CliRunner().invoke(main, [*call, "--modalities", "disparity"])
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "none").exists()


def test_a_store_without_labels_is_refused_unless_named(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", 4, labels=False)
    options = {"camera": (30, 30, 15, 11), "modalities": ["rgb", "depth"], "labels": False}
    store = nimprep.convert(raw, tmp_path / "s.zarr", **options)
    with pytest.raises(StoreError, match="expected label for --format rgbx, found rgb, depth; con"):
        export_frames(store, tmp_path / "out", "rgbx")
    assert len(export_frames(store, tmp_path / "out", "rgbx", modalities=["rgb", "depth"])) == 4


def test_the_command_says_what_is_lost_once(store: Store, tmp_path: Path) -> None:
    call = ["export", str(store.path), str(tmp_path / "out"), "--format", "rgbx", "--quiet"]
    result = CliRunner().invoke(main, call)
    assert result.exit_code == 0
    assert result.stdout == f"{tmp_path / 'out'}: 4 frames\n"
    assert result.stderr.count("warning: ") == 1
    assert "depth is in 8 bits" in result.stderr
