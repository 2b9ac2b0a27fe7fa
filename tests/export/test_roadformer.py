"""RoadFormer's layout: its loader gets the store's colours, normals and labels, by split."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.export import export_frames
from nimprep.export.places import id_of
from nimprep.schema import schema_problems
from nimprep.store.reader import Store
from tests.export.networks import RoadFormer
from tests.fakes import write_gmrp, write_nyu_like

SPLITS = {"train": "training", "val": "validation", "test": "testing"}

pytestmark = pytest.mark.filterwarnings("ignore:.*not in the store")


@pytest.fixture(scope="module", params=["int8", "int16"])
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("roadformer")
    raw, description = write_nyu_like(root / "raw")
    return nimprep.convert(
        raw,
        root / "s.zarr",
        description=description,
        split_by="frame",
        modalities=["rgb", "depth", "normal", "label"],
        normal_dtype=request.param,
    )


def test_its_loader_gets_every_frame(store: Store, tmp_path: Path) -> None:
    assert export_frames(store, tmp_path / "out", "roadformer") == list(store.ids)
    loader = RoadFormer(tmp_path / "out")
    seen = {}
    for split, folder in SPLITS.items():
        for name in loader.names(folder):
            frame = store[store.ids.index(id_of(name.removesuffix(".png")))]
            seen[frame.id] = split
            got = loader.load(folder, name)
            np.testing.assert_array_equal(got.rgb, frame["rgb"])
            np.testing.assert_array_equal(got.label, frame["label"])
            assert (frame["label"] == 255).any()
            # The network's input, (n + 1) / 2, to half a step; no normal is its middle.
            assert np.abs(got.x * 2 - 1 - frame["normal"]).max() <= 1.01 / 65535
            none = ~frame["normal"].any(axis=2)
            assert none.any()
            lengths = np.linalg.norm(got.x * 2.0 - 1, axis=2)
            assert lengths[none].max() < 1e-3
            assert np.abs(lengths[~none] - 1).max() < 1e-3
    assert seen == store.splits


def test_there_are_these_files_and_no_other(store: Store, tmp_path: Path) -> None:
    out = tmp_path / "out"
    export_frames(store, out, "roadformer")
    folders = {"images", "normal", "annotations"}
    assert {path.name for path in out.iterdir()} == {*folders, "classes.txt", "encodings.json"}
    for folder in folders:
        assert {path.name for path in (out / folder).iterdir()} == set(SPLITS.values())
    document = json.loads((out / "encodings.json").read_text())
    assert schema_problems(document, "encodings") == []
    entry = document["modalities"]["normal"]
    assert entry["files"] == "normal/{split}/{id}.png"
    assert (entry["bits"], entry["none"]) == (16, [32768] * 3)
    # What the file says of itself gives the store's vectors.
    frame = store[0]
    folder = SPLITS[store.splits[frame.id]]
    name = entry["files"].format(split=folder, id=frame.id.replace("/", "%2F"))
    png = cv2.imread(str(out / name), cv2.IMREAD_UNCHANGED)[:, :, ::-1].astype(np.float64)
    values = (png - entry["subtract"]) * entry["scale"] + entry["offset"]
    assert np.abs(values - frame["normal"]).max() <= 1.01 / 65535


def test_normals_are_made_where_the_store_lacks_them(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", 4)
    options = {"camera": (30, 30, 15, 11), "normal_dtype": "int16"}
    whole = nimprep.convert(raw, tmp_path / "whole.zarr", **options)
    less = nimprep.convert(
        raw, tmp_path / "s.zarr", modalities=["rgb", "depth", "label"], camera=options["camera"]
    )
    with pytest.warns(UserWarning, match="normal: not in the store, made from its depth"):
        export_frames(less, tmp_path / "out", "roadformer")
    loader = RoadFormer(tmp_path / "out")
    for frame in whole:
        got = loader.load(SPLITS[whole.splits[frame.id]], f"{frame.id}.png")
        assert np.abs(got.x * 2 - 1 - frame["normal"]).max() < 1e-4
    bare = nimprep.convert(
        raw, tmp_path / "bare.zarr", modalities=["rgb", "label"], camera=options["camera"]
    )
    with pytest.raises(StoreError, match="expected normal for --format roadformer, found rgb, l"):
        export_frames(bare, tmp_path / "none", "roadformer")


def test_depth_is_written_where_it_is_asked_for(store: Store, tmp_path: Path) -> None:
    export_frames(store, tmp_path / "out", "roadformer", modalities=["rgb", "depth", "label"])
    assert not (tmp_path / "out" / "normal").exists()
    loader = RoadFormer(tmp_path / "out", "depth")
    for split, folder in SPLITS.items():
        names = loader.names(folder)
        assert len(names) == sum(found == split for found in store.splits.values())
        for name in names:
            index = store.ids.index(id_of(name.removesuffix(".png")))
            stored = store.arrays["depth"].read(index)
            np.testing.assert_array_equal(loader.load(folder, name).x, stored)
