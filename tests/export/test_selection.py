"""Which frames --frames names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nimprep.errors import StoreError
from nimprep.export.selection import select_frames

IDS = ("000000", "000001", "a,b", "train", "5", "1:2")
SPLITS = ("train", "val", "test", "test", "none", "train")


class FakeStore:
    path = Path("s.zarr")
    ids = IDS

    def __len__(self) -> int:
        return len(IDS)

    def indices(self, split: str) -> np.ndarray:
        return np.flatnonzero([name == split for name in SPLITS])


@pytest.mark.parametrize(
    ("items", "numbers"),
    [
        (None, [0, 1, 2, 3, 4, 5]),
        (["0:2"], [0, 1]),
        ([":"], [0, 1, 2, 3, 4, 5]),
        (["4:"], [4, 5]),
        ([":1", "5:99"], [0, 5]),
        (["test"], [2, 3]),
        (["none, val"], [1, 4]),
        (["000001,000000,000001"], [0, 1]),
        # What is an id is that frame, and nothing else.
        (["train"], [3]),
        (["5"], [4]),
        (["1:2"], [5]),
        (["a,b"], [2]),
        (["a,b", "0:1"], [0, 2]),
    ],
)
def test_ids_come_before_splits_and_splits_before_ranges(
    items: list[str] | None, numbers: list[int]
) -> None:
    assert select_frames(FakeStore(), items) == numbers


@pytest.mark.parametrize(
    ("items", "message"),
    [
        (["nobody"], "expected a frame's id, a split .* or a range START:END, found 'nobody'"),
        (["2"], "found '2'; frame number 2 is 2:3"),
        (["-1:3"], "found '-1:3'"),
        (["1:2:3"], "found '1:2:3'"),
        (["9999999999:"], "found '9999999999:'"),
        (["6:9"], "expected frames in '6:9', found none of the store's 6"),
        (["0:1,"], "found ''"),
        ([""], "found ''"),
        ([], "found none chosen"),
    ],
)
def test_what_names_no_frame_is_refused(items: list[str], message: str) -> None:
    with pytest.raises(StoreError, match=message):
        select_frames(FakeStore(), items)
