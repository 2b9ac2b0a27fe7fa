"""Stores from somebody else: documents, tables and chunks that are not what they say."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from nimprep.errors import StoreError
from nimprep.modality import MODALITIES
from nimprep.store.images import ImageArray
from nimprep.store.reader import open_store
from nimprep.store.spec import MAX_FRAMES
from nimprep.store.table_specs import table_specs
from nimprep.store.validate import validate_store
from tests.hostile.damage import damaged, damaged_document
from tests.hostile.fuzzing import fuzz, limited_time, survives
from tests.hostile.stores import (
    MISSING,
    changed,
    check,
    document,
    packed,
    read,
    sealed,
    shard,
    show,
    strings,
    table,
    table_file,
    zstd_bomb,
)

IMAGES = ("rgb", "depth", "normal", "hha", "label")
TABLES = table_specs(IMAGES)
ARRAYS = (*IMAGES, *TABLES)


def use(store: Path, kind: str, *actions: Callable[[Path], None]) -> None:
    """Show a store, check it and read all of it, or some of that."""
    for action in actions or (show, check, read):
        survives(kind, lambda action=action: action(store))


@fuzz(100, data=st.data())
def test_any_documents_make_a_store_or_are_refused(made_store: Path, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["", "", "", *ARRAYS]), "array")
    whole = document(made_store, name)
    if name == "" and data.draw(st.booleans(), "attributes alone"):
        inner = whole["attributes"]["nimprep"]
        whole["attributes"]["nimprep"] = data.draw(damaged_document(inner))
    else:
        whole = data.draw(damaged_document(whole))
    with changed(made_store, {f"{name}/zarr.json".lstrip("/"): whole}):
        use(made_store, "stores, documents", show, check)


@fuzz(60, data=st.data())
def test_any_bytes_of_a_document_are_taken_or_refused(
    made_store: Path, data: st.DataObject
) -> None:
    key = data.draw(st.sampled_from(["zarr.json", *(f"{name}/zarr.json" for name in ARRAYS)]))
    with changed(made_store, {key: data.draw(damaged((made_store / key).read_bytes()))}):
        use(made_store, "stores, documents", show, check)


NUMBERS = [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e308, -1e308, 5e-324, 1e-9, 1e9, 30.0]
IDS = ["", ".", "..", "a/../b", "/a", "a\\..\\b", "\x1b[2J", "\n", "\0", "a" * 3000, "ä/ü", "x"]


@fuzz(80, data=st.data())
def test_any_values_in_the_tables_are_taken_or_refused(
    made_store: Path, data: st.DataObject
) -> None:
    tables = open_store(made_store).tables
    files = {}
    for name in data.draw(st.lists(st.sampled_from(sorted(TABLES)), min_size=1, max_size=3)):
        values: Any = getattr(tables, name)
        if TABLES[name].dtype == "string":
            files[table_file(name)] = table(
                [data.draw(st.sampled_from(IDS) | st.text(max_size=9)) for _ in values]
            )
            continue
        values = values.copy()
        flat = values.reshape(-1)
        for place in data.draw(st.lists(st.integers(0, flat.size - 1), min_size=1, max_size=4)):
            if flat.dtype.kind == "f":
                flat[place] = data.draw(st.sampled_from(NUMBERS))
            else:
                limits = np.iinfo(flat.dtype)
                flat[place] = data.draw(st.sampled_from([limits.min, limits.max, 0, 1, 7]))
        files[table_file(name)] = table(values)
    with changed(made_store, files):
        use(made_store, "stores, tables", show, check)


@fuzz(100, data=st.data())
def test_any_bytes_of_a_table_are_taken_or_refused(made_store: Path, data: st.DataObject) -> None:
    key = table_file(data.draw(st.sampled_from(sorted(TABLES))))
    whole = (made_store / key).read_bytes()
    broken = data.draw(damaged(whole[:-4]))
    with changed(made_store, {key: sealed(broken)}):
        use(made_store, "stores, tables", show)


@fuzz(200, data=st.data())
def test_any_bytes_of_a_chunk_are_taken_or_refused(made_store: Path, data: st.DataObject) -> None:
    store = open_store(made_store)
    array = store.arrays[data.draw(st.sampled_from(IMAGES))]
    chunks = []
    for frame in range(2):
        found = array.fetch(frame)
        assert found is not None
        chunks.append(found.tobytes()[:-4])
    chunks[0] = data.draw(damaged(chunks[0]))
    with changed(made_store, {array.shard_key(0): shard([sealed(c) for c in chunks])}):
        use(made_store, "stores, chunks", read)


@fuzz(100, data=st.data())
def test_any_index_of_a_shard_is_taken_or_refused(made_store: Path, data: st.DataObject) -> None:
    key = "label/c/0/0/0"
    whole = (made_store / key).read_bytes()
    size = len(whole)
    numbers = st.sampled_from([0, 1, 4, 20, size - 36, size, 2**32, 2**63, MISSING - 1, MISSING])
    entries = data.draw(st.lists(numbers, min_size=4, max_size=4))
    with changed(made_store, {key: shard([whole[:-36]], entries)}):
        use(made_store, "stores, shard indices", read)


def with_frames(store: Path, frames: int, shard_length: int | None = None) -> dict[str, Any]:
    """Return documents and tables of a store that claims so many frames."""
    files: dict[str, Any] = {}
    for name in ARRAYS:
        found = document(store, name)
        found["shape"][0] = frames
        if name in TABLES:
            found["chunk_grid"]["configuration"]["chunk_shape"][0] = frames
            dtype = TABLES[name].dtype
            rest = int(np.prod(found["shape"][1:]))
            if dtype != "string":
                size = frames * rest * np.dtype(dtype).itemsize
                files[table_file(name)] = sealed(zstd_bomb(size))
        elif shard_length is not None:
            found["chunk_grid"]["configuration"]["chunk_shape"][0] = shard_length
        files[f"{name}/zarr.json"] = found
    return files


@pytest.mark.parametrize("frames", [MAX_FRAMES + 1, 1 << 28, 1 << 62, 1 << 64, -1, 0])
def test_frames_beyond_reason_cost_nothing(made_store: Path, frames: int) -> None:
    files = with_frames(made_store, max(0, min(frames, 1 << 28)))
    for key, content in files.items():
        if key.endswith("zarr.json"):
            content["shape"][0] = frames
    with changed(made_store, files), limited_time():
        with pytest.raises(StoreError, match="expected a table"):
            open_store(made_store)
        assert not validate_store(made_store).valid


def test_as_many_frames_as_may_be_are_refused_in_bounded_memory_and_time(made_store: Path) -> None:
    files = with_frames(made_store, MAX_FRAMES, shard_length=1)
    for name in ("frame_id", "group"):
        files[table_file(name)] = sealed(zstd_bomb(4 + 4 * MAX_FRAMES))
    # The count of strings is a zero among zeros.
    with (
        changed(made_store, files),
        limited_time(),
        pytest.raises(StoreError, match="number of strings"),
    ):
        open_store(made_store)
    names = strings([b"%d" % n for n in range(MAX_FRAMES)])
    from numcodecs import zstd

    for name in ("frame_id", "group"):
        files[table_file(name)] = sealed(zstd.compress(names, 1))
    with changed(made_store, files), limited_time(60):
        report = validate_store(made_store, deep=True)
    assert not report.valid
    assert report.frames == MAX_FRAMES
    assert len(report.problems) == 100


BAD_STRINGS = {
    "one longer than the chunk": strings([b"a", b"b"]) + struct.pack("<I", 0xFFFFFFFF),
    "four billion": strings([b"a", b"b", b"c"], 0xFFFFFFFF),
    "none": strings([]),
    "no text": strings([b"\xff\xfe", b"b", b"c"]),
    "a gigabyte": None,
}


@pytest.mark.parametrize("case", BAD_STRINGS)
def test_strings_that_cannot_be_are_refused(made_store: Path, case: str) -> None:
    from numcodecs import zstd

    data = BAD_STRINGS[case]
    chunk = zstd_bomb(1 << 30) if data is None else zstd.compress(data, 1)
    with changed(made_store, {table_file("frame_id"): sealed(chunk)}), limited_time():
        with pytest.raises(StoreError, match="frame_id: expected a table"):
            open_store(made_store)
        assert not validate_store(made_store).valid


@pytest.mark.parametrize(
    "frame_id", ["..", "a/../../b", "/etc/passwd", "a\\..\\b", "a//b", "\x1b[2J"]
)
def test_ids_that_lead_elsewhere_as_files_are_refused(made_store: Path, frame_id: str) -> None:
    chunk = table(["a", frame_id, "c"])
    with (
        changed(made_store, {table_file("frame_id"): chunk}),
        pytest.raises(StoreError, match="frame_id: expected names that files"),
    ):
        open_store(made_store)


def header(whole: bytes, **changes: int) -> bytes:
    """Return a Blosc buffer whose header says something else, its checksum fitting."""
    fields = dict(zip(("version", "format", "flags", "typesize"), whole[:4], strict=True))
    fields |= dict(
        zip(("nbytes", "blocksize", "cbytes"), struct.unpack("<3I", whole[4:16]), strict=True)
    )
    fields |= changes
    return sealed(struct.pack("<4B3I", *fields.values()) + whole[16:])


LIES = {
    "unpacks to four gigabytes": {"nbytes": 0xFFFFFFFF},
    "unpacks to nothing": {"nbytes": 0},
    "packed in more than there is": {"cbytes": 0xFFFFFFFF},
    "blocks of nothing": {"blocksize": 0},
    "blocks of four gigabytes": {"blocksize": 0xFFFFFFFF},
    "blocks of a byte": {"blocksize": 1},
    "elements of nothing": {"typesize": 0},
    "elements of 255 bytes": {"typesize": 255},
    "shuffled": {"flags": 0x01},
    "bits shuffled": {"flags": 0x04},
    "not packed": {"flags": 0x02},
    "packed by snappy": {"flags": 0x40},
    "packed by zlib": {"flags": 0x60},
    "packed by nobody": {"flags": 0xE0},
    "another version": {"version": 9, "format": 9},
}


@pytest.mark.parametrize("case", LIES)
def test_a_blosc_header_that_lies_is_refused_or_gives_an_image(made_store: Path, case: str) -> None:
    image = np.random.default_rng(0).integers(0, 3, (24, 32), dtype=np.uint8)
    chunk = header(packed(image), **LIES[case])
    with changed(made_store, {"label/c/0/0/0": shard([chunk, chunk])}):
        use(made_store, "stores, chunks")
        if "bytes" in " ".join(LIES[case]):
            with pytest.raises(StoreError, match="bytes that become 768, found"):
                read(made_store)


def test_a_chunk_larger_than_its_image_is_refused_unread(made_store: Path) -> None:
    path = made_store / "label/c/0/0/0"
    whole = path.read_bytes()
    size = 1 << 40
    try:
        with path.open("r+b") as file:
            file.truncate(size)
            file.seek(size)
            file.write(sealed(struct.pack("<4Q", 0, size, 0, size)))
        with limited_time(), pytest.raises(StoreError, match="expected chunks of at most"):
            read(made_store)
        report = validate_store(made_store)
        assert any("chunks of at most" in problem for problem in report.problems)
    finally:
        path.write_bytes(whole)


def test_images_of_a_petabyte_are_refused(made_store: Path) -> None:
    whole = document(made_store, "rgb")
    whole["shape"][1:] = [1 << 24, 1 << 24, 3]
    with changed(made_store, {"rgb/zarr.json": whole}):
        use(made_store, "stores, documents")
        with pytest.raises(StoreError, match="rgb"):
            ImageArray(open_store(made_store, ["label"]).storage, MODALITIES["rgb"])


@pytest.mark.parametrize("number", ["1e999", "-1e999", "NaN", "Infinity"])
def test_numbers_that_json_has_not_are_refused(made_store: Path, number: str) -> None:
    whole = (made_store / "zarr.json").read_bytes()
    data = whole.replace(b'"origin"', b'"x": %s, "origin"' % number.encode())
    with (
        changed(made_store, {"zarr.json": data}),
        pytest.raises(StoreError, match=r"zarr\.json: expected JSON, found"),
    ):
        show(made_store)


@pytest.mark.parametrize("of_frame", [[9, 0, 0], [0], [], [10**30, 0, 1]])
def test_metadata_that_does_not_fit_the_frames_is_found_and_does_no_harm(
    made_store: Path, of_frame: list[int]
) -> None:
    whole = document(made_store)
    column = {"values": [{"x": []}, 7, None], "of_frame": of_frame}
    whole["attributes"]["nimprep"]["frame_metadata"] = {"depth_source": column}
    with changed(made_store, {"zarr.json": whole}):
        show(made_store)
        problems = validate_store(made_store).problems
    assert any("one value of 'depth_source' per frame" in p for p in problems), problems
