"""What lies in a store and is not nimprep's: kept by appending, named by what replaces it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
import zarr

import nimprep
from nimprep.errors import StoreError
from nimprep.store import writer
from nimprep.store.extras import discard, is_own
from nimprep.store.storage import LocalStorage
from nimprep.store.validate import validate_store
from tests.conversion.mortal import Mortals
from tests.conversion.test_append import write_frames
from tests.fakes import contents

pytestmark = [
    pytest.mark.filterwarnings("ignore:.*nominal:UserWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
]

SMALL: dict[str, Any] = {"shard_length": 2, "modalities": ("rgb", "depth")}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a dataset raw, more frames in more, and raw's store s.zarr."""
    root = tmp_path_factory.mktemp("extras")
    write_frames(root / "raw", range(3))
    write_frames(root / "more", range(3, 6))
    with pytest.warns(UserWarning, match="nominal"):
        nimprep.convert(root / "raw", root / "s.zarr", **SMALL)
    return root


@pytest.fixture
def world(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "world"))


NOTES = {
    "notes.txt": b"mine",
    ".hidden": b"mine",
    "runs/a/checkpoint.pt": b"weights",
    "rgb/notes.txt": b"mine",
    "rgb/c/0/notes.txt": b"mine",
    "rgb/c/old/0": b"mine",
    "depth/zarr.json.bak": b"mine",
    "hha/c/0/0/0/0": b"of an array that this store does not have",
}


def add_notes(store: Path) -> None:
    """Put files, folders and links in every place of a store."""
    for name, data in NOTES.items():
        (store / name).parent.mkdir(parents=True, exist_ok=True)
        (store / name).write_bytes(data)
    (store / "empty").mkdir(mode=0o750)
    (store / "runs" / "a" / "checkpoint.pt").chmod(0o600)
    (store / "link").symlink_to("runs/a")
    (store / "nowhere").symlink_to("/nowhere")


def has_notes(store: Path) -> bool:
    return (
        all((store / name).read_bytes() == data for name, data in NOTES.items())
        and stat.S_IMODE((store / "empty").stat().st_mode) == 0o750
        and stat.S_IMODE((store / "runs" / "a" / "checkpoint.pt").stat().st_mode) == 0o600
        and str((store / "link").readlink()) == "runs/a"
        and str((store / "nowhere").readlink()) == "/nowhere"
    )


def edit(path: Path, change: Any) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def add_attributes(store: Path) -> None:
    """Put attributes into the documents of the root and of two arrays, and into their copies."""

    def root(document: dict[str, Any]) -> None:
        document["attributes"]["license"] = "CC-BY-4.0"
        for name in ("rgb", "split"):
            copies = document["consolidated_metadata"]["metadata"]
            copies[name]["attributes"]["comment"] = f"of {name}"

    edit(store / "zarr.json", root)
    for name in ("rgb", "split"):
        note = {"comment": f"of {name}"}
        edit(store / name / "zarr.json", lambda d, n=note: d["attributes"].update(n))


def add_array(store: Path, dims: tuple[str, ...] = ("class",)) -> None:
    """Put an array there as xarray does, with its copy in the root's document."""
    group = zarr.open_group(store, mode="r+", zarr_format=3)
    array = group.create_array("weights", shape=(3,), dtype="float64", dimension_names=dims)
    array[:] = np.arange(3)
    zarr.consolidate_metadata(store)


@pytest.mark.parametrize("second_names", [True, False])
def test_append_keeps_files_that_are_not_its_own(
    world: Path, monkeypatch: pytest.MonkeyPatch, second_names: bool
) -> None:
    store = world / "s.zarr"
    add_notes(store)
    node = (store / "runs" / "a" / "checkpoint.pt").stat().st_ino
    if not second_names:
        monkeypatch.setattr(os, "link", _cannot)
    nimprep.append_frames(world / "more", store)
    assert len(nimprep.open_store(store)) == 6
    assert has_notes(store)
    # Somebody may have it open.
    assert (node == (store / "runs" / "a" / "checkpoint.pt").stat().st_ino) == second_names
    assert not list(world.glob(".*"))


def _cannot(*_: object, **__: object) -> None:
    raise PermissionError(1, "Operation not permitted")


def test_append_keeps_attributes_that_are_not_its_own(world: Path) -> None:
    store = world / "s.zarr"
    add_attributes(store)
    nimprep.append_frames(world / "more", store)
    assert validate_store(store, deep=True).problems == []
    for consolidated in (True, False):
        group = zarr.open_group(store, mode="r", use_consolidated=consolidated)
        assert group.attrs["license"] == "CC-BY-4.0"
        assert group["rgb"].attrs["comment"] == "of rgb"
        assert group["split"].attrs["comment"] == "of split"
    assert nimprep.append_frames(world / "more", store, skip_existing=True).ids == ()


def test_append_keeps_arrays_that_are_not_its_own(world: Path) -> None:
    store = world / "s.zarr"
    add_array(store)
    nimprep.append_frames(world / "more", store)
    with xarray.open_zarr(store, consolidated=True, chunks=None) as found:
        assert found["weights"].values.tolist() == [0, 1, 2]
        assert found.sizes["frame"] == 6
        assert found.sizes["class"] == 3


def test_append_refuses_where_an_array_that_is_not_its_own_would_lack_the_new_frames(
    world: Path,
) -> None:
    store = world / "s.zarr"
    add_array(store, ("frame",))
    before = contents(store)
    with pytest.raises(StoreError, match="arrays along 'frame' but nimprep's, found 'weights'"):
        nimprep.append_frames(world / "more", store)
    assert contents(store) == before


def test_the_bytes_of_an_append_are_the_same_beside_notes(world: Path, tmp_path: Path) -> None:
    shutil.copytree(world / "s.zarr", tmp_path / "plain.zarr")
    add_notes(world / "s.zarr")
    nimprep.append_frames(world / "more", world / "s.zarr")
    nimprep.append_frames(world / "more", tmp_path / "plain.zarr")
    found = contents(world / "s.zarr")
    assert {k: v for k, v in found.items() if k not in NOTES and not k.startswith("link")} == (
        contents(tmp_path / "plain.zarr")
    )


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
def test_an_append_that_is_killed_loses_no_notes(
    world: Path, mortals: Mortals, atomic: bool
) -> None:
    store = world / "s.zarr"
    shutil.copytree(store, world / "old.zarr")
    killed = 0
    for step in range(20):
        shutil.rmtree(store)
        shutil.copytree(world / "old.zarr", store)
        add_notes(store)
        status = mortals.run("append", world / "more", store, step=step, atomic=atomic)
        if status == 0:
            break
        assert status == -signal.SIGKILL
        killed += 1
        if store.exists():
            assert has_notes(store)
        nimprep.append_frames(world / "more", store, skip_existing=True)
        assert len(nimprep.open_store(store)) == 6
        assert has_notes(store)
    assert killed > 2


def test_what_comes_into_a_store_while_it_is_replaced_goes_on_in_the_new_one(
    world: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = world / "s.zarr"
    (store / "log").write_text("one")
    swap_folders = writer.swap_folders

    def late(partial: Path, target: Path) -> bool:
        (target / "log").unlink(missing_ok=True)
        (target / "log").write_text("one, two")
        (target / "new" / "folder").mkdir(parents=True)
        (target / "new" / "folder" / "file").write_text("mine")
        return swap_folders(partial, target)

    monkeypatch.setattr(writer, "swap_folders", late)
    for change in (grow, replace_by_conversion):
        change(world, store)
        assert (store / "log").read_text() == "one, two"
        assert (store / "new" / "folder" / "file").read_text() == "mine"
        (store / "log").unlink()
        shutil.rmtree(store / "new")


def replace_by_conversion(world: Path, store: Path) -> None:
    nimprep.convert(world / "more", store, overwrite=True, **SMALL)


def replace_by_merging(world: Path, store: Path) -> None:
    for name in ("raw", "more"):
        if not (world / f"{name}.zarr").exists():
            nimprep.convert(world / name, world / f"{name}.zarr", **SMALL)
    nimprep.merge_stores([world / "raw.zarr", world / "more.zarr"], store, overwrite=True)


REPLACING = [replace_by_conversion, replace_by_merging]


@pytest.mark.parametrize("replace", REPLACING)
def test_a_store_with_something_else_in_it_is_not_replaced(world: Path, replace: Any) -> None:
    store = world / "s.zarr"
    cases = {
        "'notes.txt'": lambda s: _put(s / "notes.txt"),
        "'.hidden'": lambda s: _put(s / ".hidden"),
        "'runs'": lambda s: _put(s / "runs" / "a" / "checkpoint.pt"),
        "'rgb/notes.txt'": lambda s: _put(s / "rgb" / "notes.txt"),
        "'rgb/c/0/notes.txt'": lambda s: _put(s / "rgb" / "c" / "0" / "notes.txt"),
        "'hha'": lambda s: _put(s / "hha" / "c" / "0"),
        "'rgb/c/old'": lambda s: _put(s / "rgb" / "c" / "old" / "0"),
        "'empty'": lambda s: (s / "empty").mkdir(),
        "'link'": lambda s: (s / "link").symlink_to("/nowhere"),
        "attribute 'license'": add_attributes,
        "attribute 'comment' of 'rgb'": add_attributes,
        "attribute 'comment' of 'split'": add_attributes,
        "'weights'": add_array,
        "'extra' in zarr.json": lambda s: edit(s / "zarr.json", lambda d: d.update(extra=1)),
    }
    shutil.copytree(store, world / "old.zarr")
    for named, add in cases.items():
        shutil.rmtree(store)
        shutil.copytree(world / "old.zarr", store)
        add(store)
        before = contents(store)
        with pytest.raises(StoreError, match="nothing in it but what nimprep wrote") as caught:
            replace(world, store)
        assert named in str(caught.value)
        assert contents(store) == before
    shutil.rmtree(store)
    shutil.copytree(world / "old.zarr", store)
    replace(world, store)


def _put(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"mine")


def test_a_message_names_some_and_counts_the_others(world: Path) -> None:
    add_notes(world / "s.zarr")
    with pytest.raises(StoreError, match=r"found '.hidden', '[^,]*', '[^,]*' and 8 more, which"):
        replace_by_conversion(world, world / "s.zarr")


def test_a_store_cut_short_is_not_replaced_either_with_something_else_in_it(world: Path) -> None:
    store = world / "s.zarr"
    edit(store / "zarr.json", lambda d: d["attributes"]["nimprep"].update(complete=False))
    _put(store / "notes.txt")
    with pytest.raises(StoreError, match=r"found 'notes\.txt', which would be lost"):
        nimprep.convert(world / "more", store, **SMALL)
    (store / "notes.txt").unlink()
    nimprep.convert(world / "more", store, **SMALL)


def test_what_comes_during_a_conversion_stops_it_and_the_same_command_goes_on(world: Path) -> None:
    store = world / "s.zarr"

    def progress(step: str, frames: int) -> Any:
        if not (store / "notes.txt").exists():
            _put(store / "notes.txt")
        return lambda: None

    with pytest.raises(StoreError, match=r"found 'notes\.txt'"):
        nimprep.convert(world / "more", store, overwrite=True, progress=progress, **SMALL)
    assert len(nimprep.open_store(store)) == 3
    (store / "notes.txt").unlink()
    nimprep.convert(world / "more", store, overwrite=True, **SMALL)
    assert nimprep.open_store(store).ids[0] == "000003"


def grow(world: Path, store: Path) -> None:
    nimprep.append_frames(world / "more", store)


@pytest.mark.parametrize("atomic", [True, False], ids=["at once", "one by one"])
@pytest.mark.parametrize("change", [*REPLACING, grow])
def test_mode_and_owner_of_a_store_stay(
    world: Path, monkeypatch: pytest.MonkeyPatch, change: Any, atomic: bool
) -> None:
    store = world / "s.zarr"
    if not atomic:
        monkeypatch.setattr(writer, "swap_folders", lambda a, b: False)
    (store / "rgb" / "c").chmod(0o770)
    (store / "rgb" / "zarr.json").chmod(0o640)
    root = os.geteuid() == 0
    for path in (store, *store.rglob("*")) if root else ():
        os.chown(path, 65534, 65533)
    for mode in (0o700, 0o2775, 0o1777):
        store.chmod(mode)
        before = store.stat()
        change(world, store)
        after = store.stat()
        assert stat.S_IMODE(after.st_mode) == mode
        assert (after.st_uid, after.st_gid) == (before.st_uid, before.st_gid)
        assert stat.S_IMODE((store / "rgb" / "c").stat().st_mode) == 0o770
        assert stat.S_IMODE((store / "rgb" / "zarr.json").stat().st_mode) == 0o640
        for path in store.rglob("*") if root else ():
            assert (path.stat().st_uid, path.stat().st_gid) == (65534, 65533), path
        shutil.rmtree(world / "more")
        write_frames(world / "more", range(6, 8))
        if change is grow and mode == 0o2775:
            break


def test_an_empty_folder_hands_on_its_mode(world: Path) -> None:
    (world / "new").mkdir(mode=0o750)
    (world / "new").chmod(0o750)
    nimprep.convert(world / "raw", world / "new", **SMALL)
    assert stat.S_IMODE((world / "new").stat().st_mode) == 0o750


def test_every_key_that_is_written_is_its_own(world: Path) -> None:
    store = world / "s.zarr"
    keys = LocalStorage(store).keys()
    arrays = {path.name for path in store.iterdir() if path.is_dir()}
    assert len(keys) > 20
    assert all(is_own(key, arrays) for key in keys)
    assert all(is_own(f"packed/{key}", arrays) for key in ("rgb/c/0/0/0/0", "done"))
    for key in ("notes", "rgb", "rgb/x", "rgb/c/x", "rgb/c", "packed/x", "x/zarr.json", "rgb/c/-1"):
        assert not is_own(key, arrays), key


def test_discarding_never_fails(tmp_path: Path) -> None:
    for number, text in enumerate((None, "", "{}", '{"attributes": {"nimprep": 3}}')):
        old = tmp_path / str(number)
        old.mkdir()
        if text is not None:
            (old / "zarr.json").write_text(text)
        discard(old, tmp_path / "target")
        assert not old.exists()
    discard(tmp_path / "none", tmp_path / "target")
