"""Stores that become one: what moves over as it is, what is made anew, and what may not join."""

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.errors import SplitError, StoreError
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from tests.checksums import edit_attributes
from tests.conversion.mortal import Mortals
from tests.conversion.test_append import damage, images_and_tables, same, write_frames
from tests.fakes import contents, write_gmrp, write_nyu_like

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")


def made(folder: Path, name: str, numbers: range, **options: object) -> Path:
    """Return a store of some of the frames that `write_gmrp` makes."""
    size = options.pop("size", (24, 32))
    source = write_frames(folder / f"{name}.source", numbers, size)  # type: ignore[arg-type]
    options = {"shard_length": 3, **options}
    nimprep.convert(source, folder / f"{name}.zarr", **options)  # type: ignore[arg-type]
    return folder / f"{name}.zarr"


@pytest.mark.parametrize("cut", [3, 4, 6])
def test_parts_become_the_store_that_all_at_once_make(tmp_path: Path, cut: int) -> None:
    whole = nimprep.open_store(made(tmp_path, "all", range(8)))
    parts = [made(tmp_path, "a", range(cut)), made(tmp_path, "b", range(cut, 8))]
    before = [contents(part) for part in parts]
    merged = nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert merged.ids == whole.ids
    assert images_and_tables(tmp_path / "m.zarr") == images_and_tables(tmp_path / "all.zarr")
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []
    assert merged.splits == {
        i: split for part in parts for i, split in nimprep.open_store(part).splits.items()
    }
    assert merged.attributes["depth_percentiles_m"] == whole.attributes["depth_percentiles_m"]
    digests = [nimprep.open_store(part).attributes["source"]["digest"] for part in parts]
    assert [p["digest"] for p in merged.attributes["source"]["parts"]] == digests
    assert [contents(part) for part in parts] == before
    assert not list(tmp_path.glob(".*"))


def test_merging_is_appending(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a", range(4)), made(tmp_path, "b", range(4, 6))
    for store in (a, b):
        resplit(store, seed=0)
    nimprep.merge_stores([a, b], tmp_path / "m.zarr")
    nimprep.append_frames(tmp_path / "b.source", a)
    ours, theirs = contents(tmp_path / "m.zarr"), contents(a)
    assert {n: d for n, d in ours.items() if n != "split/c/0"} == {
        n: d for n, d in theirs.items() if n != "split/c/0"
    }
    third = made(tmp_path, "c", range(6, 8))
    last = nimprep.merge_stores([tmp_path / "m.zarr", third], tmp_path / "n.zarr")
    assert [p["frames"] for p in last.attributes["source"]["parts"]] == [4, 2, 2]


def test_images_move_over_as_they_are_compressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import nimprep.conversion.shard_assembly as shard_assembly

    parts = [made(tmp_path, "a", range(4)), made(tmp_path, "b", range(4, 9), shard_length=4)]

    def never(*arguments: object) -> bytes:
        raise AssertionError("compressed anew")

    monkeypatch.setattr(shard_assembly, "encode_chunk", never)
    merged = nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert {array.shard_length for array in merged.arrays.values()} == {3}
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []


@pytest.mark.parametrize("order", [1, -1])
def test_smaller_images_are_padded_and_other_codecs_made_the_firsts(
    tmp_path: Path, order: int
) -> None:
    parts = [
        made(tmp_path, "a", range(2)),
        made(tmp_path, "b", range(2, 6), size=(30, 20), codec="small", shard_length=2),
    ][::order]
    merged = nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert merged.arrays["rgb"].shape[1:3] == (30, 32)
    assert merged.attributes["codec"] == ("fast" if order == 1 else "small")
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []
    frames = [frame for part in parts for frame in nimprep.open_store(part)]
    for ours, theirs in zip(merged, frames, strict=True):
        assert same(ours, theirs)
        assert ours.camera == theirs.camera
    codecs = json.loads((tmp_path / "m.zarr" / "rgb" / "zarr.json").read_text())["codecs"]
    blosc = codecs[0]["configuration"]["codecs"][1]["configuration"]["cname"]
    # The chunks themselves, not only what is said of them.
    first, second = (merged.arrays["rgb"].fetch(i) for i in (0, 5))
    assert first is not None
    assert second is not None
    assert blosc == ("lz4hc" if order == 1 else "zstd")
    assert first[2] >> 5 == second[2] >> 5 == (1 if order == 1 else 4)


def test_another_codec_of_the_same_size_becomes_the_firsts(tmp_path: Path) -> None:
    whole = made(tmp_path, "all", range(3))
    parts = [made(tmp_path, "a", range(2)), made(tmp_path, "b", range(2, 3), codec="small")]
    nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert images_and_tables(tmp_path / "m.zarr") == images_and_tables(whole)


def test_padding_is_ignored_and_empty(tmp_path: Path) -> None:
    parts = [made(tmp_path, "a", range(1), size=(20, 20)), made(tmp_path, "b", range(1, 2))]
    merged = nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert (merged.arrays["label"].read(0)[20:] == 255).all()
    assert (merged.arrays["label"].read(0)[:, 20:] == 255).all()
    assert not merged.arrays["depth"].read(0)[20:].any()


def test_one_id_in_two_stores_is_refused_by_name(tmp_path: Path) -> None:
    parts = [made(tmp_path, "a", range(4)), made(tmp_path, "b", range(3, 6))]
    with pytest.raises(StoreError, match=r"found '000003' twice \(1 ids are\); --prefix"):
        nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert not list(tmp_path.glob("*m.zarr*"))
    merged = nimprep.merge_stores(parts, tmp_path / "m.zarr", prefixes=["", "later/"])
    assert merged.ids[3:5] == ("000003", "later/000003")
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []
    with pytest.raises(StoreError, match="expected one for each of 2 stores, found 1"):
        nimprep.merge_stores(parts, tmp_path / "n.zarr", prefixes=["a/"])


@pytest.mark.parametrize(
    "prefix", ["a\x1b[2J", "a\n", "/", "../", "a//", "./", "a\\..\\", "\u202e"]
)
def test_a_prefix_that_no_file_can_have_is_refused_before_any_work(
    prefix: str, tmp_path: Path
) -> None:
    parts = [made(tmp_path, "a", range(1)), made(tmp_path, "b", range(1, 2))]

    def progress(step: str, frames: int) -> Callable[[], None]:
        raise AssertionError(f"{step} of {frames} frames was begun")

    out = tmp_path / "m.zarr"
    with pytest.raises(StoreError, match=r"--prefix: expected one .*; give another") as raised:
        nimprep.merge_stores(parts, out, prefixes=["", prefix], progress=progress)
    assert str(raised.value).isprintable()
    assert not list(tmp_path.glob("*m.zarr*"))


def test_a_scene_may_not_straddle_splits(tmp_path: Path) -> None:
    for name, split in (("a", "train"), ("b", "val")):
        root, described = write_nyu_like(tmp_path / name)
        if name == "b":
            for path in [p for p in root.rglob("*") if p.stem in "01"]:
                path.rename(path.with_stem(f"{path.stem}9"))
        store = nimprep.convert(root, tmp_path / f"{name}.zarr", description=described)
        chosen = {"train": [], "val": [], "test": [], split: list(store.ids)}
        file = tmp_path / "split.json"
        file.write_text(json.dumps({"format": "nimprep-split", "version": "1.0", **chosen}))
        resplit(store.path, split_file=file)
        edit_attributes(Path(store.path), split={"rule": "group", "seed": 0})
    stores = [tmp_path / "a.zarr", tmp_path / "b.zarr"]
    with pytest.raises(SplitError, match=r"scene 'kitchen': expected it in one split, .*--prefix"):
        nimprep.merge_stores(stores, tmp_path / "m.zarr")
    assert not list(tmp_path.glob("*m.zarr*"))
    merged = nimprep.merge_stores(stores, tmp_path / "m.zarr", prefixes=["a/", "b/"])
    assert set(merged.tables.group) == {"a/kitchen", "a/office", "b/kitchen", "b/office"}
    assert validate_store(tmp_path / "m.zarr").problems == []


def test_what_the_metadata_says_of_frames_is_joined(tmp_path: Path) -> None:
    source = write_gmrp(tmp_path / "a", 3)
    damage(source / "rgb" / "000001.png")
    damage(source / "rgb" / "000002.png")
    nimprep.convert(source, tmp_path / "a.zarr", on_error="skip", seed=1)
    b = made(tmp_path, "b", range(2, 4), camera=(30.0, 30.0, 16.0, 12.0))
    edit_attributes(b, fixed_splits={"test": ["000003"]}, dataset="ours")
    merged = nimprep.merge_stores([tmp_path / "a.zarr", b], tmp_path / "m.zarr")
    attributes = merged.attributes
    # Frame 2, bad in the one, is good in the other.
    assert [frame["id"] for frame in attributes["skipped"]] == ["000001"]
    assert attributes["fixed_splits"] == {"test": ["000003"]}
    # No one rule made these splits.
    assert attributes["split"] == {"rule": "file"}
    assert attributes["dataset"] == "gmrp+ours"
    assert attributes["calibration"]["origin"] == "nominal"
    assert [p["calibration"] for p in attributes["source"]["parts"]] == ["nominal", "user"]
    assert [frame.camera.fx for frame in merged][1:] == [30.0, 30.0]
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"modalities": ("rgb", "depth")}, "expected modalities rgb, depth, normal, hha, label as"),
        ({"crop": (1, 0, 0, 0)}, "expected crop 0,0,0,0 as in .*, found 1,0,0,0"),
        ({"sign_filter": True}, "expected normal .*False.* found .*True"),
        ({"fill": "nearest"}, "expected hha .*none.* found .*nearest"),
        ({"normal_dtype": "int16"}, "expected normal .*int8.* found .*int16"),
        ({"labels": False}, "expected modalities"),
    ],
)
def test_stores_of_another_making_are_refused(
    tmp_path: Path, options: dict[str, object], words: str
) -> None:
    parts = [made(tmp_path, "a", range(1)), made(tmp_path, "b", range(1, 2), **options)]
    with pytest.raises(StoreError, match=words):
        nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert not list(tmp_path.glob("*m.zarr*"))


def test_other_classes_formats_and_places_are_refused(tmp_path: Path) -> None:
    a, b = made(tmp_path, "a", range(1)), made(tmp_path, "b", range(1, 2))
    target = tmp_path / "m.zarr"
    for inside in (a, a / "m.zarr", tmp_path):
        with pytest.raises(StoreError, match="apart from"):
            nimprep.merge_stores([a, b], inside, overwrite=True)
    with pytest.raises(StoreError, match="on this machine to merge, found a URL"):
        nimprep.merge_stores([a, "s3://bucket/b.zarr"], target)
    with pytest.raises(StoreError, match="on this machine to merge into, found a URL"):
        nimprep.merge_stores([a, b], "s3://bucket/m.zarr")
    with pytest.raises(StoreError, match=r"no\.zarr: expected a nimprep store, found nothing"):
        nimprep.merge_stores([a, tmp_path / "no.zarr"], target)
    shutil.copytree(a, target)
    with pytest.raises(StoreError, match="--overwrite"):
        nimprep.merge_stores([a, b], target)
    edit_attributes(b, format_version="1.7")
    with pytest.raises(StoreError, match=r"expected store format 1\.2 or older .*found '1\.7'"):
        nimprep.merge_stores([a, b], target, overwrite=True)
    classes = nimprep.open_store(a).attributes["classes"]
    classes = [*classes[:2], {**classes[2], "name": "stone"}]
    edit_attributes(b, format_version="1.2", classes=classes)
    with pytest.raises(StoreError, match=r"expected classes 0 background, .* 2 road anomaly as in"):
        nimprep.merge_stores([a, b], target, overwrite=True)
    assert contents(target) == contents(a)


def test_damage_is_not_copied(tmp_path: Path) -> None:
    parts = [made(tmp_path, "a", range(3)), made(tmp_path, "b", range(3, 6))]
    path = parts[1] / "rgb" / "c" / "0" / "0" / "0" / "0"
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    with pytest.raises(StoreError, match="wrong checksum"):
        nimprep.merge_stores(parts, tmp_path / "m.zarr")
    assert not list(tmp_path.glob("*m.zarr*"))


def test_a_merge_that_was_killed_leaves_nothing_at_its_target(
    mortals: Mortals, tmp_path: Path
) -> None:
    parts = [made(tmp_path, "a", range(4)), made(tmp_path, "b", range(4, 6))]
    before = [contents(part) for part in parts]
    nimprep.merge_stores(parts, tmp_path / "m")
    whole = contents(tmp_path / "m")
    shutil.rmtree(tmp_path / "m")
    found = []
    for step in range(20):
        status = mortals.run("merge", tmp_path, tmp_path / "m", step=step)
        if status == 0:
            break
        assert status == -signal.SIGKILL
        assert [contents(part) for part in parts] == before
        there = (tmp_path / "m").exists()
        found.append("new" if there else "none")
        nimprep.merge_stores(parts, tmp_path / "m", overwrite=there)
        assert contents(tmp_path / "m") == whole
        assert not list(tmp_path.glob(".*"))
        shutil.rmtree(tmp_path / "m")
    assert list(dict.fromkeys(found)) == ["none", "new"]
    assert contents(tmp_path / "m") == whole


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nimprep", "merge", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_shows_what_came_of_it(tmp_path: Path) -> None:
    parts = [made(tmp_path, "a", range(2)), made(tmp_path, "b", range(1, 4))]
    refused = run(*parts, tmp_path / "m.zarr")
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: ")
    assert len(refused.stderr.splitlines()) == 1
    done = run(*parts, tmp_path / "m.zarr", "--prefix", ",late/")
    assert done.returncode == 0, done.stderr
    assert "dataset  gmrp, 5 frames of 32x24 pixels" in done.stdout
    assert done.stderr == ""
    assert run(parts[0], tmp_path / "n.zarr").returncode == 2
    assert run(*parts, tmp_path / "n.zarr", "--prefix", "a/").returncode == 2
