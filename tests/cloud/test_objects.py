"""Bytes under a URL: what a `Storage` promises, and requests that fail."""

import http.client
import os
import pickle
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import StoreError
from nimprep.store import connection, objects
from nimprep.store.access import storage_from
from nimprep.store.location import location_from
from nimprep.store.objects import ObjectStorage
from nimprep.store.storage import LocalStorage, Storage
from tests.cloud.server import Proxy, Request
from tests.processes import PATIENCE_S

BIG = random.Random(0).randbytes(objects.PART_BYTES + 12345)


@pytest.fixture(params=["folder", "bucket"])
def storage(request: pytest.FixtureRequest, tmp_path: Path) -> Storage:
    if request.param == "folder":
        return LocalStorage(tmp_path / "s")
    return ObjectStorage(request.getfixturevalue("url"))


def test_what_is_written_is_read(storage: Storage) -> None:
    storage.write("a/b", [b"hello", b" ", b"you"])
    storage.write("a/c", [b""])
    assert storage.read("a/b") == b"hello you"
    assert storage.read("a/c") == b""
    assert storage.read("none") is None
    assert storage.read_many(["a/b", "nothing"]) == {"a/b": b"hello you", "nothing": None}
    assert storage.read_tail("a/b", 3) == (b"you", 9)
    assert storage.read_tail("a/b", 300) == (b"hello you", 9)
    assert storage.read_ranges("a/b", [(0, 1), (6, 2)]) == [b"h", b"yo"]
    assert storage.read_ranges("a/b", []) == []
    out = np.zeros(4, np.uint8)
    assert storage.read_into("a/b", 2, out) == 4
    assert out.tobytes() == b"llo "
    with pytest.raises(StoreError, match="expected 200 bytes from byte 6 on, found 3"):
        storage.read_ranges("a/b", [(6, 200)])
    assert storage.sizes(["a/b", "a/c", "a/d"]) == {"a/b": 9, "a/c": 0}
    assert isinstance(storage, Storage)


def test_keys_are_moved_and_removed_with_what_is_below_them_and_no_other(storage: Storage) -> None:
    for key in ("a/b", "a/c/d", "ab", "a.b/c", "z"):
        storage.write(key, [key.encode()])
    assert storage.keys() == ["a.b/c", "a/b", "a/c/d", "ab", "z"]
    assert storage.keys("a") == ["a/b", "a/c/d"]
    assert storage.folders() == ["a", "a.b"]
    storage.move("z", "a/e")
    assert storage.read("a/e") == b"z"
    assert storage.read("z") is None
    storage.remove("a/c")
    assert storage.keys("a") == ["a/b", "a/e"]
    storage.remove("a")
    storage.remove("not there")
    assert storage.keys() == ["a.b/c", "ab"]
    storage.remove("")
    assert storage.keys() == []


def test_a_store_beside_is_left_alone(url: str) -> None:
    storage, beside = ObjectStorage(url), ObjectStorage(f"{url}2")
    storage.write("k", [b"1"])
    beside.write("k", [b"2"])
    storage.remove("")
    assert not storage.has_keys()
    assert beside.read("k") == b"2"


def test_what_is_larger_than_a_part_goes_up_in_parts(url: str, proxy: Proxy) -> None:
    storage = ObjectStorage(url)
    storage.write("big", [BIG[:1000], BIG[1000:]])
    assert storage.read("big") == BIG
    assert len([r for r in proxy.seen("PUT") if "partNumber" in r.query]) == 2


def spoil(kind: str, times: int):  # type: ignore[no-untyped-def]
    """Return a fault that befalls the first requests."""
    left = iter(range(times))
    return lambda request: kind if next(left, None) is not None else None


CALLS = {
    "read": (lambda s: s.read("a"), b"hello"),
    "tail": (lambda s: s.read_tail("a", 2), (b"lo", 5)),
    "range": (lambda s: s.read_range("a", 1, 2), b"el"),
    "ranges": (lambda s: s.read_ranges("a", [(0, 1), (4, 1)]), [b"h", b"o"]),
    "write": (lambda s: [s.write("b", [b"1"]), s.read("b")][1], b"1"),
    "parts": (lambda s: [s.write("b", [BIG]), s.read("b")][1], BIG),
    "keys": (lambda s: s.keys(), ["a"]),
    "sizes": (lambda s: s.sizes(["a"]), {"a": 5}),
    "move": (lambda s: [s.move("a", "b"), s.keys()][1], ["b"]),
    "remove": (lambda s: [s.remove("a"), s.keys()][1], []),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize("kind", ["500", "503", "reset", "lost", "cut"])
def test_a_request_that_fails_is_made_again(url: str, proxy: Proxy, name: str, kind: str) -> None:
    storage = ObjectStorage(url)
    storage.write("a", [b"hello"])
    call, expected = CALLS[name]
    proxy.fault = spoil(kind, 2)
    assert call(storage) == expected
    assert len(proxy.spoilt) == 2


@pytest.mark.parametrize("answer", [b"hello, hello", b"h", b""])
@pytest.mark.parametrize("name", ["tail", "range", "ranges"])
def test_an_answer_of_another_length_than_asked_for_is_said(
    url: str, monkeypatch: pytest.MonkeyPatch, name: str, answer: bytes
) -> None:
    storage = ObjectStorage(url)
    storage.write("a", [b"hello"])
    read = http.client.HTTPResponse.read
    # What the server says goes through the proxy, which asks by Python's own client.
    monkeypatch.setattr(
        http.client.HTTPResponse, "read", lambda r: answer if r.status == 206 else read(r)
    )
    with pytest.raises(StoreError, match=rf"/a: expected \d bytes .*, found {len(answer)}; copy"):
        CALLS[name][0](storage)


def test_places_that_lie_close_come_by_one_request(url: str, proxy: Proxy) -> None:
    storage = ObjectStorage(url)
    storage.write("a", [BIG])
    proxy.forget()
    far = objects.READ_ALONG
    spans = [(0, 4), (9, 4), (9 + far, 4), (17 + 2 * far, 4), (21 + 2 * far, 4)]
    assert storage.read_ranges("a", spans) == [BIG[start : start + 4] for start, _ in spans]
    assert len(proxy.requests) == 2


def test_a_server_that_does_not_answer_is_asked_again(url: str, proxy: Proxy) -> None:
    storage = ObjectStorage(url, client_options={"timeout": "500ms"})
    storage.write("a", [b"hello"])
    proxy.fault = spoil("stall", 1)
    assert storage.read("a") == b"hello"
    assert len(proxy.spoilt) == 1


def test_a_server_that_fails_for_good_is_given_up(
    url: str, proxy: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "RETRIES", 3)
    proxy.fault = lambda request: "503"
    with pytest.raises(
        StoreError, match=r"s3://.*/a: expected an answer of http://127.*, found 503"
    ):
        ObjectStorage(url).read("a")
    assert len(proxy.spoilt) == 4


def test_nobody_at_the_address_is_said(
    url: str, nobody: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", nobody)
    with pytest.raises(StoreError, match=rf"expected an answer of {nobody}, found .*8 r"):
        ObjectStorage(url).read("a")


def test_a_bucket_that_is_not_there_is_said(proxy: Proxy) -> None:
    storage = ObjectStorage("s3://nobody-has-this/out.zarr")
    for call in (storage.keys, lambda: storage.read("a"), lambda: storage.write("a", [b""])):
        with pytest.raises(StoreError, match="expected a bucket, found none of that name"):
            call()


def test_what_is_not_allowed_is_said_with_what_to_check(url: str, proxy: Proxy) -> None:
    proxy.fault = lambda request: "403"
    with pytest.raises(StoreError, match=r"found it denied \(403.*; check AWS_ACCESS_KEY_ID"):
        ObjectStorage(url).read("a")
    assert len(proxy.spoilt) == 1


def test_it_pickles_and_keeps_its_options(url: str) -> None:
    storage = ObjectStorage(url, client_options={"timeout": "7s"})
    storage.write("a", [b"1"])
    again = pickle.loads(pickle.dumps(storage))
    assert again.read("a") == b"1"
    assert again.options == storage.options
    assert str(again) == url


def in_a_fork(work) -> int:  # type: ignore[no-untyped-def]
    """Return the exit code of a forked process that does some work, which must not hang."""
    process = os.fork()
    if process == 0:
        threading.Timer(PATIENCE_S, os._exit, (2,)).start()
        os._exit(0 if work() else 1)
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_reads_and_leaves_its_parents_connections_alone(url: str) -> None:
    storage = ObjectStorage(url)
    storage.write("a", [b"1"])

    def work() -> bool:
        try:
            storage.read_range("none", 0, 5)
        except StoreError as error:
            named = "none: expected an object, found none" in str(error)
        storage.write("b", [b"2"])
        fine = named and storage.read("a") == b"1" and ObjectStorage(url).keys() == ["a", "b"]
        # A fork of the fork needs a helper of its own.
        return fine and in_a_fork(lambda: storage.read("b") == b"2") == 0

    assert in_a_fork(work) == 0
    assert storage.read("b") == b"2"


def test_urls_are_told_from_paths(tmp_path: Path) -> None:
    assert location_from("a/b.zarr") == Path("a/b.zarr")
    assert location_from(tmp_path) == tmp_path
    assert location_from("file:///tmp/a%20b.zarr") == Path("/tmp/a b.zarr")
    assert location_from("S3://bucket/a/out.zarr/") == "s3://bucket/a/out.zarr"
    assert location_from("https://host/out.zarr") == "https://host/out.zarr"
    assert isinstance(storage_from("file:///tmp/x"), LocalStorage)
    assert isinstance(storage_from("a:b"), LocalStorage)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("ftp://host/out.zarr", "one of s3://.*found ftp://"),
        ("memory:///out.zarr", "found memory://"),
        ("s3://", "expected a bucket"),
        ("s3://bucket/out.zarr?versionId=3", "without . and #"),
        (Path("s3://bucket/out.zarr"), "lost a slash; give it as text"),
        ("az://container/out.zarr", "Account must be specified"),
    ],
)
def test_other_urls_are_refused(place: str, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AZURE_STORAGE_ACCOUNT_NAME", raising=False)
    with pytest.raises(StoreError, match=words) as caught:
        storage_from(place).read("a")
    assert "\n" not in str(caught.value)


def test_without_the_extra_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    with pytest.raises(StoreError, match=r"obstore.*pip install 'nimprep\[cloud\]'"):
        storage_from("s3://bucket/out.zarr")


def test_a_put_under_a_condition_tells_who_was_first(url: str) -> None:
    storage = ObjectStorage(url)
    first = storage.create("lock", b"1")
    assert first is not None
    assert storage.create("lock", b"2") is None
    second = storage.replace("lock", b"3", first)
    assert second is not None
    assert storage.replace("lock", b"4", first) is None
    data, version, written = storage.look("lock") or (b"", {}, 0.0)
    assert data == b"3"
    assert version["e_tag"] == second["e_tag"]
    assert abs(time.time() - written) < 60
    storage.remove("lock")
    assert storage.replace("lock", b"5", second) is None
    assert storage.look("lock") is None


def test_a_request_counts_once_at_the_server(url: str, proxy: Proxy) -> None:
    storage = ObjectStorage(url)
    storage.write("a", [b"hello"])
    proxy.forget()
    storage.read("a")
    storage.read_tail("a", 2)
    storage.read_range("a", 1, 3)
    assert [repr(r).split("/")[-1] for r in proxy.requests] == ["a", "a bytes=-2", "a bytes=1-3"]
    assert all(isinstance(r, Request) for r in proxy.requests)


def test_many_threads_may_be_the_first_to_make_requests(url: str, proxy: Proxy) -> None:
    code = """
import sys, threading
from nimprep.store.objects import ObjectStorage
storage, errors = ObjectStorage(sys.argv[1]), []
ready = threading.Barrier(16)
def work(n):
    ready.wait()
    try:
        storage.write(f"k/{n}", [b"1"]) if n % 2 else storage.read_range("none", 0, 1)
    except Exception as error:
        if "expected an object, found none" not in str(error): errors.append(repr(error))
threads = [threading.Thread(target=work, args=(n,)) for n in range(16)]
[t.start() for t in threads]; [t.join() for t in threads]
sys.exit(str(errors[:1]) if errors else 0)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, url], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
