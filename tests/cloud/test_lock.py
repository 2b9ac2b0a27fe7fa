"""The lock of an object store: held while its holder lives, taken over from the dead."""

import itertools
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store import object_lock
from nimprep.store import resplit as resplit_module
from nimprep.store.lock import changing
from nimprep.store.object_lock import ObjectLock
from nimprep.store.objects import ObjectStorage
from nimprep.store.resplit import resplit
from tests.cloud.clock import Clock
from tests.cloud.conftest import CAMERA
from tests.cloud.server import Proxy, Request
from tests.cloud.test_converting import below, beside
from tests.fakes import contents
from tests.processes import PATIENCE_S

pytestmark = pytest.mark.filterwarnings("ignore:.*left its lock or is at work:UserWarning")

OPTIONS = {"shard_length": 2, "camera": CAMERA}


def hidden(url: str) -> ObjectStorage:
    return ObjectStorage(url).sibling(".out.zarr.partial")


def test_of_two_at_once_the_second_is_refused(
    url: str, raw: Path, local: Path, clock: Clock
) -> None:
    words = rf"found one at work, process {os.getpid()} on "
    with ObjectLock(hidden(url), "lock", url) as first:
        clock.while_asleep = first._renew  # while the second waits
        with pytest.raises(StoreError, match=words):
            nimprep.convert(raw, url, **OPTIONS)
    assert 0 < clock.slept_s < object_lock.STALE_S
    nimprep.convert(raw, url, **OPTIONS)
    assert below(url) == contents(local)


def test_a_lock_that_was_taken_over_stops_whoever_held_it(
    url: str, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = ObjectLock(hidden(url), "lock", url)
    monkeypatch.setattr(first, "_beat", lambda: None)  # as a machine that sleeps
    first._heart = threading.Thread(target=first._beat)
    with first:
        first.check()
        with ObjectLock(hidden(url), "lock", url) as second:
            assert clock.slept_s > object_lock.STALE_S
            with pytest.raises(StoreError, match="found that another command took it over"):
                first.check()
            second.check()
    assert beside(url) == set()


def test_a_lock_of_long_ago_is_taken_over_at_once(url: str, clock: Clock) -> None:
    hidden(url).write("lock", [b"what is this"])
    clock.slept_s = 2 * object_lock.ANCIENT_S
    with ObjectLock(hidden(url), "lock", url) as lock:
        lock.check()
    assert clock.slept_s == 2 * object_lock.ANCIENT_S
    assert beside(url) == set()


@pytest.mark.parametrize("kind", ["reset", "lost", "cut", "503"])
def test_a_lock_holds_although_answers_get_lost(
    url: str, proxy: Proxy, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(object_lock, "BEAT_S", 0.01)
    count, often = itertools.count(1), threading.Event()

    def fault(request: Request) -> str | None:
        if request.method != "PUT":
            return None
        number = next(count)
        if number == 9:
            often.set()
        return kind if number % 2 else None

    proxy.fault = fault
    with ObjectLock(hidden(url), "lock", url) as lock:
        assert often.wait(PATIENCE_S)
        lock.check()
    assert beside(url) == set()
    assert len(proxy.spoilt) >= 4


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> list[ObjectLock]:
    """Return the locks that are taken; the first is renewed whenever somebody waits."""
    locks: list[ObjectLock] = []
    enter = ObjectLock.__enter__

    def entered(self: ObjectLock) -> ObjectLock:
        locks.append(enter(self))
        return locks[-1]

    monkeypatch.setattr(ObjectLock, "__enter__", entered)
    clock.while_asleep = lambda: locks[-1]._renew()
    return locks


def test_while_a_command_changes_a_store_every_other_is_refused(
    url: str, raw: Path, held: list[ObjectLock]
) -> None:
    nimprep.convert(raw, url, **OPTIONS)
    before = below(url)
    words = rf"found one at work, process {os.getpid()} on "
    changes = [
        lambda: resplit(url, seed=3),
        lambda: nimprep.convert(raw, url, overwrite=True, seed=4, **OPTIONS),
    ]
    with changing(url):
        for change in changes:
            with pytest.raises(StoreError, match=words):
                change()
    assert below(url) == before
    assert beside(url) == {"out.zarr"}

    def progress(step: str, frames: int) -> Callable[[], None]:
        with pytest.raises(StoreError, match=f"({words}|found one whose conversion was cut short)"):
            resplit(url, seed=3)
        return lambda: None

    nimprep.convert(raw, url, overwrite=True, progress=progress, **OPTIONS)
    assert below(url) == before
    changes[0]()
    assert nimprep.open_store(url).attributes["split"]["seed"] == 3
    assert beside(url) == {"out.zarr"}


def test_a_split_whose_lock_was_taken_over_writes_nothing(
    url: str, raw: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = ObjectStorage(str(nimprep.convert(raw, url, **OPTIONS).path))
    before = below(url)
    assign = resplit_module.assign_splits

    def slowly(*arguments: object) -> object:
        # As on a machine that slept: the lock is somebody else's by now.
        hidden(url).write("lock", [b"of another process"])
        clock.slept_s += 60.0
        return assign(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(resplit_module, "assign_splits", slowly)
    with pytest.raises(StoreError, match="found that another command took it over"):
        resplit(storage, seed=3)
    assert storage.before_write is None
    assert below(url) == before
