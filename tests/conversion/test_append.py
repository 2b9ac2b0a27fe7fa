"""Frames that join a store: what becomes of them, of those that were there, and of what may not."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import DecodeError, LayoutError, SplitError, StoreError
from nimprep.frame import Frame
from nimprep.splits import count_splits, held_out_count
from nimprep.store.metadata import read_attributes
from nimprep.store.resplit import resplit
from nimprep.store.validate import validate_store
from nimprep.store.writer import StoreWriter
from tests.checksums import edit_attributes
from tests.fakes import contents, write_gmrp, write_nyu_like, write_png

pytestmark = pytest.mark.filterwarnings("ignore:.*nominal:UserWarning")

FOLDERS = ("rgb", "depth_u16", "label")
LATER = ("split/", "zarr.json")
"""What tells how frames came: the rest is as if all had come at once."""


def write_frames(root: Path, numbers: range, size: tuple[int, int] = (24, 32)) -> Path:
    """Write some frames of the dataset that `write_gmrp` makes."""
    write_gmrp(root, numbers.stop, size)
    for folder in ("rgb", "depth_u16", "depth_u8", "label"):
        for number in range(numbers.start):
            (root / folder / f"{number:06d}.png").unlink()
    return root


def damage(path: Path) -> bytes:
    """Cut a file short; return what it was."""
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    return whole


def images_and_tables(store: Path) -> dict[str, bytes]:
    """Return a store's files but the splits and the root's attributes."""
    return {n: data for n, data in contents(store).items() if not n.startswith(LATER)}


@pytest.mark.parametrize(
    ("old", "new", "options"),
    [
        (5, 11, {}),
        (6, 8, {}),
        (1, 2, {}),
        (4, 11, {"crop": (2, 3, 4, 0), "codec": "small"}),
    ],
)
def test_two_parts_make_the_store_that_all_at_once_make(
    tmp_path: Path, old: int, new: int, options: dict[str, object]
) -> None:
    options = {"shard_length": 3, **options}
    whole = nimprep.convert(write_gmrp(tmp_path / "all", new), tmp_path / "all.zarr", **options)
    nimprep.convert(write_gmrp(tmp_path / "a", old), tmp_path / "s.zarr", **options)
    done = nimprep.append_frames(write_frames(tmp_path / "b", range(old, new)), tmp_path / "s.zarr")
    assert done.ids == whole.ids[old:]
    assert done.store.ids == whole.ids
    assert images_and_tables(tmp_path / "s.zarr") == images_and_tables(tmp_path / "all.zarr")
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []
    ours, theirs = done.store.attributes, whole.attributes
    assert ours["depth_percentiles_m"] == theirs["depth_percentiles_m"]
    assert {n for n in ours if ours[n] != theirs[n]} == {"source", "digest"}
    assert {p.name for p in tmp_path.iterdir()} == {"all", "a", "b", "all.zarr", "s.zarr"}


def test_many_small_appends_make_the_same_store(tmp_path: Path) -> None:
    nimprep.convert(write_gmrp(tmp_path / "all", 6), tmp_path / "all.zarr", shard_length=4)
    nimprep.convert(write_gmrp(tmp_path / "0", 1), tmp_path / "s.zarr", shard_length=4)
    for number in range(1, 6):
        part = write_frames(tmp_path / str(number), range(number, number + 1))
        nimprep.append_frames(part, tmp_path / "s.zarr")
    assert images_and_tables(tmp_path / "s.zarr") == images_and_tables(tmp_path / "all.zarr")
    splits = nimprep.open_store(tmp_path / "s.zarr").splits
    assert count_splits(splits.values()) == {"train": 4, "val": 1, "test": 1}


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """Return a store of 5 frames, in shards of 2."""
    nimprep.convert(write_gmrp(tmp_path / "a", 5), tmp_path / "s.zarr", shard_length=2)
    return tmp_path / "s.zarr"


@pytest.fixture
def more(tmp_path: Path) -> Path:
    """Return a source of 6 frames that follow."""
    return write_frames(tmp_path / "b", range(5, 11))


def test_complete_shards_stay_the_files_they_are(store: Path, more: Path) -> None:
    shards = [p for m in nimprep.open_store(store).modalities for p in (store / m / "c").iterdir()]
    whole = [
        next(p for p in shard.rglob("0") if p.is_file()) for shard in shards if shard.name < "2"
    ]
    assert len(whole) == 2 * 5
    before = {path: path.stat() for path in whole}
    nimprep.append_frames(more, store)
    for path, was in before.items():
        now = path.stat()
        assert (now.st_ino, now.st_mtime_ns) == (was.st_ino, was.st_mtime_ns)
        assert now.st_size == was.st_size


def test_only_the_shard_where_old_and_new_meet_is_put_together(
    store: Path, more: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str] = []
    write = StoreWriter.write_shard

    def noted(self: StoreWriter, modality: str, shard: int, chunks: Sequence[bytes]) -> int:
        if "joined" in str(self.storage):
            written.append(self.shard_key(modality, shard))
        return write(self, modality, shard, chunks)

    monkeypatch.setattr(StoreWriter, "write_shard", noted)
    done = nimprep.append_frames(more, store)
    assert [key.split("/")[:3] for key in written] == [
        [modality, "c", "2"] for modality in done.store.modalities
    ]


def test_where_files_cannot_be_linked_they_are_copied(
    store: Path, more: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(store)

    def refuse(self: Path, target: Path) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    nimprep.append_frames(more, store)
    monkeypatch.undo()
    after = contents(store)
    assert all(after[f"{m}/c/1/0/0"] == before[f"{m}/c/1/0/0"] for m in ("depth", "label"))
    assert validate_store(store, deep=True).problems == []


def test_frames_keep_their_split_and_new_ones_get_theirs(store: Path, more: Path) -> None:
    resplit(store, seed=3)
    before = nimprep.open_store(store).splits
    done = nimprep.append_frames(more, store)
    assert {i: done.store.splits[i] for i in before} == before
    held_out = held_out_count(11)
    counts = {"train": 11 - 2 * held_out, "val": held_out, "test": held_out}
    assert count_splits(done.store.splits.values()) == counts
    assert done.store.attributes["split"] == {"rule": "frame", "seed": 3}


def test_a_scene_stays_in_its_split(tmp_path: Path) -> None:
    description = {"group": "{group}/*"}
    root, described = write_nyu_like(tmp_path / "a", **description)
    for scene in ("attic", "cellar"):
        for folder in ("color", "depth", "label", "camera"):
            for number in "01":
                suffix = "json" if folder == "camera" else "png"
                there = root / folder / "kitchen" / f"{number}.{suffix}"
                (root / folder / scene).mkdir(exist_ok=True)
                (root / folder / scene / there.name).write_bytes(there.read_bytes())
    grown = tmp_path / "b"
    for folder in ("color", "depth", "label", "camera"):
        for scene, name in (("attic", "7"), ("barn", "0"), ("kitchen", "9")):
            suffix = "json" if folder == "camera" else "png"
            (grown / folder / scene).mkdir(parents=True, exist_ok=True)
            data = (root / folder / "kitchen" / f"0.{suffix}").read_bytes()
            (grown / folder / scene / f"{name}.{suffix}").write_bytes(data)
    store = nimprep.convert(root, tmp_path / "s.zarr", description=described, split_by="group")
    of_scene = dict(zip(store.tables.group, store.splits.values(), strict=True))
    done = nimprep.append_frames(grown, tmp_path / "s.zarr", description=described)
    splits = done.store.splits
    assert splits["attic/7"] == of_scene["attic"]
    assert splits["kitchen/9"] == of_scene["kitchen"]
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []


def test_new_frames_of_a_store_split_by_a_file_have_no_split(store: Path, more: Path) -> None:
    split = store.parent / "split.json"
    document = {"format": "nimprep-split", "version": "1.0", "train": [], "test": []}
    split.write_text(json.dumps({**document, "val": ["000002"]}))
    resplit(store, split_file=split)
    done = nimprep.append_frames(more, store)
    assert count_splits(done.store.splits.values()) == {
        "train": 0,
        "val": 1,
        "test": 0,
        "none": 10,
    }


def test_the_metadata_says_what_came_when(store: Path, more: Path, tmp_path: Path) -> None:
    first = read_attributes(store)["source"]["digest"]
    alone = nimprep.convert(more, tmp_path / "b.zarr").attributes["source"]["digest"]
    source = nimprep.append_frames(more, store).store.attributes["source"]
    assert [(p["frames"], p["digest"]) for p in source["parts"]] == [(5, first), (6, alone)]
    digest = hashlib.sha256(f"{first}\n{alone}\n".encode()).hexdigest()
    assert source["digest"] == f"sha256:{digest}"
    third = write_frames(tmp_path / "c", range(11, 12))
    camera = (30.0, 30.0, 16.0, 12.0)
    attributes = nimprep.append_frames(third, store, camera=camera).store.attributes
    parts = attributes["source"]["parts"]
    assert [(p["frames"], p["calibration"]) for p in parts] == [
        (5, "nominal"),
        (6, "nominal"),
        (1, "user"),
    ]
    # What holds for all of them.
    assert attributes["calibration"]["origin"] == "nominal"
    assert nimprep.open_store(store)[11].camera.fx == 30.0


def test_a_growing_folder_gives_its_new_frames_alone(tmp_path: Path) -> None:
    source = write_gmrp(tmp_path / "a", 5)
    damage(source / "label" / "000003.png")
    options = {"shard_length": 2, "on_error": "skip"}
    store = nimprep.convert(source, tmp_path / "s.zarr", **options)
    assert [f["id"] for f in store.attributes["skipped"]] == ["000003"]
    write_gmrp(tmp_path / "a", 8)  # mends frame 3 as well
    damage(source / "rgb" / "000006.png")
    with pytest.raises(StoreError, match=r"found '000000' \(4 of 8 are\); --skip-existing"):
        nimprep.append_frames(source, store.path)
    done = nimprep.append_frames(source, store.path, skip_existing=True, on_error="skip")
    assert done.ids == ("000003", "000005", "000007")
    assert done.existing == 4
    assert [frame.id for frame in done.skipped] == ["000006"]
    assert [f["id"] for f in done.store.attributes["skipped"]] == ["000006"]
    assert done.store.ids == ("000000", "000001", "000002", "000004", *done.ids)
    assert validate_store(store.path, deep=True).problems == []
    before = contents(Path(store.path))
    again = nimprep.append_frames(source, store.path, skip_existing=True, on_error="skip")
    assert (again.ids, [frame.id for frame in again.skipped]) == ((), ["000006"])
    assert contents(Path(store.path)) == before
    write_gmrp(tmp_path / "a", 8)
    done = nimprep.append_frames(source, store.path, skip_existing=True)
    assert done.ids == ("000006",)
    assert "skipped" not in done.store.attributes
    before = contents(Path(store.path))
    done = nimprep.append_frames(source, store.path, skip_existing=True)
    assert (done.ids, done.existing) == ((), 8)
    assert contents(Path(store.path)) == before


def test_bad_frames_leave_no_gap(store: Path, more: Path) -> None:
    for number in ("000005", "000006", "000009"):
        damage(more / "depth_u16" / f"{number}.png")
    with pytest.raises(DecodeError, match="000005"):
        nimprep.append_frames(more, store)
    done = nimprep.append_frames(more, store, on_error="skip")
    assert done.ids == ("000007", "000008", "000010")
    assert validate_store(store, deep=True).problems == []
    assert sorted(p.name for p in (store / "rgb" / "c").iterdir()) == ["0", "1", "2", "3"]


def same(a: Frame, b: Frame) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("rgb", "depth_m", "normal", "hha", "label")
    )


def test_a_store_that_is_open_meanwhile_goes_on_reading(store: Path, more: Path) -> None:
    opened = nimprep.open_store(store)
    before = [opened[4]]
    # The index of the last shard is known now; its frames are to stay where they are.
    before = [opened[i] for i in range(5)]
    assert all(frame.normal is not None and frame.hha is not None for frame in before)
    done = nimprep.append_frames(more, store)
    assert all(same(opened[i], before[i]) for i in range(5))
    assert all(same(done.store[i], before[i]) for i in range(5))


def test_the_recipe_is_the_stores(tmp_path: Path) -> None:
    options = {
        "modalities": ("rgb", "depth", "normal"),
        "sign_filter": True,
        "fill": "nearest",
        "store_filled": True,
        "normal_dtype": "int16",
        "crop": (2, 1, 0, 3),
        "shard_length": 4,
    }
    whole = nimprep.convert(write_gmrp(tmp_path / "all", 7), tmp_path / "all.zarr", **options)
    nimprep.convert(write_gmrp(tmp_path / "a", 5), tmp_path / "s.zarr", **options)
    # A source without labels will do where the store has none.
    source = write_frames(tmp_path / "b", range(5, 7))
    for path in (source / "label").iterdir():
        path.unlink()
    done = nimprep.append_frames(source, tmp_path / "s.zarr")
    assert images_and_tables(tmp_path / "s.zarr") == images_and_tables(tmp_path / "all.zarr")
    assert done.store.attributes["modalities"] == whole.attributes["modalities"]


def test_percentiles_are_not_made_up_where_depth_is_not_stored(tmp_path: Path) -> None:
    modalities = ("rgb", "normal")
    nimprep.convert(write_gmrp(tmp_path / "a", 3), tmp_path / "s.zarr", modalities=modalities)
    source = write_frames(tmp_path / "b", range(3, 5))
    done = nimprep.append_frames(source, tmp_path / "s.zarr")
    assert done.store.attributes["depth_percentiles_m"] is None
    assert validate_store(tmp_path / "s.zarr", deep=True).problems == []


def test_smaller_frames_are_padded(store: Path, tmp_path: Path) -> None:
    small = write_frames(tmp_path / "small", range(5, 7), size=(20, 30))
    done = nimprep.append_frames(small, store)
    assert done.store.tables.image_size.tolist() == [[24, 32]] * 5 + [[20, 30]] * 2
    assert validate_store(store, deep=True).problems == []


def test_a_larger_frame_is_refused_by_name(store: Path, tmp_path: Path) -> None:
    large = write_frames(tmp_path / "large", range(5, 7), size=(24, 33))
    words = "at most 32x24 pixels, found 33x24 in frame '000005'; .* merge the two"
    with pytest.raises(StoreError, match=words):
        nimprep.append_frames(large, store)


def refused(source: Path, store: Path, error: type[Exception], words: str) -> None:
    before = contents(store), {p.name for p in store.parent.iterdir()}
    with pytest.raises(error, match=words):
        nimprep.append_frames(source, store)
    assert (contents(store), {p.name for p in store.parent.iterdir()}) == before


def test_frames_of_another_kind_are_refused(store: Path, tmp_path: Path) -> None:
    root, described = write_nyu_like(tmp_path / "other")
    with pytest.raises(LayoutError, match="dataset 'gmrp', which the store's are, found 'nyu-like"):
        nimprep.append_frames(root, store, description=described)
    root, described = write_nyu_like(tmp_path / "named-so", name="gmrp")
    with pytest.raises(LayoutError, match=r"classes 0 background, .* found 0 other, 1 floor"):
        nimprep.append_frames(root, store, description=described)
    without = write_gmrp(tmp_path / "without", 7, labels=False)
    refused(without, store, LayoutError, "label")


def test_what_is_no_complete_store_is_refused(store: Path, more: Path, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"nope\.zarr: expected a nimprep store, found nothing"):
        nimprep.append_frames(more, tmp_path / "not" / "nope.zarr")
    assert not (tmp_path / "not").exists()
    with pytest.raises(StoreError, match=r"no zarr\.json"):
        nimprep.append_frames(more, tmp_path / "a")
    with pytest.raises(StoreError, match="folder on this machine to append to, found a URL"):
        nimprep.append_frames(more, "s3://bucket/s.zarr")
    with pytest.raises(StoreError, match="apart from the source"):
        nimprep.append_frames(store, store)
    edit_attributes(store, format_version="1.3")
    refused(more, store, StoreError, r"expected store format 1\.2 or older .* found '1\.3'")
    edit_attributes(store, format_version="1.2", complete=False)
    refused(more, store, StoreError, "cut short")


def test_a_recipe_of_another_version_is_refused(store: Path, more: Path) -> None:
    modalities = read_attributes(store)["modalities"]
    modalities["hha"]["parameters"]["angle"] = "radians"
    edit_attributes(store, modalities=modalities)
    refused(more, store, StoreError, "expected hha .* as this version makes it, .*radians")


def test_a_frame_without_a_scene_cannot_join_scenes(store: Path, more: Path) -> None:
    edit_attributes(store, split={"rule": "group", "seed": 0})
    refused(more, store, SplitError, "000005: expected a group")


def test_a_link_to_a_store_is_the_store(store: Path, more: Path, tmp_path: Path) -> None:
    (tmp_path / "link.zarr").symlink_to(store)
    nimprep.append_frames(more, tmp_path / "link.zarr")
    assert (tmp_path / "link.zarr").is_symlink()
    assert len(nimprep.open_store(store)) == 11


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "nimprep", "append", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_command_says_what_it_added(store: Path, more: Path) -> None:
    damage(more / "rgb" / "000007.png")
    done = run(more, store, "--on-error", "skip")
    assert done.returncode == 1
    assert done.stdout.startswith("added 5 frames\n\nstore ")
    assert "skipped 000007: rgb/000007.png: expected" in done.stderr
    again = run(more, store)
    assert again.returncode == 1
    errors = [line for line in again.stderr.splitlines() if not line.startswith("warning")]
    assert len(errors) == 1
    assert "expected frames that are not in it yet, found '000005'" in errors[0]
    write_frames(more, range(5, 11))
    last = run(more, store, "--skip-existing", "--intrinsics", "30,30,16,12")
    assert last.returncode == 0, last.stderr
    assert last.stdout.startswith("added 1 frames, 5 were there already\n")
    assert run(more, store, "--camera", "c.json", "--intrinsics", "1,1,1,1").returncode == 2


def test_progress_is_shown_for_each_step(store: Path, more: Path) -> None:
    steps: dict[str, list[int]] = {}

    def progress(step: str, frames: int):  # type: ignore[no-untyped-def]
        steps[step] = [frames, 0]

        def done() -> None:
            steps[step][1] += 1

        return done

    nimprep.append_frames(more, store, progress=progress)
    assert steps == {
        "converting": [6, 6],
        "joining": [11, 11],
        "reading the depth there was": [5, 5],
    }


def test_the_options_are_checked(store: Path, more: Path) -> None:
    with pytest.raises(nimprep.NimprepError, match="workers"):
        nimprep.append_frames(more, store, workers=0)
    with pytest.raises(nimprep.NimprepError, match="on_error"):
        nimprep.append_frames(more, store, nimprep.AppendOptions(on_error="hope"))  # type: ignore[arg-type]


def write_kitti(root: Path, split: str, names: list[str]) -> Path:
    from tests.kitti.scenes import HEIGHT, WIDTH, ground_truth, noise, write_calibration

    for name in names:
        write_calibration(root / split / "calib" / f"{name}.txt")
        write_png(root / split / "image_2" / f"{name}.png", noise(1, HEIGHT, WIDTH, 3))
        depth = np.full((HEIGHT, WIDTH), 8000, np.uint16)
        write_png(root / split / "depth_u16" / f"{name}.png", depth)
        if split == "training":
            road = np.zeros((HEIGHT, WIDTH), bool)
            road[HEIGHT // 2 :] = True
            truth = ground_truth(road, np.ones_like(road))
            write_png(root / split / "gt_image_2" / f"{name.replace('_', '_road_')}.png", truth)
    return root


def test_kittis_testing_frames_are_test_when_they_join(tmp_path: Path) -> None:
    names = [f"{category}_{i:06d}" for category in ("um", "uu") for i in range(4)]
    first = write_kitti(tmp_path / "first", "training", names)
    store = nimprep.convert(first, tmp_path / "s.zarr", split_by="stratified", shard_length=4)
    before = store.splits
    second = write_kitti(tmp_path / "second", "testing", ["um_000000", "umm_000001"])
    write_kitti(second, "training", ["um_000010", "um_000011"])
    after = nimprep.append_frames(second, store.path).store
    assert {i: after.splits[i] for i in before} == before
    testing = ["testing/um_000000", "testing/umm_000001"]
    assert [after.splits[i] for i in testing] == ["test", "test"]
    assert after.attributes["fixed_splits"] == {"test": testing}
    assert "test" not in {after.splits[f"training/um_00001{i}"] for i in "01"}
    columns = after.attributes["frame_metadata"]
    assert all(len(column["of_frame"]) == len(after) for column in columns.values())
    assert columns["depth_source"] == {"values": ["depth_u16"], "of_frame": [0] * len(after)}
    assert validate_store(store.path, deep=True).problems == []


def test_columns_that_some_parts_lack_say_so() -> None:
    from nimprep.conversion.provenance import joined_metadata

    a = {"P2": {"values": ["x", "y"], "of_frame": [0, 1, 0]}}
    b = {
        "P2": {"values": ["y", "z"], "of_frame": [1, 0]},
        "from": {"values": [1], "of_frame": [0, 0]},
    }
    assert joined_metadata([(a, 3), (b, 2), ({}, 1)]) == {
        "P2": {"values": ["x", "y", "z", None], "of_frame": [0, 1, 0, 2, 1, 3]},
        "from": {"values": [None, 1], "of_frame": [0, 0, 0, 1, 1, 0]},
    }
