"""JSON from elsewhere: folder descriptions, cameras and split files."""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from nimprep.errors import CameraError, LayoutError, NimprepError, SplitError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.cameras import camera_from_file
from nimprep.readers.matching import files_by_id, group_of
from nimprep.readers.patterns import captures
from nimprep.splits import split_document, splits_from_file
from tests.fakes import NYU_LIKE, write_nyu_like
from tests.hostile.damage import damaged, damaged_document
from tests.hostile.fuzzing import fuzz, limited_time, survives

CAMERA = {"fx": 30.0, "fy": 31.0, "cx": 17.0, "cy": 13.0, "pixel_origin": 1, "baseline_m": 0.5}
CAMERA |= {"width": 32, "height": 24}
IDS = [f"{n:06d}" for n in range(9)]
SPLITS = split_document({i: ("train", "val", "test")[n % 3] for n, i in enumerate(IDS)})
DESCRIBED = {**NYU_LIKE, "camera": {**CAMERA}}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_nyu_like(tmp_path_factory.mktemp("described") / "nyu")[0]


def written(path: Path, document: Any) -> Path:
    """Write a document, or bytes as they are."""
    data = document if isinstance(document, bytes) else json.dumps(document).encode()
    path.write_bytes(data)
    return path


def either(document: Any) -> st.SearchStrategy[Any]:
    return damaged_document(document) | damaged(json.dumps(document).encode())


@fuzz(200, document=either(NYU_LIKE) | either(DESCRIBED))
def test_any_description_is_followed_or_refused(
    dataset: Path, tmp_path: Path, document: Any
) -> None:
    path = written(tmp_path / "d.json", document)

    def read() -> None:
        reader = open_reader(dataset, options=ReaderOptions(description=path))
        for frame_id in reader.ids:
            reader.shape(frame_id)
            reader.group(frame_id)
            reader.read(frame_id)
            assert all(p.is_relative_to(dataset) for p in reader.sources(frame_id))

    survives("JSON, folder descriptions", read)


@fuzz(150, document=either(CAMERA))
def test_any_camera_is_read_or_refused(tmp_path: Path, document: Any) -> None:
    path = written(tmp_path / "c.json", document)
    survives("JSON, cameras", lambda: camera_from_file(path).camera(24, 32, "a"))


@fuzz(150, document=either(SPLITS))
def test_any_split_file_is_read_or_refused(tmp_path: Path, document: Any) -> None:
    path = written(tmp_path / "s.json", document)
    found = survives("JSON, split files", lambda: splits_from_file(path, IDS))
    assert found is None or list(found) == IDS


def nested(depth: int) -> bytes:
    return b'{"x": ' + b"[" * (depth - 1) + b"]" * (depth - 1) + b"}"


BAD_JSON = {
    "nothing": (b"", "expected JSON, found Expecting value"),
    "a number": (b"1", "schema"),
    "64 deep": (nested(64), "schema"),
    "65 deep": (nested(65), "nested more than 64 deep"),
    "900 deep": (nested(900), "nested more than 64 deep"),
    "100000 deep": (nested(100_000), "nested too deeply"),
    "deep without end": (b'{"x": ' + b"[" * 900_000, "nested too deeply"),
    "a million objects": (b"[" + b"{}," * 1_100_000 + b"{}]", "1100002 lists and objects"),
    "a number of a million digits": (b'{"fx": ' + b"9" * 1_000_000 + b"}", "limit"),
    "an infinite number": (b'{"fx": -1e999}', "the number -1e999, which is too large"),
    "no number": (b'{"fx": NaN}', "NaN, which is no JSON number"),
    "binary": (bytes(range(256)), "expected JSON"),
    "half a surrogate": (b'{"format": "\\ud800"}', "schema"),
    "UTF-16": ('{"fx": 1}'.encode("utf-16"), "expected JSON"),
    "many keys": (json.dumps({str(n): n for n in range(100_000)}).encode(), "schema"),
    "many mistakes": (json.dumps({**SPLITS, "train": [0] * 300_000}).encode(), "schema"),
}


@pytest.mark.parametrize("case", BAD_JSON)
def test_json_made_to_deceive_is_refused(dataset: Path, tmp_path: Path, case: str) -> None:
    data, words = BAD_JSON[case]
    path = written(tmp_path / "x.json", data)
    options = ReaderOptions(description=path)
    for read in (
        lambda: open_reader(dataset, options=options),
        lambda: camera_from_file(path),
        lambda: splits_from_file(path, IDS),
    ):
        with pytest.raises(NimprepError, match=r"x\.json: expected") as caught, limited_time():
            read()
        assert words in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_mistakes_are_counted_up_to_a_hundred(tmp_path: Path) -> None:
    path = written(tmp_path / "x.json", {**SPLITS, "train": [0] * 1000})
    with pytest.raises(SplitError, match=r"and 99 more"):
        splits_from_file(path, IDS)


def test_json_of_more_bytes_than_anyone_writes_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with limited_time(), pytest.raises(CameraError, match="at most"):
        camera_from_file(path)


def test_a_pipe_is_taken_from_the_user_and_not_from_a_dataset(tmp_path: Path) -> None:
    pipe = tmp_path / "c.json"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_text(json.dumps(CAMERA)), daemon=True)
    writer.start()
    with limited_time():
        assert camera_from_file(pipe).intrinsics == (30, 31, 16, 12)
    writer.join()
    root, description = write_nyu_like(tmp_path / "nyu", camera="c.json")
    os.mkfifo(root / "c.json")
    with limited_time(), pytest.raises(CameraError, match=r"c\.json: expected a readable camera"):
        open_reader(root, options=ReaderOptions(description=description))


@pytest.mark.parametrize("camera", ["../c.json", "a/../../c.json", "..", "x" * 250, "a\0b"])
def test_a_camera_file_lies_below_the_dataset(tmp_path: Path, camera: str) -> None:
    written(tmp_path / "c.json", CAMERA)
    root, description = write_nyu_like(tmp_path / "nyu", camera=camera)
    with pytest.raises((LayoutError, CameraError), match="expected"):
        open_reader(root, options=ReaderOptions(description=description))


@pytest.mark.parametrize("pattern", ["x" * 300 + "/{id}", "a\0/{id}", "\ud800/{id}", "a/../{id}"])
def test_a_pattern_that_no_folder_can_have_is_refused(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(LayoutError, match="expected"):
        files_by_id(tmp_path, pattern)


@pytest.mark.parametrize(
    "pattern", ["**a" * 80 + "{id}b", "*a" * 100 + "{id}b", "**/" * 80 + "{id}b"]
)
def test_no_pattern_takes_long_over_any_name(tmp_path: Path, pattern: str) -> None:
    folder = tmp_path.joinpath(*["a" * 200] * 12)
    folder.mkdir(parents=True)
    (folder / ("a" * 200)).touch()
    with limited_time():
        assert files_by_id(tmp_path, pattern) == {}
        assert group_of("a/" * 1000, pattern.replace("{id}", "{group}")) == ""


@pytest.mark.parametrize("pattern", ["{id}{id}" * 30 + "b", "{x}" * 60 + "{id}b", "*{a}{a}" * 35])
def test_no_number_of_placeholders_takes_long(pattern: str) -> None:
    with limited_time():
        assert captures(pattern, "/".join(["a" * 200] * 12)) is None
