"""Which frames to export: ids, splits and ranges of numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable

from nimprep.errors import StoreError
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store

_RANGE = re.compile(r"(\d{0,9}):(\d{0,9})", re.ASCII)


def select_frames(store: Store, items: Iterable[str] | None = None) -> list[int]:
    """Return the indices of the frames that the items name together, in the store's order.

    Parameters
    ----------
    store : Store
    items : iterable of str, optional
        Each a frame's id; else the name of a split; else START:END, frame numbers counted from 0
        in the store's order, END left out, either may be missing; else several of these, joined by
        commas. None = all frames.

    Raises
    ------
    StoreError
        An item names nothing, or there is no item.
    """
    if items is None:
        return list(range(len(store)))
    numbers: dict[str, list[int]] = {}
    for number, frame_id in enumerate(store.ids):
        numbers.setdefault(frame_id, []).append(number)
    chosen: set[int] = set()
    for item in items:
        # An id may hold a comma, or be called like a split: the id is what is meant.
        for name in [item] if item in numbers else map(str.strip, item.split(",")):
            chosen.update(numbers.get(name) or _split_or_range(store, name))
    if not chosen:
        raise StoreError(f"{store.path}: expected frames to export, found none chosen")
    return sorted(chosen)


def _split_or_range(store: Store, name: str) -> Iterable[int]:
    limits = _RANGE.fullmatch(name)
    if name in SPLIT_CODES:
        found: Iterable[int] = store.indices(name).tolist()
    elif limits is not None:
        start, end = (int(text) if text else None for text in limits.groups())
        found = range(len(store))[start:end]
    else:
        hint = f"; frame number {name} is {name}:{int(name) + 1}" if name.isdecimal() else ""
        raise StoreError(
            f"{store.path}: expected a frame's id, a split ({', '.join(SPLIT_CODES)}) or a range "
            f"START:END, found {name!r}{hint}"
        )
    if not found:
        raise StoreError(
            f"{store.path}: expected frames in {name!r}, found none of the store's {len(store)}"
        )
    return found
