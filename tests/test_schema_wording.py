"""What is wrong with a description is said in words for who wrote it."""

import json
from pathlib import Path
from typing import Any

import pytest

from nimprep.errors import LayoutError
from nimprep.readers.description_file import description_from_document

GOOD: dict[str, Any] = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "street",
    "rgb": "rgb/{id}.png",
    "depth": {"files": "depth/{id}.png", "scale_m": 0.001},
    "camera": {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "width": 64, "height": 48},
}
CAMERA = GOOD["camera"]
DEPTH = GOOD["depth"]

WRONG = {
    "a key of the whole": (
        {"lable": "l/{id}.png"},
        "the unknown key 'lable'; did you mean 'label'?",
    ),
    "a key like none": ({"weather": 1}, "the unknown key 'weather'; known are format, version"),
    "a key of depth": (
        {"depth": {**DEPTH, "ofset_m": 1}},
        "$.depth: the unknown key 'ofset_m'; did",
    ),
    "a key misspelt, so that one is missing": (
        {"depth": {"file": "d/{id}.png", "scale_m": 1}},
        "the unknown key 'file'; did you mean 'files'?",
    ),
    "a key of rgb": ({"rgb": {"files": "a", "chanels": "BGR"}}, "did you mean 'channels'?"),
    "a number that is missing": (
        {"camera": {"fx": 60, "fy": 60, "cx": 31.5}},
        "$.camera: 'cy' is a required property",
    ),
    "a camera's file": ({"camera": {"file": "a.txt"}}, "did you mean 'files'?"),
    "a camera's key that would be passed over": (
        {"camera": {**{k: v for k, v in CAMERA.items() if k != "width"}, "widht": 64}},
        "did you mean 'width'?",
    ),
    "a word": ({"depth": {**DEPTH, "values": "deph"}}, "did you mean 'depth'?"),
    "a number in quotes": ({"depth": {**DEPTH, "scale_m": "0.001"}}, "leave out the quotes"),
    "text for an object": ({"depth": "depth/{id}.png"}, 'write {"files": ..., ...}'),
    "four numbers of a colour": (
        {"classes": [{"id": 0, "name": "a", "color": [0, 0, 0, 255]}]},
        "[0, 0, 0, 255] with 4 items, and not at most 3",
    ),
    "another format": ({"format": "coco"}, "'coco', and not 'nimprep-folder'"),
    "a path from the root": ({"rgb": "/a/{id}.png"}, "begins with '/'"),
    "an id without placeholders": ({"id": "frame"}, "'frame' has no {placeholder}"),
}


@pytest.mark.parametrize(("change", "said"), WRONG.values(), ids=WRONG)
def test_a_mistake_in_a_description_is_said_in_words(change: dict[str, Any], said: str) -> None:
    with pytest.raises(LayoutError) as caught:
        description_from_document({**GOOD, **change}, "d.json")
    line = str(caught.value)
    assert line.startswith("d.json: ")
    assert said in line
    assert len(line) < 300
    assert not any(word in line for word in ("Additional properties", "given schemas", "match '"))


def test_keys_of_other_programs_beside_a_cameras_numbers_are_passed_over() -> None:
    camera = {**CAMERA, "serial": "0815", "fps": 30}
    assert description_from_document({**GOOD, "camera": camera}, "d.json").camera is not None


def test_the_good_description_is_good() -> None:
    assert description_from_document(json.loads(json.dumps(GOOD)), "d.json").name == "street"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("a.zip", "found an archive; unpack it, and give the folder"),
        ("a.png", "found a file; give the folder that holds all of them"),
        ("nothing", "found nothing; check the path"),
    ],
)
def test_what_is_no_folder_is_named(tmp_path: Path, name: str, said: str) -> None:
    from nimprep.readers import open_reader

    if name != "nothing":
        (tmp_path / name).write_bytes(b"PK")
    with pytest.raises(LayoutError, match=said):
        open_reader(tmp_path / name)


def test_a_folder_that_a_pattern_names_is_compared_with_those_there(tmp_path: Path) -> None:
    from nimprep.readers.tree import found_files

    for name in ("rgb", "label", ".git"):
        (tmp_path / name).mkdir()
    with pytest.raises(LayoutError, match=rf"found none; folders in {tmp_path} are label, rgb$"):
        list(found_files(tmp_path, "depth/left/{id}.png"))
    with pytest.raises(LayoutError, match=r"rgb holds no folders$"):
        list(found_files(tmp_path, "rgb/left/{id}.png"))
