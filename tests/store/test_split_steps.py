"""A split is changed in one step: whoever reads sees the old rule and codes, or the new ones."""

import shutil
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.splits import assign_splits
from nimprep.store.info import store_info
from nimprep.store.metadata import read_attributes
from nimprep.store.resplit import resplit
from nimprep.store.storage import LocalStorage
from nimprep.store.validate import validate_store
from tests.fakes import write_gmrp

STEPS = ("zarr.json", "split/c/0", "zarr.json")
"""What `split` writes, in order."""


class Killed(BaseException):
    """What nobody catches."""


class Mortal(LocalStorage):
    """Keep files in a folder until so many of the store's own were written."""

    def __init__(self, root: Path, writes: int, error: BaseException | None = None) -> None:
        super().__init__(root)
        self.left = writes
        self.written: list[str] = []
        self.error = error or Killed()

    def write(self, key: str, parts: Any) -> None:
        if key in STEPS and not self.left:
            raise self.error
        super().write(key, parts)
        if key in STEPS:
            self.written.append(key)
            self.left -= 1


@pytest.fixture(params=["1.0", "1.1"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a store of each format."""
    old = Path(__file__).parent / "data" / "format-1.0"
    if request.param == "1.0":
        return Path(shutil.copytree(old, tmp_path / "s.zarr"))
    root = write_gmrp(tmp_path / "raw", 5, (12, 16))
    path = nimprep.convert(root, tmp_path / "s.zarr", camera=(15.0, 15.5, 7.5, 5.5)).path
    return Path(path)


def state(store: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the rule and the splits that a reader sees; the store is valid."""
    opened = nimprep.open_store(store)
    assert validate_store(store).problems == []
    assert "split_before" not in opened.attributes
    info = store_info(store)["split"]
    assert {k: v for k, v in info.items() if k != "frames"} == opened.attributes["split"]
    return opened.attributes["split"], opened.splits


def made(store: Path, seed: int) -> tuple[dict[str, Any], dict[str, str]]:
    ids = nimprep.open_store(store).ids
    splits = assign_splits(dict.fromkeys(ids, ""), "frame", seed, {})
    return {"rule": "frame", "seed": seed}, dict(splits)


def test_split_writes_what_is_to_be_then_the_codes_then_what_is(store: Path) -> None:
    storage = Mortal(store, 9)
    resplit(storage, seed=5)
    assert tuple(storage.written) == STEPS
    assert "split_before" not in read_attributes(store)


@pytest.mark.parametrize("writes", range(len(STEPS) + 1))
def test_killed_after_any_write_a_split_is_the_old_one_or_the_new_one(
    store: Path, writes: int
) -> None:
    before, after = state(store), made(store, 5)
    assert before == made(store, 0)
    assert before[1] != after[1]
    if writes < len(STEPS):
        with pytest.raises(Killed):
            resplit(Mortal(store, writes), seed=5)
    else:
        resplit(Mortal(store, writes), seed=5)
    # Writing the codes is what changes it.
    assert state(store) == (before if writes < 2 else after)
    assert resplit(store, seed=1) == made(store, 1)[1]
    assert state(store) == made(store, 1)
    assert "split_before" not in read_attributes(store)


@pytest.mark.parametrize("first", range(len(STEPS)))
@pytest.mark.parametrize("second", range(len(STEPS)))
def test_killed_twice_a_split_is_one_of_the_three(store: Path, first: int, second: int) -> None:
    rules = [made(store, seed) for seed in (0, 5, 1)]
    assert len({tuple(splits.values()) for _, splits in rules}) == 3
    with pytest.raises(Killed):
        resplit(Mortal(store, first), seed=5)
    with pytest.raises(Killed):
        resplit(Mortal(store, second), seed=1)
    expected = 2 if second == 2 else 1 if first == 2 else 0
    assert state(store) == rules[expected]
    resplit(store, seed=0)
    assert state(store) == rules[0]


def test_a_split_that_moves_no_frame_changes_the_rule_in_one_write(
    store: Path, tmp_path: Path
) -> None:
    from nimprep.splits import write_split_file

    splits = nimprep.open_store(store).splits
    write_split_file(tmp_path / "split.json", splits)
    storage = Mortal(store, 9)
    assert resplit(storage, split_file=tmp_path / "split.json") == splits
    assert storage.written == ["zarr.json"]
    assert state(store) == ({"rule": "file"}, splits)


def test_a_disk_that_is_full_at_the_last_write_leaves_the_new_split(store: Path) -> None:
    resplit(Mortal(store, 2, StoreError("no room")), seed=5)
    assert state(store) == made(store, 5)


@pytest.mark.parametrize("writes", [1, 2])
def test_a_store_whose_split_was_cut_short_is_appended_to_and_merged_by_what_is_in_force(
    tmp_path: Path, writes: int
) -> None:
    camera = (15.0, 15.5, 7.5, 5.5)
    root = write_gmrp(tmp_path / "raw", 5, (12, 16))
    path = Path(nimprep.convert(root, tmp_path / "s.zarr", camera=camera).path)
    with pytest.raises(Killed):
        resplit(Mortal(path, writes), seed=5)
    rule, splits = made(path, 0 if writes < 2 else 5)
    merged = nimprep.merge_stores([path, path], tmp_path / "m.zarr", prefixes=["a/", "b/"])
    assert merged.attributes["split"] == rule
    assert merged.splits == {f"{p}{i}": s for p in ("a/", "b/") for i, s in splits.items()}
    write_gmrp(root, 7, (12, 16))
    done = nimprep.append_frames(root, path, camera=camera, skip_existing=True)
    assert done.store.attributes["split"] == rule
    assert {i: done.store.splits[i] for i in splits} == splits
    for grown in (path, tmp_path / "m.zarr"):
        assert "split_before" not in read_attributes(grown)
        assert validate_store(grown, deep=True).problems == []
