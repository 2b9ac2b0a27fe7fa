"""The lock of an object store: held while its holder lives, taken over from the dead."""

import itertools
import os
import threading
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion import object_lock
from nimprep.conversion.object_lock import ObjectLock
from nimprep.errors import StoreError
from nimprep.store.objects import ObjectStorage
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
            with pytest.raises(StoreError, match="found that another conversion took it over"):
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
