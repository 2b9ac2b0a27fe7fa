"""A store's parts belong together: shards, tables and attributes of another one are noticed."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from torch.utils.data import DataLoader

import nimprep
from nimprep.cli import main
from nimprep.errors import NimprepError, StoreError
from nimprep.store.checksums import attributes_digest
from nimprep.store.metadata import read_attributes
from nimprep.store.table_specs import table_key, table_specs
from nimprep.store.validate import validate_store
from nimprep.torch import StoreDataset, StoreLoader
from tests.fakes import depth_image, write_png

SIZE = (12, 16)
IMAGES = ("rgb", "depth", "normal", "hha", "label")
FRAMES = 5
SHARDS = 3
OPTIONS: dict[str, Any] = {"shard_length": 2, "camera": (15.0, 15.5, 7.5, 5.5)}


def write_version(root: Path, version: int) -> Path:
    """Write frames whose ids are the same in every version and whose images are not.

    Colours are noise, which nothing packs: their chunks are of one length in all versions.
    """
    for number in range(FRAMES):
        rng = np.random.default_rng((version, number))
        name = f"{number:06d}.png"
        write_png(root / "rgb" / name, rng.integers(0, 256, (*SIZE, 3), dtype=np.uint8))
        write_png(root / "depth_u16" / name, depth_image(10 * version + number, SIZE))
        write_png(root / "label" / name, rng.integers(0, 3, SIZE, dtype=np.uint8))
    return root


@pytest.fixture(scope="module")
def versions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return two stores of the same frames, which differ in every image."""
    folder = tmp_path_factory.mktemp("versions")
    for n in range(2):
        nimprep.convert(write_version(folder / f"{n}", n), folder / f"{n}.zarr", **OPTIONS)
    return [folder / "0.zarr", folder / "1.zarr"]


@pytest.fixture
def store(versions: list[Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(versions[0], tmp_path / "s.zarr"))


def shard(store: Path, name: str, number: int) -> Path:
    return next(p for p in (store / name / "c" / str(number)).rglob("*") if p.is_file())


def exchange(a: Path, b: Path) -> None:
    data = a.read_bytes()
    a.write_bytes(b.read_bytes())
    b.write_bytes(data)


def readable(store: Path, name: str) -> list[bool]:
    """Return whether each frame's image of an array is read; one that is not is named."""
    array = nimprep.open_store(store).arrays[name]
    errors: dict[int, str] = {}
    for frame in range(FRAMES):
        try:
            array.read(frame)
        except StoreError as error:
            errors[frame] = str(error)
    for frame, said in errors.items():
        assert f"/{name}/c/" in said
        assert f"frame '{frame:06d}': expected the image that the store's tables go with" in said
        assert said.endswith("copy the store again, or open it again if it was replaced")
    return [frame not in errors for frame in range(FRAMES)]


@pytest.mark.parametrize("name", IMAGES)
def test_a_shard_of_another_version_is_noticed_at_the_first_read(
    store: Path, versions: list[Path], name: str
) -> None:
    for number in range(SHARDS):
        shutil.copy(shard(versions[1], name, number), shard(store, name, number))
        there = [frame // 2 != number for frame in range(FRAMES)]
        assert readable(store, name) == there
        problems = validate_store(store).problems
        assert len(problems) == 1
        assert f"frame '{2 * number:06d}'" in problems[0]
        shutil.copy(shard(versions[0], name, number), shard(store, name, number))
    assert readable(store, name) == [True] * FRAMES
    report = validate_store(store)
    assert report.problems == []
    assert report.checks["checksums"] == FRAMES * len(IMAGES)


@pytest.mark.parametrize("name", IMAGES)
def test_two_shards_that_were_exchanged_are_noticed(store: Path, name: str) -> None:
    exchange(shard(store, name, 0), shard(store, name, 1))
    assert readable(store, name) == [False] * 4 + [True]
    assert len(validate_store(store).problems) == 2


def test_shards_of_two_modalities_that_were_exchanged_are_noticed(store: Path) -> None:
    # Both hold three bytes a pixel, so that the one is read as the other.
    exchange(shard(store, "rgb", 0), shard(store, "hha", 0))
    assert readable(store, "rgb")[:2] == readable(store, "hha")[:2] == [False] * 2


def test_loaders_workers_and_commands_notice_a_shard_of_another_version(
    store: Path, versions: list[Path], tmp_path: Path
) -> None:
    shutil.copy(shard(versions[1], "label", 0), shard(store, "label", 0))
    data = StoreDataset(store, split=None, setup="rgb+d")
    with pytest.raises(StoreError, match="frame '000000': expected the image"):
        data[0]
    with pytest.raises(StoreError, match=r"frame '00000[01]': expected the image"):
        list(StoreLoader(data, batch_size=2))
    with pytest.raises(StoreError, match=r"frame '00000[01]': expected the image"):
        list(DataLoader(data, batch_size=1, num_workers=1))
    for command in ("export", "report", "validate", "merge"):
        arguments = {
            "export": [store, tmp_path / "o", "--format", "npz"],
            "report": [store, tmp_path / "page.html"],
            "merge": [store, versions[1], tmp_path / "m.zarr", "--prefix", "a/,b/"],
        }.get(command, [store])
        done = CliRunner().invoke(main, [command, *map(str, arguments)])
        assert done.exit_code == 1, command
        assert "another version's" in done.stdout + done.stderr, command


def test_appending_to_a_store_with_a_shard_of_another_version_is_refused(
    store: Path, versions: list[Path], tmp_path: Path
) -> None:
    more = write_version(tmp_path / "more", 0)
    for path in more.rglob("*.png"):
        path.rename(path.with_name(f"1{path.name}"))
    before = nimprep.open_store(versions[0]).ids
    # A whole shard, which is only linked, and the one in which old and new meet.
    for number in (0, 2):
        shutil.copy(shard(versions[1], "label", number), shard(store, "label", number))
        with pytest.raises(StoreError, match=f"'{2 * number:06d}': expected the image"):
            nimprep.append_frames(more, store, camera=OPTIONS["camera"])
        assert nimprep.open_store(store).ids == before
        shutil.copy(shard(versions[0], "label", number), shard(store, "label", number))
    nimprep.append_frames(more, store, camera=OPTIONS["camera"])
    assert validate_store(store, deep=True).problems == []


@pytest.mark.parametrize("used", [False, True])
@pytest.mark.parametrize("length", [2, 3])
def test_a_reader_opened_before_its_store_was_replaced_never_gives_the_new_images(
    store: Path, versions: list[Path], used: bool, length: int
) -> None:
    opened = nimprep.open_store(store)
    if used:
        for array in opened.arrays.values():
            for frame in range(FRAMES):
                array.read(frame)
    source = versions[1].parent / "1"
    options = {**OPTIONS, "shard_length": length}
    nimprep.convert(source, store, **options, overwrite=True)
    for array in opened.arrays.values():
        for frame in range(FRAMES):
            with pytest.raises(StoreError):
                array.read(frame)
    new = nimprep.open_store(store)
    assert np.array_equal(new[3].rgb, nimprep.open_store(versions[1])[3].rgb)


def grow(store: Path, versions: list[Path], folder: Path) -> None:
    """Append frames: the last shard, in which old and new meet, becomes another file."""
    more = write_version(folder / "more", 0)
    for path in more.rglob("*.png"):
        path.rename(path.with_name(f"1{path.name}"))
    nimprep.append_frames(more, store, camera=OPTIONS["camera"])


def replace(store: Path, versions: list[Path], folder: Path) -> None:
    nimprep.convert(versions[1].parent / "1", store, **OPTIONS, overwrite=True)


def samples(batches: Any) -> Iterator[list[Any]]:
    for batch in batches:
        for frame_id, image, label in zip(
            batch["id"], batch["inputs"], batch["label"], strict=True
        ):
            yield [frame_id, image.numpy(), label.numpy()]


def forked(data: StoreDataset) -> Iterator[list[Any]]:
    loader = DataLoader(data, num_workers=1, prefetch_factor=1, multiprocessing_context="fork")
    batches: Any = iter(loader)
    try:
        yield from samples(batches)
    finally:
        # An error's traceback would keep it.
        batches._shutdown_workers()


READERS: dict[str, Callable[[StoreDataset], Iterator[list[Any]]]] = {
    "Store": lambda data: ([f.id, f.rgb, f.depth_m, f.label] for f in data.store),
    "StoreDataset": lambda data: (
        [s["id"], s["inputs"].numpy(), s["label"].numpy()] for s in map(data.__getitem__, ALL)
    ),
    "StoreLoader": lambda data: samples(StoreLoader(data, num_threads=1, prefetch=1)),
    "forked worker": forked,
}
"""By a reader's name, what it gives of each frame in turn."""

ALL = range(FRAMES)


@pytest.mark.parametrize("begun", [False, True])
@pytest.mark.parametrize("change", [grow, replace])
@pytest.mark.parametrize("name", READERS)
def test_a_reader_opened_before_a_change_gives_its_own_images_or_an_error(
    name: str,
    change: Callable[..., None],
    begun: bool,
    store: Path,
    versions: list[Path],
    tmp_path: Path,
) -> None:
    data = StoreDataset(store, split=None, setup="rgb+d")
    expected = list(READERS[name](StoreDataset(versions[0], split=None, setup="rgb+d")))
    reading = READERS[name](data)
    # With the frame that is read first, a worker may read the two after it before the change.
    found = [next(reading)] if begun else []
    change(store, versions, tmp_path)
    with (
        pytest.raises(StoreError, match="open it again if it was replaced")
        if change is replace
        else nullcontext()
    ):
        found += reading
    assert len(found) < FRAMES if change is replace else len(found) == FRAMES
    for ours, theirs in zip(found, expected, strict=False):
        assert ours[0] == theirs[0]
        assert all(np.array_equal(a, b) for a, b in zip(ours[1:], theirs[1:], strict=True))


def changed_tables(versions: list[Path]) -> list[str]:
    a, b = (nimprep.open_store(path).storage for path in versions)
    return [n for n in table_specs() if a.read(table_key(n)) != b.read(table_key(n))]


def test_a_table_of_another_version_is_noticed_on_opening(
    store: Path, versions: list[Path]
) -> None:
    names = changed_tables(versions)
    assert {"channel_sums", "chunk_crc32c"} <= set(names)
    for name in names:
        shutil.copy(versions[1] / table_key(name), store / table_key(name))
        said = f"{name}: expected the table that the root's attributes name, found another"
        with pytest.raises(StoreError, match=said):
            nimprep.open_store(store)
        assert any(said in problem for problem in validate_store(store).problems)
        shutil.copy(versions[0] / table_key(name), store / table_key(name))
    nimprep.open_store(store)


def test_the_root_of_another_version_is_noticed_on_opening(
    store: Path, versions: list[Path]
) -> None:
    shutil.copy(versions[1] / "zarr.json", store / "zarr.json")
    with pytest.raises(StoreError, match="the table that the root's attributes name"):
        nimprep.open_store(store)


def rewrite(store: Path, change: Callable[[dict[str, Any]], object]) -> None:
    root = json.loads((store / "zarr.json").read_text())
    change(root["attributes"]["nimprep"])
    (store / "zarr.json").write_text(json.dumps(root))


CHANGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "crop": lambda a: a["crop"].update(top=3),
    "rule": lambda a: a["split"].update(rule="stratified"),
    "seed": lambda a: a["split"].update(seed=7),
    "a class's name": lambda a: a["classes"][1].update(name="water"),
    "a class's number": lambda a: a["classes"][1].update(id=9),
    "classes": lambda a: a["classes"].reverse(),
    "dataset": lambda a: a.update(dataset="other"),
    "source": lambda a: a["source"].update(digest="sha256:" + 64 * "0"),
    "codec": lambda a: a.update(codec="small"),
    "how a modality was made": lambda a: a["modalities"]["hha"].update(method="x"),
    "calibration": lambda a: a["calibration"].update(origin="file"),
    "frames with a split of their own": lambda a: a.update(fixed_splits={"test": ["000001"]}),
    "depth": lambda a: a["depth_percentiles_m"].update({"5": 0.5}),
    "the format, to one without checksums": lambda a: a.update(format_version="1.0"),
    "the format, to a newer one": lambda a: a.update(format_version="1.3"),
    "the version of the tool": lambda a: a.update(tool_version="9"),
    "something new": lambda a: a.update(note="x"),
}


@pytest.mark.parametrize("case", CHANGES)
def test_attributes_that_were_changed_are_noticed_on_opening_and_by_validate(
    store: Path, case: str
) -> None:
    rewrite(store, CHANGES[case])
    said = r"attributes: expected the digest sha256:\w+, found attributes with sha256:\w+"
    with pytest.raises(StoreError, match=said):
        nimprep.open_store(store)
    problems = validate_store(store).problems
    assert len(problems) == 1
    assert "they are damaged, or were changed by another program" in problems[0]


def test_any_entry_of_the_attributes_counts(store: Path) -> None:
    for name in read_attributes(store):
        if name in ("format_version", "complete", "digest"):
            continue
        whole = (store / "zarr.json").read_text()
        rewrite(store, lambda a, name=name: a.pop(name))
        with pytest.raises(NimprepError):
            nimprep.open_store(store)
        (store / "zarr.json").write_text(whole)


def test_attributes_mean_the_same_however_json_is_written(store: Path) -> None:
    root = json.loads((store / "zarr.json").read_text())
    attributes = root["attributes"]["nimprep"]
    attributes["depth_percentiles_m"]["95"] = 6.0
    attributes["note"] = {"é": [1.5, -0.0, 1e300, [2.0, "x"]]}
    attributes["digest"] = attributes_digest(attributes)
    text = json.dumps(root, sort_keys=True, ensure_ascii=False, indent=1)
    for written, other in (("6.0", "6"), ("-0.0", "0"), ("2.0", "2"), ("1e+300", "1E300")):
        assert written in text
        text = text.replace(written, other)
    (store / "zarr.json").write_text(text)
    assert nimprep.open_store(store).attributes["depth_percentiles_m"]["95"] == 6


def test_attributes_beside_ours_are_anybodys(store: Path) -> None:
    root = json.loads((store / "zarr.json").read_text())
    root["attributes"]["mine"] = {"note": "x"}
    (store / "zarr.json").write_text(json.dumps(root))
    assert validate_store(store).problems == []


def test_the_table_of_chunks_names_its_columns(store: Path) -> None:
    document = json.loads((store / "chunk_crc32c" / "zarr.json").read_text())
    assert document["attributes"]["modalities"] == list(IMAGES)
    assert document["dimension_names"] == ["frame", "modality"]
    opened = nimprep.open_store(store)
    for column, name in enumerate(IMAGES):
        for frame in range(FRAMES):
            chunk = opened.arrays[name].fetch(frame)
            assert chunk is not None
            assert opened.tables.chunk_crc32c is not None
            found = int(opened.tables.chunk_crc32c[frame, column])
            assert found == int.from_bytes(chunk[-4:].tobytes(), "little")


def test_some_modalities_of_a_store_are_compared_with_their_own_columns(store: Path) -> None:
    opened = nimprep.open_store(store, modalities=("label", "depth"))
    assert [opened.arrays["label"].read(n).shape for n in range(FRAMES)] == [SIZE] * FRAMES
    assert opened[4].depth_m is not None
