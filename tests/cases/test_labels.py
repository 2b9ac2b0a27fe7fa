"""Labels as painted, exported and renamed by the tools that people use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import DecodeError, LayoutError
from nimprep.readers import ReaderOptions, open_reader
from nimprep.readers.base import Reader

Case = Callable[[str], Path]


def described(root: Path, name: str, description: str) -> Reader:
    return open_reader(root / name, ReaderOptions(description=root / description))


@pytest.mark.parametrize("description", [None, "ids.json", "mapids.json", "mapcol.json"])
def test_a_palettes_index_is_the_class(case: Case, description: str | None) -> None:
    root = case("15-")
    reader = open_reader(root) if description is None else described(root, ".", description)
    for frame_id in ("000000", "000003"):
        expected = np.load(root / f"true_{frame_id}.npy")
        assert np.array_equal(reader.read(frame_id).label, expected)


def test_masks_of_0_and_255_ask_to_be_mapped(case: Case) -> None:
    root = case("16-")
    with pytest.raises(LayoutError, match=r"only 0 and 255 in all of 6.*--label-map 0:0,255:1"):
        open_reader(root)
    reader = open_reader(root, ReaderOptions(label_map="0:0,255:1"))
    label = reader.read("000000").label
    assert label is not None
    assert set(np.unique(label)) == {0, 1}
    ignored = open_reader(root, ReaderOptions(label_map="0:0,255:255")).read("000000").label
    assert np.array_equal(ignored == 255, label == 1)


def test_odd_ids_are_named_and_mapped(case: Case) -> None:
    root = case("17-")
    with pytest.raises(DecodeError, match=r"\[0, 1, 2, 255\], found 15; .*--label-map 15:0"):
        described(root, ".", "a.json").read("000000")
    with pytest.raises(DecodeError, match="found 26001"):
        described(root, ".", "c.json").read("000000")
    right = described(root, ".", "b1.json").read("000001").label
    assert right is not None
    assert set(np.unique(right)) == {0, 1, 2}
    assert np.array_equal(described(root, ".", "c1.json").read("000001").label, right)


def test_colours_are_classes_by_the_map_and_a_map_to_paste_is_shown(case: Case) -> None:
    root = case("19-")
    reader = described(root, ".", "d.json")
    for frame_id in ("0", "3"):
        assert np.array_equal(reader.read(frame_id).label, np.load(root / f"true_{frame_id}.npy"))
    expected = r'3 colours.*"map": {"#000000": 0, "#804080": 1, "#fa3253": 2}'
    with pytest.raises(DecodeError, match=expected):
        described(root, ".", "nomap.json").read("0")
