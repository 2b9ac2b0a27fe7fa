"""A store from somebody else makes no command run its code, or touch anything outside it."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.store.metadata import write_attributes
from nimprep.store.reader import open_store
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.hostile.fuzzing import limited_time
from tests.hostile.stores import document, read, sealed, show, table_file
from tests.hostile.test_arrays import FOOTPRINT, Intruder
from tests.processes import PATIENCE_S

PROJECT = Path(__file__).resolve().parents[2]
Damage = Callable[[Path], None]


def link(key: str, *, relative: bool = False) -> Damage:
    """Move a file or folder of the store out of it and leave a link to it."""

    def apply(store: Path) -> None:
        outside = store.parent / "outside" / key
        outside.parent.mkdir(parents=True)
        (store / key).rename(outside)
        target = os.path.relpath(outside, (store / key).parent) if relative else outside
        (store / key).symlink_to(target)

    return apply


def write(name: str, change: Callable[[Any], None]) -> Damage:
    """Change the document of the root, or of an array."""

    def apply(store: Path) -> None:
        found = document(store, name)
        change(found)
        (store / name / "zarr.json").write_text(json.dumps(found))

    return apply


def codec(name: str, place: int, codec_name: str) -> Damage:
    """Name another codec in an array."""

    def change(found: Any) -> None:
        codecs = found["codecs"]
        if codecs[0]["name"] == "sharding_indexed":
            codecs = codecs[0]["configuration"]["codecs"]
        codecs[place] = {"name": codec_name, "configuration": {}}

    return write(name, change)


def pickled(name: str) -> Damage:
    """Put a pickle in place of a table's chunk, with the codecs that would unpack it."""

    def apply(store: Path) -> None:
        (store / table_file(name)).write_bytes(sealed(pickle.dumps(Intruder())))
        codecs = [{"name": "numcodecs.pickle", "configuration": {}}, {"name": "crc32c"}]
        write(name, lambda d: d.update(codecs=codecs, data_type="object"))(store)

    return apply


def replace(key: str, make: Callable[[Path], object]) -> Damage:
    def apply(store: Path) -> None:
        (store / key).unlink()
        make(store / key)

    return apply


def copies(name: str) -> Damage:
    """Name an array elsewhere in the root's copy of the metadata, where there is one."""

    def apply(store: Path) -> None:
        shutil.copytree(store / "rgb", store.parent / "outside" / "rgb")
        change = lambda d: d["consolidated_metadata"]["metadata"].update({name: {"shape": [3]}})  # noqa: E731
        write("", change)(store)

    return apply


def everywhere(value: str) -> Damage:
    """Put a text wherever the attributes take one."""

    def apply(store: Path) -> None:
        found = document(store)["attributes"]["nimprep"]
        found["dataset"] = found["codec"] = value
        found["classes"][0]["name"] = value
        for made in found["modalities"].values():
            made["method"], made["parameters"] = value, {"path": value, "url": value}
        found["source"] |= {"path": value, "url": value}
        found["frame_metadata"] = {"depth_source": {"values": [value], "of_frame": [0, 0, 0]}}
        write_attributes(store, found)

    return apply


LINKS = {
    **{f"{key} is a link": link(key) for key in ("zarr.json", "rgb/zarr.json", "split/zarr.json")},
    **{f"{key} is a link": link(key) for key in ("split/c/0", "frame_id/c/0", "label/c/0/0/0")},
    **{f"{key} is a folder elsewhere": link(key) for key in ("rgb", "rgb/c", "split", "split/c")},
    "a link by .. out of the store": link("label/c/0/0/0", relative=True),
    "an extra folder is a link": lambda s: (s / "extra").symlink_to(s.parent),
    "an extra folder is the disk": lambda s: (s / "extra").symlink_to("/"),
}
NAMES = {
    f"an array named {n!r}": copies(n) for n in ("../outside/rgb", "..", "/etc", "a/../..", "")
}
CODECS = {
    f"{array} with the codec {name}": codec(array, place, name)
    for array, place in (("split", 1), ("frame_id", 0), ("rgb", 1))
    for name in ("pickle", "numcodecs.pickle", "json2", "lzma", "os:system", "../x", "gzip", "zstd")
}
NO_FILES = {
    f"{key} is {kind}": replace(key, make)
    for key in ("zarr.json", "rgb/zarr.json", "split/c/0", "rgb/c/0/0/0/0")
    for kind, make in (
        ("a pipe", os.mkfifo),
        ("endless", lambda p: p.symlink_to("/dev/zero")),
        ("a link to itself", lambda p: p.symlink_to(p.name)),
        ("a folder", Path.mkdir),
    )
}
TEXTS = {
    f"{value!r} in all attributes": everywhere(value)
    for value in (
        "file:///etc/passwd",
        "http://localhost:9/",
        "/etc/passwd",
        "$(touch x)",
        "\x1b[2J",
    )
}
STORES: dict[str, Damage] = {
    **LINKS,
    **NAMES,
    **CODECS,
    **NO_FILES,
    **TEXTS,
    "a pickle for a table": pickled("split"),
    "a pickle for names": pickled("frame_id"),
    "a transformer": write("rgb", lambda d: d.update(storage_transformers=[{"name": "x"}])),
    "an object for a type": write("rgb", lambda d: d.update(data_type="object")),
}


@pytest.fixture(scope="module")
def seen(made_store: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Return what `info`, `validate --deep` and `split` did with each store, by case."""
    folder = tmp_path_factory.mktemp("watched")
    stores = {}
    for number, (case, damage) in enumerate(STORES.items()):
        stores[case] = Path(shutil.copytree(made_store, folder / str(number) / "s.zarr"))
        damage(stores[case])
    result = subprocess.run(
        [sys.executable, "-m", "tests.hostile.watched", made_store, *stores.values()],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert result.returncode == 0, result.stderr[-3000:]
    found = json.loads(result.stdout)
    assert not list(folder.rglob(FOOTPRINT))
    assert not (PROJECT / FOOTPRINT).exists()
    by_store: dict[str, list[Any]] = {}
    for store, *rest in found:
        by_store.setdefault(store, []).append(rest)
    [(_, _, misbehaviour)] = by_store["misbehaving"]
    for event in ("open ", "os.listdir ", "pickle.find_class ", "compile ", "exec "):
        assert any(line.startswith(event) for line in misbehaviour), misbehaviour
    return {case: by_store[str(store)] for case, store in stores.items()}


@pytest.mark.parametrize("case", STORES)
def test_no_command_leaves_the_store(seen: dict[str, list[Any]], case: str) -> None:
    assert len(seen[case]) == 4
    for command, code, what in seen[case]:
        assert what == [], command
        assert code == (0 if case in TEXTS and "validate" not in command else code), command
        assert code in (0, 1)


@pytest.mark.parametrize("case", [*LINKS, *NAMES, *CODECS, *NO_FILES])
def test_validate_finds_what_is_foreign(seen: dict[str, list[Any]], case: str) -> None:
    codes = {command: code for command, code, _ in seen[case]}
    assert codes["validate --deep --quiet"] == 1


@pytest.mark.parametrize("case", NAMES)
def test_an_array_that_the_root_names_elsewhere_is_not_looked_for(
    made_store: Path, tmp_path: Path, case: str
) -> None:
    store = copied(made_store, tmp_path)
    NAMES[case](store)
    assert any("a name that can be none's" in p for p in validate_store(store).problems)


def copied(store: Path, folder: Path) -> Path:
    return Path(shutil.copytree(store, folder / "s.zarr"))


@pytest.mark.parametrize("case", LINKS)
def test_a_frame_behind_a_link_is_not_read(made_store: Path, tmp_path: Path, case: str) -> None:
    store = copied(made_store, tmp_path)
    LINKS[case](store)
    if "extra" in case:
        assert any("leads to" in p or "extra" in p for p in validate_store(store).problems)
        return
    with pytest.raises(StoreError, match="expected a file within the store, found one that leads"):
        read(store)


def test_a_store_may_be_a_link_itself_and_hold_links_to_its_own_files(
    made_store: Path, tmp_path: Path
) -> None:
    store = copied(made_store, tmp_path)
    (store / "hha" / "own").mkdir()
    shard = store / "rgb/c/0/0/0/0"
    shard.rename(store / "hha" / "own" / "shard")
    shard.symlink_to("../../../../../hha/own/shard")
    (tmp_path / "linked.zarr").symlink_to(store)
    read(tmp_path / "linked.zarr")
    show(tmp_path / "linked.zarr")


@pytest.mark.parametrize("key", ["split/c/0", "split/c", "split", "zarr.json"])
def test_splitting_anew_writes_through_no_link(made_store: Path, tmp_path: Path, key: str) -> None:
    store = copied(made_store, tmp_path)
    link(key)(store)
    outside = {p: p.read_bytes() for p in (tmp_path / "outside").rglob("*") if p.is_file()}
    with pytest.raises(StoreError, match="leads to"):
        resplit(store, seed=3)
    assert {p: p.read_bytes() for p in (tmp_path / "outside").rglob("*") if p.is_file()} == outside


@pytest.mark.parametrize("key", ["zarr.json", "split/c/0"])
def test_a_file_of_a_terabyte_is_refused_unread(made_store: Path, tmp_path: Path, key: str) -> None:
    store = copied(made_store, tmp_path)
    os.truncate(store / key, 1 << 40)
    with limited_time(), pytest.raises(StoreError, match="at most"):
        open_store(store)


def test_no_text_of_a_store_steers_a_terminal(made_store: Path, tmp_path: Path) -> None:
    store = copied(made_store, tmp_path)
    everywhere("\x1b]0;you\x07\u202e\ud800")(store)
    for command in (["info"], ["validate"], ["validate", "--deep"]):
        result = CliRunner().invoke(main, [*command, str(store)])
        assert result.exit_code == (0 if command == ["info"] else 1)
        assert "\\x1b]0;you\\x07\\u202e\\ud800" in result.output
        assert all(c.isprintable() or c == "\n" for c in result.output)


def test_a_full_disk_behind_info_is_one_line(made_store: Path) -> None:
    with open("/dev/full", "w") as full:  # noqa: PTH123
        result = subprocess.run(
            [sys.executable, "-m", "nimprep", "info", made_store],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert result.returncode == 1
    assert result.stderr == (
        "error: standard output: expected room for the result, found No space left on device\n"
    )
