"""Reading a store from its URL: what it costs, and that nothing differs from a folder."""

import json
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import zarr
from click.testing import CliRunner
from torch.utils.data import DataLoader

import nimprep
from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.store.info import store_info
from nimprep.store.objects import ObjectStorage
from nimprep.store.resplit import resplit
from nimprep.store.table_specs import table_specs
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset, StoreLoader
from tests.cloud.server import Proxy
from tests.fakes import contents


def run(*arguments: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(main, [str(a) for a in arguments])
    return done.exit_code, done.stdout, done.stderr


def test_opening_takes_one_request_and_one_per_table(made: str, proxy: Proxy) -> None:
    nimprep.open_store(made)
    assert len(proxy.requests) == len(proxy.seen("GET")) == 1 + len(table_specs())
    assert len(set(map(repr, proxy.requests))) == len(proxy.requests)


def test_a_frame_takes_a_request_per_image_and_a_shard_one_more_once(
    made: str, proxy: Proxy
) -> None:
    store = nimprep.open_store(made)
    proxy.forget()
    assert store[0].rgb is not None
    # rgb, depth and label come with a frame: an index and a chunk each.
    assert [r.span is not None for r in proxy.requests] == [True] * 6
    assert sum((r.span or "").startswith("bytes=-") for r in proxy.requests) == 3
    proxy.forget()
    frame = store[1]  # of the same shard
    assert frame.depth_m is not None
    assert len(proxy.requests) == 3
    proxy.forget()
    assert frame.normal is not None
    assert len(proxy.requests) == 2
    proxy.forget()
    for number in range(len(store)):
        _ = store[number].normal
    # Four shards: the first one's indices are known, the others are read once.
    assert len(proxy.requests) == 4 * len(store) + 4 * 3


def test_only_the_modalities_asked_for_cost_requests(made: str, proxy: Proxy) -> None:
    store = nimprep.open_store(made, ["depth"])
    proxy.forget()
    _ = store[0].depth_m
    assert ["/depth/" in r.path for r in proxy.requests] == [True, True]


def test_of_many_threads_one_reads_the_index(made: str, proxy: Proxy) -> None:
    array = nimprep.open_store(made).arrays["rgb"]
    proxy.forget()
    start = threading.Barrier(8)

    def read(number: int) -> object:
        start.wait()
        return array.read(number % 2)

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(read, range(8)))
    assert sum((r.span or "").startswith("bytes=-") for r in proxy.requests) == 1
    assert len(proxy.requests) == 9


def test_an_index_that_could_not_be_read_is_asked_for_again(made: str, proxy: Proxy) -> None:
    store = nimprep.open_store(made)
    proxy.fault = lambda request: "403"
    with pytest.raises(StoreError, match="denied"):
        store[0]
    proxy.fault = lambda request: None
    assert store[0].rgb is not None


def test_frames_are_those_of_the_folder(made: str, local: Path) -> None:
    here, there = nimprep.open_store(local), nimprep.open_store(made)
    assert there.ids == here.ids
    assert there.path == made
    assert repr(there).startswith(f"<nimprep store {made}: 7 frames")
    for ours, theirs in zip(here, there, strict=True):
        for name in ("rgb", "depth_m", "normal", "hha", "label"):
            np.testing.assert_array_equal(getattr(theirs, name), getattr(ours, name))
        assert theirs.camera == ours.camera
    assert {**store_info(made), "path": ""} == {**store_info(local), "path": ""}
    assert store_info(there) == store_info(made)


def test_it_is_valid_to_the_last_pixel(made: str, local: Path) -> None:
    report = validate_store(made, deep=True)
    assert report.problems == []
    assert report.checks == validate_store(local, deep=True).checks


def test_zarr_python_opens_the_same(made: str, local: Path) -> None:
    group = zarr.open_group(ObjectStorage(made).zarr(), mode="r")
    np.testing.assert_array_equal(group["depth"][3], zarr.open_group(local, mode="r")["depth"][3])


def test_a_web_server_is_enough_for_reading(web: str, local: Path) -> None:
    address = f"{web}/{local.name}"
    np.testing.assert_array_equal(
        nimprep.open_store(address)[6].rgb, nimprep.open_store(local)[6].rgb
    )
    assert validate_store(address).problems == []
    assert store_info(address)["modalities"] == store_info(local)["modalities"]
    with pytest.raises(StoreError, match="expected a place to write, found a web server"):
        resplit(address, seed=3)
    with pytest.raises(StoreError, match="listed, found a web server"):
        ObjectStorage(address).keys()
    with pytest.raises(StoreError, match="intrinsics: expected its chunk, found none"):
        nimprep.open_store(f"{web}/part.zarr")


def test_a_new_split_gives_the_bytes_it_gives_in_a_folder(
    made: str, local: Path, tmp_path: Path, proxy: Proxy
) -> None:
    here = tmp_path / "s.zarr"
    shutil.copytree(local, here)
    assert resplit(made, seed=5) == resplit(here, seed=5)
    # The root says which rule is to be and which is; the codes; then the root which rule is.
    put = [r.path.split("out.zarr/")[1] for r in proxy.seen("PUT", "/out.zarr/")]
    assert put == ["zarr.json", "split/c/0", "zarr.json"]
    storage = ObjectStorage(made)
    assert storage.read_many(storage.keys()) == contents(here)


def spoil(url: str, key: str, change) -> None:  # type: ignore[no-untyped-def]
    storage = ObjectStorage(url)
    data = storage.read(key)
    assert data is not None
    storage.write(key, [change(data)])


def flipped(at: int):  # type: ignore[no-untyped-def]
    return lambda data: data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("key", "change", "words"),
    [
        ("rgb/c/0/0/0/0", flipped(100), "rgb/c/0/0/0/0: expected chunk 0 undamaged"),
        ("rgb/c/0/0/0/0", flipped(-3), "rgb/c/0/0/0/0: expected an undamaged shard index"),
        ("rgb/c/0/0/0/0", lambda data: data[:20], "expected a shard of 36 bytes or more, found 20"),
        ("depth/c/0/0/0", lambda data: data[50:], "depth/c/0/0/0: expected chunks within"),
        ("label/c/0/0/0", None, "label/c/0/0/0: expected an object, found none"),
        ("intrinsics/c/0/0/0", flipped(20), "intrinsics: expected a table in one chunk"),
        ("split/c/0", None, "split: expected its chunk, found none"),
        ("zarr.json", lambda data: data[:-9], "zarr.json: expected JSON"),
        ("zarr.json", None, "expected a nimprep store, found nothing"),
    ],
)
def test_damage_is_an_error_that_names_the_object(
    made: str, key: str, change: object, words: str
) -> None:
    if change is None:
        ObjectStorage(made).remove(key)
    else:
        spoil(made, key, change)
    with pytest.raises(StoreError, match=words):
        nimprep.open_store(made)[0]
    code, out, err = run("validate", made, "--deep")
    assert code == 1
    assert err.count("\n") == 1
    assert words in out + err


def test_validate_sees_copies_of_metadata_that_differ_and_arrays_too_many(made: str) -> None:
    spoil(made, "rgb/zarr.json", lambda data: data.replace(b'"colour"', b'"color"'))
    storage = ObjectStorage(made)
    document = storage.read("depth/zarr.json")
    assert document is not None
    storage.write("elevation/zarr.json", [document])
    storage.write("more/zarr.json", [document])
    report = validate_store(made)
    problems = " ".join(report.problems)
    assert "expected the metadata of 'rgb' as in its own file" in problems
    assert "'elevation'" in problems
    assert report.extras == ["'elevation'", "'more'"]
    assert "long_name = 'colour'" in problems


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_a_data_loaders_workers_read_it(made: str, local: Path, method: str) -> None:
    here = StoreDataset(local, split=None, setup="nim-rgb+d")
    there = StoreDataset(made, split=None, setup="nim-rgb+d")
    loader = DataLoader(there, batch_size=2, num_workers=2, multiprocessing_context=method)
    for ours, theirs in zip(DataLoader(here, batch_size=2), loader, strict=True):
        assert torch.equal(ours["inputs"], theirs["inputs"])
        assert torch.equal(ours["label"], theirs["label"])
        assert ours["id"] == theirs["id"]
    assert there[0]["id"] == here[0]["id"]  # the parent's connections live on


def test_a_store_loader_reads_it_with_each_index_read_once(
    made: str, local: Path, proxy: Proxy
) -> None:
    data = StoreDataset(made, split=None, setup="rgb+d")
    proxy.forget()
    loader = StoreLoader(data, batch_size=2, num_threads=4)
    here = StoreLoader(StoreDataset(local, split=None, setup="rgb+d"), batch_size=2)
    for ours, theirs in zip(here, loader, strict=True):
        assert torch.equal(ours["inputs"], theirs["inputs"])
    # Three images of seven frames, and three indices of four shards.
    assert len(proxy.requests) == 3 * 7 + 3 * 4
    list(loader)
    assert len(proxy.requests) == 2 * 3 * 7 + 3 * 4


def test_a_loop_goes_on_where_requests_fail_now_and_then(
    made: str, local: Path, proxy: Proxy
) -> None:
    kinds = ("503", "reset", "cut", "lost")
    count = iter(range(10**6))
    proxy.fault = lambda r: kinds[n // 5 % 4] if (n := next(count)) % 5 == 3 else None
    data = StoreDataset(made, split=None, setup="rgb+d")
    here = StoreLoader(StoreDataset(local, split=None, setup="rgb+d"), batch_size=2)
    for ours, theirs in zip(here, StoreLoader(data, batch_size=2), strict=True):
        assert torch.equal(ours["inputs"], theirs["inputs"])
    assert len(proxy.spoilt) > 8


def test_every_reading_command_takes_the_url(
    made: str, local: Path, tmp_path: Path, proxy: Proxy
) -> None:
    code, out, _ = run("info", made, "--json")
    assert (code, json.loads(out)["path"]) == (0, made)
    code, out, _ = run("validate", made)
    assert (code, out.startswith(f"{made}: valid, 7 frames")) == (0, True)
    assert run("split", made, "--export", tmp_path / "split.json")[0] == 0
    assert run("split", made)[1] == run("split", local)[1]
    assert run("split", made, "--import", tmp_path / "split.json")[0] == 0
    store = nimprep.open_store(local)
    for number in store.indices("test"):
        path = tmp_path / "predictions" / f"{store.ids[number]}.png"
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), store[number].label)
    code, out, err = run("evaluate", made, tmp_path / "predictions")
    assert (code, "100.00" in out) == (0, True), err
    code, out, err = run("export", made, tmp_path / "out", "--format", "npz", "--frames", "0:2")
    assert (code, len(list((tmp_path / "out").glob("*.npz")))) == (0, 2), err


def test_a_page_is_made_of_it(made: str, tmp_path: Path) -> None:
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    code, _, err = run("report", made, tmp_path / "page.html")
    assert code == 0, err
    assert made in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize("command", ["info", "validate", "split"])
def test_what_cannot_be_read_is_one_line_and_exit_1(
    url: str, proxy: Proxy, nobody: str, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    assert run(command, url) == (1, "", f"error: {url}: expected a nimprep store, found nothing\n")
    code, _, err = run(command, "s3://nobody-has-this/out.zarr")
    assert (code, err.count("\n")) == (1, 1)
    assert "expected a bucket, found none of that name; make it first" in err
    monkeypatch.setenv("AWS_ENDPOINT_URL", nobody)
    code, _, err = run(command, url)
    assert (code, err.count("\n")) == (1, 1)
    assert f"expected an answer of {nobody}" in err
