"""Stores of earlier formats, as the versions that had them wrote them."""

import shutil
from collections.abc import Callable
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import zarr
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.errors import StoreError
from nimprep.store.info import info_text, store_info
from nimprep.store.resplit import resplit
from nimprep.store.shards import encode_shard
from nimprep.store.spec import FORMAT_VERSION
from nimprep.store.validate import validate_store
from tests.checksums import edit_attributes
from tests.conversion.test_append import images_and_tables, write_frames
from tests.fakes import contents, depth_image, write_gmrp

DATA = Path(__file__).parent / "data"
SIZE = (12, 16)
OPTIONS = {"shard_length": 3, "camera": (15.0, 15.5, 7.5, 5.5), "hha_ground": "lowest"}
"""What the store of format 1.0 was made with."""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Return a store of format 1.0: five frames of every modality, three to a shard."""
    return Path(shutil.copytree(DATA / "format-1.0", tmp_path / "old.zarr"))


def depth(number: int) -> np.ndarray:
    """Return the depth that frame `number` was made from, metres."""
    raw = depth_image(number, SIZE)
    return np.where(raw == 65535, 0, raw) / np.float32(1000)


def test_a_store_of_format_1_0_is_small_and_of_that_format() -> None:
    assert sum(p.stat().st_size for p in (DATA / "format-1.0").rglob("*") if p.is_file()) < 60_000
    assert nimprep.open_store(DATA / "format-1.0").attributes["format_version"] == "1.0"


def test_a_store_of_format_1_0_reads_as_what_was_converted(old: Path) -> None:
    store = nimprep.open_store(old)
    assert store.ids == tuple(f"{n:06d}" for n in range(5))
    assert list(store.splits.values()) == ["test", "train", "val", "train", "train"]
    for number, frame in enumerate(store):
        assert frame.rgb is not None
        assert frame.label is not None
        assert frame.hha is not None
        assert frame.normal is not None
        rgb = np.random.default_rng(number).integers(0, 256, (*SIZE, 3), dtype=np.uint8)
        assert np.array_equal(frame.rgb, rgb)
        assert np.array_equal(frame.depth_m, depth(number))
        assert np.unique(frame.label).tolist() == [0, 1, 2]
        assert np.array_equal(frame.normal.any(axis=2), depth(number) > 0)
        assert np.array_equal(frame.hha, nimprep.encode_hha(depth(number), frame.camera))


@pytest.mark.parametrize("deep", [False, True])
def test_a_store_of_format_1_0_is_valid(old: Path, deep: bool) -> None:
    report = validate_store(old, deep=deep)
    assert report.problems == []
    assert report.frames == 5


def test_a_shard_that_another_program_wrote_into_a_store_of_format_1_0_is_read(old: Path) -> None:
    before = nimprep.open_store(old)[2].label
    array = zarr.open_group(old, mode="r+")["label"]
    array[0] = 255  # all fill value: zarr leaves the chunk out of the shard
    array[1] = 1
    store = nimprep.open_store(old)
    assert store[0].label is not None
    assert (store[0].label == 255).all()
    assert np.array_equal(store[1].label, np.ones_like(before))
    assert np.array_equal(store[2].label, before)
    assert validate_store(old).problems == []


def test_info_says_which_format_a_store_has(old: Path) -> None:
    text = info_text(store_info(old))
    assert "(format 1.0)" in text
    assert "5 frames of 16x12 pixels" in text


@pytest.fixture
def more(tmp_path: Path) -> Path:
    """Return a source of the three frames that follow."""
    return write_frames(tmp_path / "more", range(5, 8), SIZE)


def test_appending_to_a_store_of_format_1_0_makes_what_converting_all_makes(
    old: Path, more: Path, tmp_path: Path
) -> None:
    whole = old / "rgb/c/0/0/0/0"
    number = whole.stat().st_ino
    nimprep.append_frames(more, old, camera=OPTIONS["camera"])
    store = nimprep.convert(write_gmrp(tmp_path / "all", 8, SIZE), tmp_path / "all.zarr", **OPTIONS)
    assert nimprep.open_store(old).attributes["format_version"] == FORMAT_VERSION
    grown, anew = images_and_tables(old), images_and_tables(Path(store.path))
    # The kept store's gravity is of another machine's LAPACK, whose last bits are its own.
    for of in (grown, anew):
        assert [name for name in of if name.startswith("gravity/c/")] == ["gravity/c/0/0"]
        del of["gravity/c/0/0"]
    assert grown == anew
    pulls = [nimprep.open_store(path).tables.gravity for path in (old, store.path)]
    assert np.abs(pulls[0] - pulls[1]).max() <= 1e-12
    assert whole.stat().st_ino == number
    assert validate_store(old, deep=True).problems == []


def test_an_absent_chunk_of_a_store_of_format_1_0_is_made_anew_in_what_is_appended_to_it(
    old: Path, more: Path
) -> None:
    # Other programs leave out chunks that are all fill value.
    store = nimprep.open_store(old)
    labels = [store.arrays["label"].read(n) for n in range(5)]
    chunks = [store.arrays["label"].fetch(n) for n in (0, 2)]
    first = [chunk.tobytes() for chunk in chunks if chunk is not None]
    absent = encode_shard(first, 3)
    index = np.frombuffer(absent[-1][:-4], "<u8").reshape(3, 2)[[0, 2, 1]].tobytes()
    checksum = google_crc32c.value(index).to_bytes(4, "little")
    (old / "label/c/0/0/0").write_bytes(b"".join([*first, index, checksum]))
    (old / "label/c/1/0/0").write_bytes(b"".join(encode_shard([], 3)))
    nimprep.append_frames(more, old, camera=OPTIONS["camera"])
    after = nimprep.open_store(old).arrays["label"]
    for number in (1, 3, 4):
        assert (after.read(number) == 255).all()
        assert after.fetch(number) is not None
    for number in (0, 2):
        assert np.array_equal(after.read(number), labels[number])
    # Sums are of colour, depth and HHA: that some labels are other ones, they do not tell.
    assert validate_store(old, deep=True).problems == []


@pytest.mark.parametrize("turned", [False, True])
def test_a_store_of_format_1_0_merges_with_one_that_has_its_normals(
    old: Path, more: Path, tmp_path: Path, turned: bool
) -> None:
    grown = Path(shutil.copytree(DATA / "format-1.0", tmp_path / "grown.zarr"))
    nimprep.append_frames(more, grown, camera=OPTIONS["camera"])
    both, prefixes = [grown, old], ["of today-", ""]
    if turned:
        both, prefixes = both[::-1], prefixes[::-1]
    merged = nimprep.merge_stores(both, tmp_path / "m.zarr", prefixes=prefixes)
    assert merged.attributes["format_version"] == FORMAT_VERSION
    ids = [f"{n:06d}" for n in range(5)] + [f"of today-{n:06d}" for n in range(8)]
    assert sorted(merged.ids) == ids
    assert validate_store(tmp_path / "m.zarr", deep=True).problems == []
    for frame in merged:
        assert np.array_equal(frame.depth_m, depth(int(frame.id.removeprefix("of today-"))))


def test_normals_made_up_without_neighbours_are_not_merged_with_those_that_are_none(
    old: Path, more: Path, tmp_path: Path
) -> None:
    new = Path(nimprep.convert(more, tmp_path / "new.zarr", **OPTIONS).path)
    with pytest.raises(
        StoreError, match=r"expected normal .* found .*'lone': 'none'.*; convert one"
    ):
        nimprep.merge_stores([old, new], tmp_path / "m.zarr")
    assert not (tmp_path / "m.zarr").exists()


def test_splitting_a_store_of_format_1_0_anew_leaves_it_one(old: Path) -> None:
    before = contents(old)
    attributes = nimprep.open_store(old).attributes
    splits = resplit(old, seed=5)
    after = contents(old)
    assert {n for n in before if before[n] != after[n]} == {"zarr.json", "split/c/0"}
    store = nimprep.open_store(old)
    assert store.splits == splits
    assert store.attributes == {**attributes, "split": {"rule": "frame", "seed": 5}}
    assert validate_store(old, deep=True).problems == []


def test_a_page_is_made_of_a_store_of_format_1_0(old: Path, tmp_path: Path) -> None:
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    done = CliRunner().invoke(main, ["report", str(old), str(tmp_path / "page.html")])
    assert done.exit_code == 0, done.stderr
    assert "000004" in (tmp_path / "page.html").read_text()


def test_a_store_of_format_1_0_is_exported_and_trained_from(old: Path, tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from nimprep.torch import StoreDataset, StoreLoader

    done = CliRunner().invoke(main, ["export", str(old), str(tmp_path / "o"), "--format", "npz"])
    assert done.exit_code == 0, done.stderr
    assert len(list((tmp_path / "o").rglob("*.npz"))) == 5
    data = StoreDataset(old, split=None, setup="nim-rgb+d")
    batches = list(StoreLoader(data, batch_size=5))
    assert torch.equal(batches[0]["label"][3], data[3]["label"])


CHANGES: dict[str, Callable[[Path, Path], object]] = {
    "split": lambda store, more: resplit(store, seed=1),
    "append": lambda store, more: nimprep.append_frames(more, store, camera=OPTIONS["camera"]),
    "merge": lambda store, more: nimprep.merge_stores([store, store], store.parent / "m.zarr"),
}


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    """Return a store of a format that adds an array and an attribute to today's."""
    path = Path(
        nimprep.convert(write_gmrp(tmp_path / "a", 4, SIZE), tmp_path / "n.zarr", **OPTIONS).path
    )
    shutil.copytree(path / "depth", path / "confidence")
    edit_attributes(path, format_version="1.3", sensor={"name": "x"})
    return path


def test_a_newer_minor_format_is_read_and_what_is_new_in_it_passed_over(newer: Path) -> None:
    store = nimprep.open_store(newer)
    assert [np.array_equal(f.depth_m, depth(int(f.id))) for f in store] == [True] * 4
    assert validate_store(newer, deep=True).problems == []
    assert "(format 1.3)" in info_text(store_info(newer))


@pytest.mark.parametrize("change", CHANGES)
def test_a_newer_minor_format_is_left_alone_by_what_would_lose_what_is_new_in_it(
    newer: Path, more: Path, change: str
) -> None:
    before = contents(newer.parent)
    with pytest.raises(StoreError, match=r"format 1\.2 or older .* found '1\.3'; a newer nimprep"):
        CHANGES[change](newer, more)
    assert contents(newer.parent) == before


@pytest.mark.parametrize(
    "command", ["info", "validate", "split", "report", "export", "append", "merge"]
)
def test_a_newer_major_format_is_refused_by_every_command(
    newer: Path, more: Path, tmp_path: Path, command: str
) -> None:
    edit_attributes(newer, format_version="3.0")
    arguments = {
        "append": [more, newer],
        "merge": [newer, newer, tmp_path / "m.zarr"],
        "report": [newer, tmp_path / "page.html"],
        "export": [newer, tmp_path / "out", "--format", "npz"],
    }.get(command, [newer])
    done = CliRunner().invoke(main, [command, *map(str, arguments)])
    assert done.exit_code == 1
    expected = (
        f"error: {newer}: expected store format 1.2, found '3.0'; a newer nimprep may read it"
    )
    assert done.stderr.strip() == expected


def test_a_store_of_format_1_1_reads_as_what_was_converted_and_takes_frames(
    more: Path, tmp_path: Path
) -> None:
    path = Path(shutil.copytree(DATA / "format-1.1", tmp_path / "s.zarr"))
    store = nimprep.open_store(path)
    assert store.about.format_version == "1.1"
    assert store.modality("depth").step == 0.001
    assert [np.array_equal(f.depth_m, depth(int(f.id))) for f in store] == [True] * 5
    assert validate_store(path).problems == []
    assert "(format 1.1)" in info_text(store_info(store))
    nimprep.append_frames(more, path, camera=OPTIONS["camera"])
    grown = nimprep.open_store(path)
    assert grown.about.format_version == FORMAT_VERSION
    assert [np.array_equal(f.depth_m, depth(int(f.id))) for f in grown] == [True] * 8
