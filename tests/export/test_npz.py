"""Export as NumPy archives: what a frame holds, readable without nimprep and without pickles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.derive.modalities import DERIVED
from nimprep.export import export_frames
from nimprep.store.reader import Store
from tests.fakes import SIZE, write_nyu_like

NAMES = {"rgb", "depth_m", "normal", "hha", "label", "K", "baseline_m", "cam_to_road", "gravity"}
NAMES |= {"id", "split", "group"}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    root = tmp_path_factory.mktemp("nyu")
    raw, description = write_nyu_like(root / "raw")
    return nimprep.convert(raw, root / "s.zarr", description=description, split_by="frame")


def test_an_archive_holds_the_frame_in_physical_units(store: Store, tmp_path: Path) -> None:
    export_frames(store, tmp_path / "out", "npz")
    for number, frame in enumerate(store):
        with np.load(tmp_path / "out" / f"{frame.id}.npz", allow_pickle=False) as found:
            assert set(found) == NAMES
            for name in ("rgb", "depth_m", "normal", "hha", "label"):
                image = getattr(frame, name)
                assert found[name].dtype == image.dtype
                np.testing.assert_array_equal(found[name], image)
            assert found["depth_m"].dtype == np.float32
            np.testing.assert_array_equal(found["K"], [[30, 0, 16], [0, 31, 12], [0, 0, 1]])
            assert found["baseline_m"].shape == ()
            assert np.isnan(found["baseline_m"])
            assert found["cam_to_road"].shape == (3, 4)
            np.testing.assert_array_equal(found["gravity"], store.tables.gravity[number])
            assert str(found["id"]) == frame.id
            assert str(found["split"]) == store.splits[frame.id]
            assert str(found["group"]) == frame.group


def test_images_have_the_frames_own_size_and_depth_is_in_metres(
    store: Store, tmp_path: Path
) -> None:
    export_frames(store, tmp_path / "out", "npz", "kitchen/1")
    assert [p.name for p in (tmp_path / "out").rglob("*.npz")] == ["1.npz"]
    with np.load(tmp_path / "out" / "kitchen" / "1.npz") as found:
        assert found["label"].shape == SIZE
        # Raw depth there is 1/10000 m, five times millimetres: from 1.5 to 6 m, halved.
        assert 0.7 < found["depth_m"][found["depth_m"] > 0].min() < 0.76
        lengths = np.linalg.norm(found["normal"], axis=2)[found["depth_m"] > 0]
        np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_the_same_store_gives_the_same_bytes(store: Store, tmp_path: Path) -> None:
    for name in "ab":
        export_frames(store, tmp_path / name, "npz")
    for path in (tmp_path / "a").rglob("*.npz"):
        other = tmp_path / "b" / path.relative_to(tmp_path / "a")
        assert path.read_bytes() == other.read_bytes()


def test_every_modality_of_the_store_is_in_it(tmp_path: Path) -> None:
    raw, description = write_nyu_like(tmp_path / "raw")
    options = {"description": description, "split_by": "frame"}
    modalities = ("rgb", "depth", *DERIVED, "label")
    store = nimprep.convert(raw, tmp_path / "s.zarr", modalities=modalities, **options)
    export_frames(store, tmp_path / "out", "npz", "0:1")
    with np.load(tmp_path / "out" / f"{store.ids[0]}.npz") as found:
        for modality in modalities:
            name = "depth_m" if modality == "depth" else modality
            np.testing.assert_array_equal(found[name], getattr(store[0], name))
