"""Converting to a URL: the bytes, their order, and what a kill or a fault leaves."""

import gc
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

import nimprep
from nimprep.conversion.journal import Journal
from nimprep.errors import DecodeError, LayoutError, SplitError, StoreError
from nimprep.store import connection, object_lock
from nimprep.store.objects import ObjectStorage
from nimprep.store.table_specs import table_specs
from nimprep.store.validate import validate_store
from nimprep.store.writer import StoreWriter
from tests.cloud.conftest import CAMERA
from tests.cloud.server import BUCKET, Proxy, Request
from tests.cloud.test_reading import run
from tests.fakes import contents, write_gmrp
from tests.processes import PATIENCE_S, Processes
from tests.readers.test_extra_values import write_folder

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*nominal:UserWarning"),
    # What the dead left is taken over after half a minute.
    pytest.mark.usefixtures("clock"),
]

KILLS = int(os.environ.get("NIMPREP_KILLS", "3"))
OPTIONS = {"shard_length": 2, "camera": CAMERA}
COMMAND = [sys.executable, "-m", "nimprep", "convert", "--shard-length", "2", "--workers", "1"]
INTRINSICS = ["--intrinsics", ",".join(map(str, CAMERA))]


def below(url: str) -> dict[str, bytes]:
    """Return every object of a store."""
    storage = ObjectStorage(url)
    return {
        key: data for key, data in storage.read_many(storage.keys()).items() if data is not None
    }


def beside(url: str) -> set[str]:
    """Return the names at the store's place, its own among them."""
    parent = ObjectStorage(url.rpartition("/")[0])
    return {key.partition("/")[0] for key in parent.keys()}  # noqa: SIM118 - no dict


def test_planes_of_a_dataset_are_written_and_read_by_url(url: str, tmp_path: Path) -> None:
    description = write_folder(tmp_path / "raw")
    options = {"description": description, "shard_length": 2}
    here = nimprep.convert(tmp_path / "raw", tmp_path / "s.zarr", **options)
    there = nimprep.convert(tmp_path / "raw", url, **options)
    assert below(url) == contents(here.path)
    assert there.planes == here.planes
    assert (there[3]["alpha"] == here[3]["alpha"]).all()
    assert validate_store(url, deep=True).valid


def test_no_connection_outlives_what_it_was_for(url: str, raw: Path) -> None:
    gc.collect()
    before = {id(storage) for storage in connection.live}
    gc.disable()
    try:
        # Without the collector, as in a program that makes little garbage: by its end each is gone.
        nimprep.convert(raw, url, **OPTIONS)
        nimprep.convert(raw, url, overwrite=True, **OPTIONS)
        nimprep.open_store(url)[0]
        with pytest.raises(StoreError, match="--overwrite"):
            nimprep.convert(raw, url, **OPTIONS)
        left = [str(storage) for storage in connection.live if id(storage) not in before]
    finally:
        gc.enable()
    assert left == []


def test_the_bytes_are_those_of_a_folder_and_nothing_else_is_there(
    url: str, raw: Path, local: Path, proxy: Proxy
) -> None:
    neighbour = ObjectStorage(f"{url}.old")
    neighbour.write("k", [b"1"])
    store = nimprep.convert(raw, url, **OPTIONS)
    assert store.path == url
    assert below(url) == contents(local)
    assert beside(url) == {"out.zarr", "out.zarr.old"}
    assert all(
        f"{url}/"[5:].partition("/")[2] in f"{r.path}/" or ".out.zarr.partial/" in r.path
        for r in proxy.seen("PUT")
        if r.path and ".old" not in r.path
    )


def test_it_is_not_complete_until_all_is_there(url: str, raw: Path, proxy: Proxy) -> None:
    nimprep.convert(raw, url, **OPTIONS)
    puts = [r.path.split("/", 1)[1] for r in proxy.seen("PUT")]
    ours = [path for path in puts if path.startswith("out.zarr/")]
    assert ours[0] == ours[-1] == "out.zarr/zarr.json"
    assert ours.count("out.zarr/zarr.json") == 2
    assert puts.index(".out.zarr.partial/lock") < puts.index("out.zarr/zarr.json")


def by_the_clock(request: Request) -> bool:
    """Tell whether a request comes every few seconds: a lock that is held is put anew."""
    return request.method == "PUT" and request.path.endswith("/lock")


def killed_at(
    number: int, processes: Processes, raw: Path, url: str, proxy: Proxy, *more: str
) -> tuple[int, list[Request]]:
    """Convert in a process that is killed when its n-th request comes; return its exit code."""
    started: Future[subprocess.Popen[str]] = Future()
    count = itertools.count(1)

    def fault(request: Request) -> None:
        if not by_the_clock(request) and next(count) == number:
            started.result().kill()
            started.result().wait()

    proxy.forget()
    proxy.fault = fault
    process = processes.start(
        [*COMMAND, *INTRINSICS, *more, raw, url],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    started.set_result(process)
    _, errors = process.communicate(timeout=PATIENCE_S)
    proxy.fault = lambda request: None
    assert process.returncode in (0, -signal.SIGKILL), errors
    return process.returncode, proxy.requests


def state(url: str) -> str:
    """Return what there is to open."""
    try:
        return f"{len(nimprep.open_store(url))} frames"
    except StoreError as error:
        return next(words for words in ("cut short", "nothing") if words in str(error))


@pytest.mark.filterwarnings("ignore:.*left its lock or is at work:UserWarning")
def test_killed_at_any_request_it_goes_on_and_ends_with_the_same_bytes(
    url: str, raw: Path, local: Path, proxy: Proxy, processes: Processes, tmp_path: Path
) -> None:
    nimprep.convert(raw, url, **OPTIONS)
    requests = [request for request in proxy.requests if not by_the_clock(request)]
    # The last ones open the store again.
    total = len(requests) - 1 - len(table_specs())
    # An older store, of other frames and modalities, is in the place each time.
    longer = write_gmrp(tmp_path / "longer", frames=9)
    halfway = 0
    for turn in range(KILLS):
        nimprep.convert(longer, url, overwrite=True, shard_length=1)
        number = 3 + (total - 4) * turn // max(1, KILLS - 1)
        code, seen = killed_at(number, processes, raw, url, proxy, "--overwrite")
        assert code == -signal.SIGKILL
        recorded = [r.path for r in seen if "/units/" in r.path and r.method == "PUT"][:-1]
        found = state(url)
        whole = found == "7 frames"
        assert found in ("7 frames", "9 frames", "cut short", "nothing")
        halfway += bool(recorded) and not whole
        proxy.forget()
        if whole:
            with pytest.raises(StoreError, match="found a complete store"):
                nimprep.convert(raw, url, **OPTIONS)
        else:
            # No --overwrite where the old store is gone already.
            nimprep.convert(raw, url, overwrite=found == "9 frames", **OPTIONS)
            done = [r.path for r in proxy.seen("PUT", "/rgb/c/")]
            assert len(done) <= 4 - len(recorded)
        assert below(url) == contents(local)
        assert beside(url) == {"out.zarr"}
    assert halfway > 0
    print(f"killed {KILLS} times at requests 3 to {total - 1}, {halfway} with shards done")


def test_a_store_that_came_meanwhile_is_not_taken_for_what_was_done(
    url: str, raw: Path, local: Path, tmp_path: Path
) -> None:
    source = damaged(raw, tmp_path / "bad", "000004")
    with pytest.raises(DecodeError, match="000004"):
        nimprep.convert(source, url, workers=1, **OPTIONS)
    other = write_gmrp(tmp_path / "other", frames=7)
    shutil.copy(raw / "rgb" / "000005.png", other / "rgb" / "000000.png")
    nimprep.convert(other, tmp_path / "other.zarr", **OPTIONS)
    for key, data in contents(tmp_path / "other.zarr").items():
        ObjectStorage(url).write(key, [data])
    shutil.copy(raw / "label" / "000004.png", source / "label" / "000004.png")
    nimprep.convert(source, url, overwrite=True, **OPTIONS)
    assert below(url)["rgb/c/0/0/0/0"] == contents(local)["rgb/c/0/0/0/0"]
    assert validate_store(url, deep=True).problems == []
    assert beside(url) == {"out.zarr"}


def test_a_complete_store_is_replaced_on_request_only(
    url: str, raw: Path, local: Path, proxy: Proxy, port: int
) -> None:
    nimprep.convert(raw, url, shard_length=1, seed=3)
    before = below(url)
    with pytest.raises(StoreError, match="found a complete store; use --overwrite"):
        nimprep.convert(raw, url, **OPTIONS)
    assert below(url) == before
    assert beside(url) == {"out.zarr"}
    behind = ObjectStorage(url, endpoint=f"http://127.0.0.1:{port}")
    changes: list[tuple[str, bool]] = []

    def watch(request: Request) -> None:
        """Note what the root says whenever another object is put or deleted."""
        if request.method in ("PUT", "POST") and not request.path.endswith("out.zarr/zarr.json"):
            root = behind.read("zarr.json")
            if ".partial" not in request.path and root is not None:
                complete = json.loads(root)["attributes"]["nimprep"]["complete"]
                changes.append((repr(request), complete))

    proxy.fault = watch
    nimprep.convert(raw, url, overwrite=True, **OPTIONS)
    proxy.fault = lambda request: None
    # Not complete before the first change, nor until the last; then the journal and the lock go.
    assert [what for what, complete in changes if complete] == ["POST delete"] * 2
    assert [complete for _, complete in changes][:-2] == [False] * (len(changes) - 2)
    assert below(url) == contents(local)


def test_what_ends_before_anything_is_written_leaves_the_old_store(
    url: str, raw: Path, tmp_path: Path
) -> None:
    nimprep.convert(raw, url, **OPTIONS)
    before = below(url)
    (tmp_path / "split.json").write_text('{"train": ["no such frame"]}')
    with pytest.raises(SplitError):
        nimprep.convert(raw, url, overwrite=True, split_file=tmp_path / "split.json")
    with pytest.raises(LayoutError):
        nimprep.convert(
            raw,
            url,
            overwrite=True,
            modalities=("rgb", "disparity"),
            labels=False,
            reader="kitti-road",
        )
    assert below(url) == before
    assert beside(url) == {"out.zarr"}


def test_other_objects_are_never_replaced(url: str, raw: Path) -> None:
    storage = ObjectStorage(url)
    storage.write("holiday.jpg", [b"1"])
    with pytest.raises(StoreError, match="found keys that are no nimprep store; choose another"):
        nimprep.convert(raw, url, overwrite=True, **OPTIONS)
    assert below(url) == {"holiday.jpg": b"1"}
    assert beside(url) == {"out.zarr"}


def damaged(raw: Path, folder: Path, *numbers: str) -> Path:
    shutil.copytree(raw, folder)
    for number in numbers:
        path = folder / "label" / f"{number}.png"
        path.write_bytes(path.read_bytes()[:-30])
    return folder


def test_a_bad_frame_ends_it_and_other_options_are_refused_when_it_goes_on(
    url: str, raw: Path, tmp_path: Path, proxy: Proxy
) -> None:
    source = damaged(raw, tmp_path / "bad", "000004")
    with pytest.raises(DecodeError, match="000004") as caught:
        nimprep.convert(source, url, workers=1, **OPTIONS)
    assert "the same command goes on" in caught.value.__notes__[0]
    assert beside(url) == {"out.zarr", ".out.zarr.partial"}
    with pytest.raises(StoreError, match="cut short"):
        nimprep.open_store(url)
    with pytest.raises(StoreError, match="seed 0 then and 3 now; give those again, or --restart"):
        nimprep.convert(source, url, seed=3, **OPTIONS)
    shutil.copy(raw / "label" / "000004.png", source / "label" / "000004.png")
    proxy.forget()
    nimprep.convert(source, url, **OPTIONS)
    assert {r.path.split("/c/")[1] for r in proxy.seen("PUT", "/rgb/c/")} == {"2/0/0/0", "3/0/0/0"}
    assert validate_store(url, deep=True).problems == []


def test_where_nothing_was_done_nothing_is_left(url: str, raw: Path, tmp_path: Path) -> None:
    source = damaged(raw, tmp_path / "bad", "000001")
    with pytest.raises(DecodeError, match="000001"):
        nimprep.convert(source, url, workers=1, **OPTIONS)
    assert beside(url) == set()


def test_skipped_frames_leave_no_gap(url: str, raw: Path, tmp_path: Path) -> None:
    source = damaged(raw, tmp_path / "bad", "000001", "000004")
    here = tmp_path / "here.zarr"
    nimprep.convert(source, here, on_error="skip", **OPTIONS)
    nimprep.convert(source, url, on_error="skip", **OPTIONS)
    assert below(url) == contents(here)
    assert beside(url) == {"out.zarr"}


@pytest.mark.parametrize("every", [5, 4])
def test_requests_that_fail_now_and_then_change_nothing(
    url: str,
    raw: Path,
    local: Path,
    proxy: Proxy,
    every: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(object_lock, "BEAT_S", 0.1)  # among them the lock's
    kinds = ("503", "reset", "lost", "cut", "500")
    count = itertools.count()

    def fault(request: Request) -> str | None:
        number = next(count)
        return kinds[number // every % len(kinds)] if number % every == 0 else None

    proxy.fault = fault
    nimprep.convert(raw, url, **OPTIONS)
    proxy.fault = lambda request: None
    assert len(proxy.spoilt) > 20
    assert below(url) == contents(local)
    assert beside(url) == {"out.zarr"}


def test_a_store_out_of_reach_halfway_ends_it_and_it_goes_on_later(
    url: str, raw: Path, local: Path, proxy: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "RETRIES", 2)
    proxy.fault = lambda request: "503" if request.path.endswith("depth/c/2/0/0") else None
    with pytest.raises(StoreError, match=r"depth/c/2/0/0: expected an answer of .*found 503") as e:
        nimprep.convert(raw, url, **OPTIONS)
    # The unit behind it may have been written already.
    assert re.match("[45] of 7 frames are kept", e.value.__notes__[0])
    proxy.fault = lambda request: None
    with pytest.warns(UserWarning, match="left its lock or is at work; watching it for up to"):
        nimprep.convert(raw, url, **OPTIONS)
    assert below(url) == contents(local)
    assert beside(url) == {"out.zarr"}


def failing(call: Callable[[], object]) -> str:
    with pytest.raises(StoreError) as caught:
        call()
    return str(caught.value)


def test_what_cannot_be_written_is_one_line_and_exit_1(
    url: str, raw: Path, proxy: Proxy, nobody: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, _, err = run("convert", raw, "s3://nobody-has-this/out.zarr", *INTRINSICS)
    assert (code, err.count("\n")) == (1, 1)
    assert "expected a bucket, found none of that name; make it first" in err
    proxy.fault = lambda request: "403" if request.method == "PUT" else None
    code, _, err = run("convert", raw, url, *INTRINSICS)
    assert (code, err.count("\n")) == (1, 1)
    assert "expected access, found it denied (403" in err
    proxy.fault = lambda request: None
    monkeypatch.setenv("AWS_ENDPOINT_URL", nobody)
    code, _, err = run("convert", raw, url, *INTRINSICS)
    assert (code, err.count("\n")) == (1, 1)
    assert f"expected an answer of {nobody}" in err


def test_a_bucket_is_no_name_for_a_store_and_a_url_no_source(raw: Path, proxy: Proxy) -> None:
    assert "expected a name for the store in the bucket" in failing(
        lambda: nimprep.convert(raw, f"s3://{BUCKET}")
    )
    with pytest.raises(LayoutError, match="local or mounted, found a URL"):
        nimprep.convert(f"s3://{BUCKET}/raw", "out.zarr")
    assert proxy.requests == []


def test_keys_that_are_not_nimpreps_are_named_and_stay(url: str, raw: Path, proxy: Proxy) -> None:
    storage = ObjectStorage(url)
    nimprep.convert(raw, url, **OPTIONS)
    for key in ("notes.txt", "runs/a/checkpoint.pt", "rgb/notes.txt", "hha2/zarr.json"):
        storage.write(key, [b"mine"])
        before = below(url)
        with pytest.raises(StoreError, match=f"found '{key}', which would be lost"):
            nimprep.convert(raw, url, overwrite=True, **OPTIONS)
        assert below(url) == before
        storage.remove(key)
    nimprep.convert(raw, url, overwrite=True, **OPTIONS)


def test_attributes_that_are_not_nimpreps_are_named_and_stay(
    url: str, raw: Path, proxy: Proxy
) -> None:
    storage = ObjectStorage(url)
    nimprep.convert(raw, url, **OPTIONS)
    root = json.loads(storage.read("zarr.json") or b"")
    root["attributes"]["license"] = "CC-BY-4.0"
    storage.write("zarr.json", [json.dumps(root).encode()])
    before = below(url)
    with pytest.raises(StoreError, match="found attribute 'license', which would be lost"):
        nimprep.convert(raw, url, overwrite=True, **OPTIONS)
    assert below(url) == before


def test_what_comes_while_a_store_is_replaced_stays(
    url: str, raw: Path, tmp_path: Path, proxy: Proxy
) -> None:
    storage = ObjectStorage(url)
    nimprep.convert(raw, url, **OPTIONS)

    def progress(step: str, frames: int) -> Callable[[], None]:
        storage.write("notes.txt", [b"mine"])
        return lambda: None

    # Looking for what to crop comes first, before the old store goes.
    small = {"camera": CAMERA, "modalities": ("rgb",), "crop": "auto"}
    nimprep.convert(raw, url, overwrite=True, progress=progress, **small)
    found = below(url)
    assert found.pop("notes.txt") == b"mine"
    nimprep.convert(raw, tmp_path / "plain.zarr", **small)
    assert found == contents(tmp_path / "plain.zarr")


@pytest.mark.parametrize("times", [1, 100])
@pytest.mark.parametrize("fault", ["cut short", "not listed"])
def test_a_record_that_an_answer_leaves_out_costs_no_frame(
    fault: str, times: int, url: str, raw: Path, local: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, keys = ObjectStorage.read, ObjectStorage.keys
    left = [times]

    def spoilt(key: str) -> bool:
        left[0] -= key.endswith("units/1.json")
        return key.endswith("units/1.json") and left[0] >= 0

    def less(self: ObjectStorage, key: str, limit: int | None = None) -> bytes | None:
        data = read(self, key, limit)
        return data[:-9] if data and fault == "cut short" and spoilt(key) else data

    def fewer(self: ObjectStorage, prefix: str = "") -> list[str]:
        found = keys(self, prefix)
        return [key for key in found if not (fault == "not listed" and spoilt(f"{prefix}/{key}"))]

    with monkeypatch.context() as patch:
        patch.setattr(ObjectStorage, "read", less)
        patch.setattr(ObjectStorage, "keys", fewer)
        if fault == "cut short" and times > 1:
            with pytest.raises(StoreError, match=r"found those of \[1\] lost or damaged"):
                nimprep.convert(raw, url, **OPTIONS)
            assert state(url) in ("cut short", "nothing")
        else:
            nimprep.convert(raw, url, **OPTIONS)
    if state(url) != "7 frames":
        nimprep.convert(raw, url, **OPTIONS)
    assert below(url) == contents(local)


def cut_before_the_end(source: Path, url: str, **options: object) -> None:
    """Convert, and end it when every unit is done and nothing is left but to complete the store."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(StoreWriter, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            nimprep.convert(source, url, **options)


@pytest.mark.parametrize("begun", [False, True], ids=["fresh", "gone on with"])
@pytest.mark.parametrize("bad", [(), ("000001", "000004")], ids=["without gaps", "with gaps"])
def test_no_listing_has_to_be_right(
    bad: tuple[str, ...],
    begun: bool,
    url: str,
    raw: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source, options = damaged(raw, tmp_path / "raw", *bad), {**OPTIONS, "on_error": "skip"}
    nimprep.convert(source, tmp_path / "here.zarr", **options)
    if begun:
        cut_before_the_end(source, url, **options)
    with monkeypatch.context() as patch:
        patch.setattr(ObjectStorage, "keys", lambda self, prefix="": [])
        nimprep.convert(source, url, **options)
    assert below(url) == contents(tmp_path / "here.zarr")


@pytest.mark.parametrize("fault", ["none", "gone", "cut short", "another's"])
def test_a_shard_that_is_spoilt_before_the_end_is_made_again_for_one_request_a_shard(
    fault: str, url: str, raw: Path, local: Path, proxy: Proxy, monkeypatch: pytest.MonkeyPatch
) -> None:
    place, done, whole = "label/c/{}/0/0".format, [], Journal.whole

    def spoilt(self: Journal) -> Any:
        if done:
            return whole(self)
        done.append(self)
        storage = ObjectStorage(url)
        data, other = storage.read(place(1)), storage.read(place(2))
        assert data is not None
        assert other is not None
        if fault == "gone":
            storage.remove(place(1))
        elif fault != "none":
            storage.write(place(1), [data[:-9] if fault == "cut short" else other])
        proxy.forget()
        return whole(self)

    monkeypatch.setattr(Journal, "whole", spoilt)
    nimprep.convert(raw, url, **OPTIONS)
    shards = [r for r in proxy.requests if r.span is not None]
    if fault == "none":
        assert len(shards) == 4 * len(nimprep.open_store(local).modalities)
        assert {r.span for r in shards} == {"bytes=-40"}
    assert below(url) == contents(local)


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("fault", ["gone", "cut short", "another's"])
def test_a_shard_that_is_spoilt_while_nothing_runs_is_made_again(
    fault: str, number: int, url: str, raw: Path, local: Path
) -> None:
    cut_before_the_end(raw, url, **OPTIONS)
    storage, place = ObjectStorage(url), "label/c/{}/0/0".format
    data, other = storage.read(place(number)), storage.read(place((number + 1) % 4))
    assert data is not None
    assert other is not None
    if fault == "gone":
        storage.remove(place(number))
    else:
        storage.write(place(number), [data[:-9] if fault == "cut short" else other])
    nimprep.convert(raw, url, **OPTIONS)
    assert below(url) == contents(local)


def test_what_a_listing_leaves_of_an_older_plan_counts_for_nothing(
    url: str, raw: Path, local: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = damaged(raw, tmp_path / "bad", "000004")
    with pytest.raises(DecodeError, match="000004"):
        nimprep.convert(source, url, workers=1, **OPTIONS)
    # Somebody puts another store, a complete one, there.
    other = write_gmrp(tmp_path / "other", frames=7)
    shutil.copy(raw / "rgb" / "000005.png", other / "rgb" / "000000.png")
    nimprep.convert(other, tmp_path / "other.zarr", **OPTIONS)
    for key, data in contents(tmp_path / "other.zarr").items():
        ObjectStorage(url).write(key, [data])
    shutil.copy(raw / "label" / "000004.png", source / "label" / "000004.png")
    keys = ObjectStorage.keys

    def fewer(self: ObjectStorage, prefix: str = "") -> list[str]:
        return [] if self.url.endswith("/journal") else keys(self, prefix)

    with monkeypatch.context() as patch:
        patch.setattr(ObjectStorage, "keys", fewer)
        nimprep.convert(source, url, overwrite=True, **OPTIONS)
    assert below(url)["rgb/c/0/0/0/0"] == contents(local)["rgb/c/0/0/0/0"]
    assert validate_store(url, deep=True).problems == []
