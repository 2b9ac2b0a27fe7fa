from pathlib import Path

import pytest
import torch

from nimprep.frame import MODALITIES
from nimprep.torch import Normalize, StoreDataset, StoreLoader
from tests.torch.stores import make_store


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


@pytest.mark.parametrize("normalize", ["constants", "train", "none"])
@pytest.mark.parametrize(
    "choice",
    [
        {"setup": "nim-rgb+d"},
        {"setup": "rgb+d", "fusion": True},
        {"setup": "rgb+hha"},
        {"modalities": ("depth", "normal", "hha", "label")},
        {"setup": "rgb+t-disparity"},
        {"modalities": ("disparity", "transformed_disparity", "elevation")},
    ],
    ids=lambda choice: next(iter(choice.values())),
)
def test_a_stored_batch_becomes_what_the_float_dataset_gives(
    path: Path, choice: dict, normalize: str
) -> None:
    ready = StoreDataset(path, None, normalize=normalize, **choice)
    stored = StoreDataset(path, None, normalize=normalize, dtype="stored", **choice)
    finish = Normalize(stored)
    for a, b in zip(StoreLoader(ready, 4), StoreLoader(stored, 4), strict=True):
        found = finish(b)
        assert found.keys() == a.keys()
        assert found["id"] == a["id"]
        for name in a.keys() - {"id"}:
            expected = a[name] if isinstance(a[name], tuple) else (a[name],)
            given = found[name] if isinstance(found[name], tuple) else (found[name],)
            for x, y in zip(expected, given, strict=True):
                torch.testing.assert_close(y, x, atol=2e-7, rtol=1e-6)


def test_stored_tensors_have_the_stores_types(path: Path) -> None:
    sample = StoreDataset(path, None, modalities=MODALITIES, dtype="stored")[0]
    assert {name: str(sample[name].dtype).split(".")[1] for name in MODALITIES} == {
        "rgb": "uint8",
        "depth": "uint16",
        "normal": "int8",
        "hha": "uint8",
        "disparity": "uint16",
        "transformed_disparity": "int16",
        "elevation": "int16",
        "label": "uint8",
    }
    assert [len(sample[name]) for name in MODALITIES[:-1]] == [3, 1, 3, 3, 1, 1, 1]


def test_one_sample_can_be_finished_too(path: Path) -> None:
    stored = StoreDataset(path, None, "nim-rgb+d", dtype="stored")
    found = Normalize(stored)(stored[5])["inputs"]
    expected = StoreDataset(path, None, "nim-rgb+d")[5]["inputs"]
    torch.testing.assert_close(found, expected, atol=2e-7, rtol=1e-6)
