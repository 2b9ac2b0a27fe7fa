"""The page of labels and colour: every example is one that is read."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from nimprep.readers.description_file import description_from_document

PAGE = Path(__file__).parents[2] / "docs" / "labels-and-colour.md"
LABELS, NAMED, COLORS = (
    block.splitlines() for block in re.findall(r"```json\n(.*?)```", PAGE.read_text("utf-8"), re.S)
)
DOCUMENT = {
    "format": "nimprep-folder",
    "version": "1.1",
    "name": "own",
    "rgb": "rgb/{id}.png",
    "classes": [{"id": n, "name": f"{n}", "color": [0, 0, 0]} for n in range(2)],
}


def test_there_are_examples() -> None:
    assert (len(LABELS), len(NAMED), len(COLORS)) == (6, 1, 3)


def test_the_example_of_named_colours_is_a_description() -> None:
    document = {**DOCUMENT, "rgb": "{scene}/rgb/{id}.png", "label": json.loads(NAMED[0])}
    label = description_from_document(document, "page").label
    assert label is not None
    assert label.named == {"Road": 1, "Sky": 0}


@pytest.mark.parametrize("line", LABELS)
def test_an_example_is_a_description_of_labels(line: str) -> None:
    label = description_from_document({**DOCUMENT, "label": json.loads(line)}, "page").label
    assert label is not None
    assert label.files.startswith("label/")


@pytest.mark.parametrize("line", COLORS)
def test_an_example_is_a_description_of_colour(line: str) -> None:
    said = json.loads(line)
    rgb = description_from_document({**DOCUMENT, "rgb": said}, "page").rgb
    assert rgb.range == tuple(said["range"])
