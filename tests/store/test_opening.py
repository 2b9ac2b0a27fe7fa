"""Opening a store while another takes its place gives the one or the other, never parts of both."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store.metadata import ROOT
from nimprep.store.reader import Store
from nimprep.store.resplit import resplit
from nimprep.store.storage import LocalStorage
from tests.fakes import write_gmrp
from tests.store.test_belonging import OPTIONS, SIZE, write_version

OLD = Path(__file__).parent / "data" / "format-1.0"


class Watched(LocalStorage):
    """Call something before each read, with how many there were before."""

    def __init__(self, root: Path, before: Callable[[int], object]) -> None:
        super().__init__(root)
        self.asked: list[str] = []
        self.before = before

    def read(self, key: str, limit: int | None = None) -> bytes | None:
        self.before(len(self.asked))
        self.asked.append(key)
        return super().read(key, limit)


def version(folder: Path, number: int) -> Path:
    """Return a store of five frames; those of every version have the same ids."""
    raw, target = folder / f"raw{number}", folder / f"{number}.zarr"
    return Path(nimprep.convert(write_version(raw, number), target, **OPTIONS).path)


def grown(folder: Path) -> Path:
    path = version(folder, 0)
    nimprep.append_frames(
        write_gmrp(folder / "more", 9, SIZE), path, camera=OPTIONS["camera"], skip_existing=True
    )
    return path


def old(folder: Path) -> Path:
    return Path(shutil.copytree(OLD, folder / "old.zarr"))


def old_split_anew(folder: Path) -> Path:
    path = old(folder)
    resplit(path, seed=5)
    return path


def fewer(folder: Path) -> Path:
    root = write_gmrp(folder / "fewer", 3, SIZE)
    return Path(nimprep.convert(root, folder / "fewer.zarr", **OPTIONS, labels=False).path)


PAIRS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Path]]] = {
    "converted anew": (lambda f: version(f, 0), lambda f: version(f, 1)),
    "appended to": (lambda f: version(f, 0), grown),
    "of fewer frames and modalities": (lambda f: version(f, 0), fewer),
    "of format 1.0, appended to": (old, grown),
    "of format 1.0, split anew": (old, old_split_anew),
    "of format 1.1 replaced by 1.0": (lambda f: version(f, 1), old),
}


@pytest.fixture(scope="module", params=PAIRS)
def pair(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path]:
    """Return a store, and one that takes its place."""
    folders = [tmp_path_factory.mktemp("a"), tmp_path_factory.mktemp("b")]
    first, second = PAIRS[request.param]
    return first(folders[0]), second(folders[1])


def described(store: Store) -> tuple[object, ...]:
    """Return what tells the stores of these tests apart, without their images."""
    sums = store.tables.channel_sums.tolist()
    return store.ids, store.splits, store.attributes, store.modalities, sums


def images(store: Store) -> dict[str, np.ndarray | None]:
    """Return a frame's images as they are stored; None = the store refuses to read it."""
    found: dict[str, np.ndarray | None] = {}
    for name, array in store.arrays.items():
        try:
            found[name] = array.read(2)
        except StoreError:
            found[name] = None
    return found


def reads(path: Path) -> int:
    """Return how many reads opening a store takes."""
    storage = Watched(path, lambda read: None)
    nimprep.open_store(storage)
    return len(storage.asked)


@pytest.mark.parametrize("gap", [0, 1])
def test_a_store_that_is_replaced_before_any_read_opens_as_the_one_or_the_other(
    pair: tuple[Path, Path], tmp_path: Path, gap: int
) -> None:
    """`gap`: for so many reads neither is there, as where folders cannot change names at once."""
    whole = [nimprep.open_store(path) for path in pair]
    known = [described(store) for store in whole]
    assert known[0] != known[1]
    found = set()
    for moment in range(reads(pair[0]) + 1):
        place, after = tmp_path / f"{moment}.zarr", tmp_path / f"{moment}.next"
        for path, copy in zip(pair, (place, after), strict=True):
            shutil.copytree(path, copy, copy_function=os.link)

        def replace(read: int, place: Path = place, after: Path = after, at: int = moment) -> None:
            if read == at:
                place.rename(place.with_suffix(".gone"))
            if read == at + gap:
                after.rename(place)

        store = nimprep.open_store(Watched(place, replace))
        assert described(store) in known, f"replaced before read {moment}"
        version = known.index(described(store))
        found.add(version)
        if store.attributes["format_version"] != "1.0":
            for name, image in images(store).items():
                same = whole[version].arrays[name].read(2)
                assert image is None or np.array_equal(image, same), f"before read {moment}"
    assert found == {0, 1}


def test_a_store_that_never_stays_is_given_up(tmp_path: Path) -> None:
    path = old(tmp_path)
    root = (path / ROOT).read_bytes()

    def rewrite(read: int) -> None:
        (path / ROOT).write_bytes(root + b" " * read)

    with pytest.raises(StoreError, match="stays while it is opened, found it replaced 5 times"):
        nimprep.open_store(Watched(path, rewrite))


def test_only_the_root_of_a_damaged_store_is_read_again(tmp_path: Path) -> None:
    path = version(tmp_path, 0)
    (path / "split" / "c" / "0").unlink()
    storage = Watched(path, lambda read: None)
    with pytest.raises(StoreError, match="split: expected its chunk, found none"):
        nimprep.open_store(storage)
    twice = {key for key in storage.asked if storage.asked.count(key) > 1}
    assert twice == {ROOT}
    assert storage.asked.count(ROOT) == 2


def test_a_sound_store_is_read_once(tmp_path: Path) -> None:
    storage = Watched(version(tmp_path, 0), lambda read: None)
    nimprep.open_store(storage)
    assert len(storage.asked) == len(set(storage.asked))
