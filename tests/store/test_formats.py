"""Stores of earlier formats, as the versions that had them wrote them."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.store.info import info_text, store_info
from nimprep.store.validate import validate_store
from tests.fakes import depth_image

DATA = Path(__file__).parent / "data"
SIZE = (12, 16)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Return a store of format 1.0: five frames of every modality, three to a shard."""
    return Path(shutil.copytree(DATA / "format-1.0", tmp_path / "old.zarr"))


def depth(number: int) -> np.ndarray:
    """Return the depth that frame `number` was made from, metres."""
    raw = depth_image(number, SIZE)
    return np.where(raw == 65535, 0, raw) / np.float32(1000)


def test_a_store_of_format_1_0_is_small_and_of_that_format() -> None:
    assert sum(p.stat().st_size for p in (DATA / "format-1.0").rglob("*") if p.is_file()) < 60_000
    assert nimprep.open_store(DATA / "format-1.0").attributes["format_version"] == "1.0"


def test_a_store_of_format_1_0_reads_as_what_was_converted(old: Path) -> None:
    store = nimprep.open_store(old)
    assert store.ids == tuple(f"{n:06d}" for n in range(5))
    assert list(store.splits.values()) == ["test", "train", "val", "train", "train"]
    for number, frame in enumerate(store):
        assert frame.rgb is not None
        assert frame.label is not None
        assert frame.hha is not None
        assert frame.normal is not None
        rgb = np.random.default_rng(number).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
        assert np.array_equal(frame.rgb, rgb)
        assert np.array_equal(frame.depth_m, depth(number))
        assert np.unique(frame.label).tolist() == [0, 1, 2]
        assert np.array_equal(frame.normal.any(axis=2), depth(number) > 0)
        assert np.array_equal(frame.hha, nimprep.encode_hha(depth(number), frame.camera))


@pytest.mark.parametrize("deep", [False, True])
def test_a_store_of_format_1_0_is_valid(old: Path, deep: bool) -> None:
    report = validate_store(old, deep=deep)
    assert report.problems == []
    assert report.frames == 5


def test_info_says_which_format_a_store_has(old: Path) -> None:
    text = info_text(store_info(old))
    assert "(format 1.0)" in text
    assert "5 frames of 16x12 pixels" in text
