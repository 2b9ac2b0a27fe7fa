"""Parts of a store at a URL belong together, as those of one in a folder do."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store import objects
from nimprep.store.objects import ObjectStorage
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset, StoreLoader
from tests.cloud.server import Proxy, Request
from tests.fakes import contents
from tests.store.test_belonging import FRAMES, IMAGES, OPTIONS, SHARDS, write_version
from tests.store.test_split_steps import STEPS, Killed, made, state


@pytest.fixture(scope="session")
def versions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return two stores in folders, of frames with the same ids and other images."""
    folder = tmp_path_factory.mktemp("versions")
    for n in range(2):
        nimprep.convert(write_version(folder / f"{n}", n), folder / f"{n}.zarr", **OPTIONS)
    return [folder / "0.zarr", folder / "1.zarr"]


def put(store: Path, storage: ObjectStorage) -> None:
    """Write a folder's files to a URL, in place of those of the same names."""
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda item: storage.write(item[0], [item[1]]), contents(store).items()))


@pytest.fixture
def store(url: str, versions: list[Path], proxy: Proxy) -> str:
    """Return the URL of the first version; requests are counted from here on."""
    put(versions[0], ObjectStorage(url))
    proxy.forget()
    return url


@pytest.mark.parametrize("used", [False, True])
def test_a_reader_opened_before_its_store_was_replaced_never_gives_the_new_images(
    store: str, versions: list[Path], used: bool
) -> None:
    opened = nimprep.open_store(store)
    loader = StoreLoader(StoreDataset(store, split=None, setup="rgb+d"), batch_size=2)
    if used:
        for array in opened.arrays.values():
            for frame in range(FRAMES):
                array.read(frame)
        assert len(list(loader)) == SHARDS
    nimprep.convert(versions[1].parent / "1", store, **OPTIONS, overwrite=True)
    for array in opened.arrays.values():
        for frame in range(FRAMES):
            with pytest.raises(StoreError, match="open it again if it was replaced"):
                array.read(frame)
    with pytest.raises(StoreError, match="open it again if it was replaced"):
        list(loader)


def test_a_shard_of_another_version_is_noticed_by_reading_and_by_validate(
    store: str, versions: list[Path]
) -> None:
    storage = ObjectStorage(store)
    for name in IMAGES:
        key = nimprep.open_store(store).arrays[name].shard_key(1)
        storage.write(key, [(versions[1] / key).read_bytes()])
    opened = nimprep.open_store(store)
    for array in opened.arrays.values():
        for frame in range(FRAMES):
            if frame // 2 != 1:
                array.read(frame)
                continue
            with pytest.raises(StoreError, match=f"frame '00000{frame}': expected the image"):
                array.read(frame)
    problems = validate_store(store).problems
    assert len(problems) == len(IMAGES)
    assert all("frame '000002': expected the image" in problem for problem in problems)


def test_validate_takes_two_requests_a_shard_where_its_chunks_lie_close(
    store: str, proxy: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked() -> list[Request]:
        proxy.forget()
        assert validate_store(store).problems == []
        return [r for r in proxy.requests if r.span is not None]

    assert len(asked()) == 2 * SHARDS * len(IMAGES)
    # Where they do not, one for each chunk, which brings four bytes.
    monkeypatch.setattr(objects, "READ_ALONG", 0)
    found = asked()
    assert len(found) == (SHARDS + FRAMES) * len(IMAGES)
    spans = [str(r.span).removeprefix("bytes=").split("-") for r in found]
    assert [int(b) - int(a) + 1 for a, b in spans if a] == [4] * FRAMES * len(IMAGES)


class Mortal(ObjectStorage):
    """Keep objects until so many of the store's own were written."""

    left = 0

    def write(self, key: str, parts: Any) -> None:
        if key in STEPS:
            if not self.left:
                raise Killed
            self.left -= 1
        super().write(key, parts)


@pytest.mark.parametrize("writes", range(len(STEPS) + 1))
def test_killed_after_any_write_a_split_is_the_old_one_or_the_new_one(
    store: str, writes: int
) -> None:
    before, after = state(store), made(store, 5)
    assert before == made(store, 0)
    storage = Mortal(store)
    storage.left = writes
    if writes < len(STEPS):
        with pytest.raises(Killed):
            resplit(storage, seed=5)
    else:
        resplit(storage, seed=5)
    assert state(store) == (before if writes < 2 else after)
    assert resplit(store, seed=1) == made(store, 1)[1]
    assert state(store) == made(store, 1)


@pytest.fixture
def direct(port: int, url: str) -> ObjectStorage:
    """Return what writes past the proxy."""
    return ObjectStorage(url, endpoint=f"http://127.0.0.1:{port}")


def test_a_store_that_is_replaced_before_any_request_opens_as_the_one_or_the_other(
    store: str, versions: list[Path], proxy: Proxy, direct: ObjectStorage
) -> None:
    whole = [nimprep.open_store(path) for path in versions]
    sums = [store.tables.channel_sums.tolist() for store in whole]
    nimprep.open_store(store)
    found = []
    for moment in range(len(proxy.requests)):
        put(versions[0], direct)
        count = iter(range(10**6))

        def replace(request: Request, count: Iterator[int] = count, at: int = moment) -> None:
            if next(count) == at:
                put(versions[1], direct)

        proxy.fault = replace
        opened = nimprep.open_store(store)
        number = sums.index(opened.tables.channel_sums.tolist())
        assert opened.attributes == whole[number].attributes
        found.append(number)
        proxy.fault = lambda request: None
    # Of all requests the root's is made first, and decides.
    assert found[0] == 1
