"""Counted pixels, and the weights that are made of them."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from torch.utils.data import WeightedRandomSampler

import nimprep
from nimprep.errors import ArrayError, StoreError
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset
from nimprep.torch.balance import class_weights, frame_weights
from tests.checksums import renew_checksums
from tests.torch.stores import CAMERA, make_mixed_store, make_store

PIXELS = np.array([[90, 10, 0, 0], [60, 20, 0, 20], [0, 0, 0, 0]])
"""Of four classes in three frames of up to 100: one that is nowhere, one frame with no label."""


def test_inverse_weights_make_all_classes_count_alike() -> None:
    weights = class_weights(PIXELS, "inverse")
    assert weights[2] == 0
    counted = weights * PIXELS.sum(axis=0)
    np.testing.assert_allclose(counted[[0, 1, 3]], 200 / 3)


def test_median_weights_are_eigen_and_ferguss() -> None:
    # The third is in one frame, of 100 pixels; the others are in two.
    share = np.array([150 / 200, 30 / 200, 20 / 100])
    np.testing.assert_allclose(class_weights(PIXELS, "median")[[0, 1, 3]], 0.2 / share)


def test_enet_weights_are_paszkes() -> None:
    share = np.array([150, 30, 20]) / 200
    np.testing.assert_allclose(class_weights(PIXELS, "enet")[[0, 1, 3]], 1 / np.log(1.02 + share))


def test_effective_weights_are_cuis() -> None:
    b = 1 - 1 / 200
    raw = np.array([(1 - b) / (1 - b**n) for n in (150, 30, 20)])
    found = class_weights(PIXELS, "effective")
    np.testing.assert_allclose(found[[0, 1, 3]], raw / raw.mean())
    assert found[2] == 0


def test_effective_weights_of_billions_of_pixels_still_differ() -> None:
    found = class_weights(np.array([[3_000_000_000, 1_000_000_000, 1000]]), "effective")
    shares = [-math.expm1(-3 / 4), -math.expm1(-1 / 4), -math.expm1(-1000 / 4e9)]
    expected = 1 / np.array(shares)
    np.testing.assert_allclose(found, expected / expected.mean(), rtol=1e-6)


@pytest.mark.parametrize("method", ["inverse", "median", "effective", "enet"])
def test_one_class_alone_has_a_weight(method: str) -> None:
    weights = class_weights(np.array([[0, 1], [0, 0]]), method)
    assert weights[0] == 0
    assert 0 < weights[1] < 2


def test_what_no_weights_can_be_made_of_is_said() -> None:
    with pytest.raises(ArrayError, match="expected one of inverse, median, effective, enet"):
        class_weights(PIXELS, "balanced")
    with pytest.raises(ArrayError, match="expected labelled pixels"):
        class_weights(PIXELS * 0, "enet")


def test_a_frames_weight_is_that_of_its_pixels() -> None:
    weights = np.array([1.0, 2.0, 0.0, 5.0])
    found = frame_weights(PIXELS, weights)
    np.testing.assert_allclose(found, [1.1, (60 + 40 + 100) / 100, 0])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"), modalities=("rgb", "depth", "label"))


def counted(store: nimprep.Store) -> np.ndarray:
    """Count pixels by reading every label."""
    ids = [*(c.id for c in store.classes), 255]
    return np.array([[np.count_nonzero(f.label == i) for i in ids] for f in store])


def check_counted(path: Path) -> None:
    store = nimprep.open_store(path)
    assert store.tables.class_pixels is not None
    assert np.array_equal(store.tables.class_pixels, counted(store))
    assert validate_store(path, deep=True).valid


def test_a_store_counts_each_frames_classes(path: Path) -> None:
    check_counted(path)


def test_padding_is_of_no_class(tmp_path: Path) -> None:
    store = make_mixed_store(tmp_path)
    check_counted(store)
    sizes = nimprep.open_store(store).tables.image_size.prod(axis=1)
    assert np.array_equal(nimprep.open_store(store).tables.class_pixels.sum(axis=1), sizes)


def test_grown_and_merged_stores_count_on(path: Path, tmp_path: Path) -> None:
    nimprep.merge_stores([path, path], tmp_path / "two.zarr", prefixes=["a/", "b/"])
    check_counted(tmp_path / "two.zarr")
    grown = tmp_path / "grown.zarr"
    shutil.copytree(path, grown)
    raw = shutil.copytree(path.parent / "raw", tmp_path / "raw")
    for file in raw.rglob("*.png"):
        file.rename(file.with_stem("n" + file.stem))
    nimprep.append_frames(raw, grown, camera=CAMERA)
    check_counted(grown)
    assert len(nimprep.open_store(grown)) == 20


def test_stores_of_an_older_format_are_counted_by_their_labels(tmp_path: Path) -> None:
    old = Path(__file__).parent.parent / "store" / "data" / "format-1.0"
    dataset = StoreDataset(old, None, "rgb")
    assert dataset.store.tables.class_pixels is None
    expected = counted(dataset.store)[:, :-1].sum(axis=0)
    found = dataset.class_pixels()
    assert found[[c.id for c in dataset.store.classes]].tolist() == expected.tolist()


def test_another_count_than_the_labels_is_a_fault(path: Path, tmp_path: Path) -> None:
    copy = tmp_path / "s.zarr"
    shutil.copytree(path, copy)
    table = zarr.open_array(copy / "class_pixels", mode="r+")
    table[...] = table[...] + 1
    renew_checksums(copy, chunks=False)
    report = validate_store(copy, deep=True)
    assert not report.valid
    assert "class_pixels: expected the label's counts" in str(report.problems)


def test_a_split_counts_its_own_frames(path: Path) -> None:
    train, every = StoreDataset(path, "train", "rgb"), StoreDataset(path, None, "rgb")
    store = every.store
    expected = counted(store)[train.indices, :-1].sum(axis=0)
    assert train.class_pixels().tolist() == expected.tolist()
    assert train.class_pixels().dtype == torch.int64
    assert every.class_weights("enet").dtype == torch.float32
    assert every.class_weights().tolist() == pytest.approx(
        class_weights(counted(store)[:, :-1], "inverse").tolist()
    )
    torch.nn.CrossEntropyLoss(weight=every.class_weights(), ignore_index=255)


def test_frames_are_drawn_by_what_is_rare_in_them(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    weights = dataset.frame_weights()
    assert weights.shape == (10,)
    assert weights.dtype == torch.float64
    assert (weights > 0).all()
    assert len(list(WeightedRandomSampler(weights, 30))) == 30


def test_merged_classes_are_counted_together(path: Path) -> None:
    names = {"drivable area": 1, "background": 1, "road anomaly": 255}
    merged = StoreDataset(path, None, "rgb", classes=names)
    pixels = counted(merged.store)[:, :-1].sum(axis=0)
    assert merged.class_pixels().tolist() == [0, pixels[0] + pixels[1]]
    assert merged.class_weights().tolist() == [0, 1]
    assert merged.num_classes == 2
    assert StoreDataset(path, None, "rgb").num_classes == len(merged.store.classes) == 3


def test_without_labels_it_is_said(tmp_path: Path) -> None:
    store = make_store(tmp_path, labels=False, modalities=("rgb", "depth"))
    for asked in ("class_pixels", "class_weights", "frame_weights"):
        with pytest.raises(StoreError, match="expected labels, found none"):
            getattr(StoreDataset(store, None, "rgb"), asked)()
