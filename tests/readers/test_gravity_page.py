"""The examples of docs/gravity.md are descriptions."""

from __future__ import annotations

import json
import re
from pathlib import Path

from nimprep.readers.description import GravitySource
from nimprep.readers.description_file import description_from_document

PAGE = Path(__file__).parents[2] / "docs" / "gravity.md"
BASE = {"format": "nimprep-folder", "version": "1.1", "name": "x", "rgb": "{scene}/{name}.png"}


def test_every_example_is_a_description() -> None:
    blocks = re.findall(r"```json\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    assert len(blocks) == 4
    for block in blocks:
        document = {**BASE, "id": "{scene}/{name}", **json.loads(block)}
        source = description_from_document(document, "docs").gravity
        assert isinstance(source, GravitySource)
    assert source.values == "acceleration"
