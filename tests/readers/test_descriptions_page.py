"""The examples of docs/descriptions.md are descriptions."""

from __future__ import annotations

import json
import re
from pathlib import Path

from nimprep.readers.description_file import description_from_document

PAGE = Path(__file__).parents[2] / "docs" / "descriptions.md"
BASE = {"format": "nimprep-folder", "version": "1.1", "name": "x", "rgb": "{id}.png"}


def test_every_example_is_a_description() -> None:
    blocks = re.findall(r"```json\n(.*?)```", PAGE.read_text("utf-8"), re.S)
    whole = description_from_document(json.loads(blocks[0]), "docs")
    assert whole.id == "{split}/{scene}/{name}"
    parts = [line for block in blocks[1:] for line in block.splitlines()]
    assert len(parts) == 7
    for part in parts:
        description_from_document({**BASE, **json.loads(part)}, "docs")
