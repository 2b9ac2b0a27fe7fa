"""Which frames a page shows, and their pictures within a number of bytes."""

from __future__ import annotations

import base64
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

from nimprep.parallel import Progress, map_in_order, no_progress
from nimprep.report.artist import Artist
from nimprep.report.findings import Finding
from nimprep.report.pictures import encode_picture
from nimprep.splits import hash_order
from nimprep.store.reader import Store

SIZES = ((960, 75), (640, 70), (480, 60), (320, 60))
"""Width in pixels and WebP's quality of a picture on the page: the first with which all fit."""

_PROBES = 8


@dataclass(frozen=True)
class Gallery:
    """Hold the pictures of a page.

    Attributes
    ----------
    width : int
        No picture is wider, pixels.
    frames : dict of int to dict of str to str
        WebP files in base64, by frame index and modality; frames ascending.
    """

    width: int
    frames: dict[int, dict[str, str]]


def order_of_interest(store: Store, findings: Sequence[Finding]) -> list[int]:
    """Return every frame's number, those to be shown first in front.

    In turn a frame of the problems, one of what deserves a look, and one of an even sample, so that
    none of them crowds out the others; the problems and the looks take their findings in turn, and
    the sample the scenes of each split. Frames of a finding or a scene are ordered by a hash of
    their ids: the same on every machine, and no stretch of a recording before another.
    """
    ids = store.ids
    rank = {name: place for place, name in enumerate(hash_order(ids))}

    def hashed(frames: Sequence[int]) -> list[int]:
        return sorted(frames, key=lambda i: rank[ids[i]])

    kinds = []
    for severity in ("problem", "look"):
        # A pair's frames belong next to each other.
        lists = [
            [i for pair in f.pairs for i in pair] or hashed(f.frames)
            for f in findings
            if f.severity == severity
        ]
        kinds.append(_in_turn(lists))
    strata: dict[tuple[int, str], list[int]] = defaultdict(list)
    for i, key in enumerate(zip(store.tables.split.tolist(), store.tables.group, strict=True)):
        strata[key].append(i)
    rest = _in_turn([hashed(strata[key]) for key in sorted(strata)])
    return list(dict.fromkeys(_in_turn([*kinds, rest])))


def _in_turn(lists: Sequence[Sequence[int]]) -> list[int]:
    """Return the lists' first entries, then their second, and so on."""
    longest = max(map(len, lists), default=0)
    return [entries[i] for i in range(longest) for entries in lists if i < len(entries)]


def paint_gallery(
    artist: Artist, order: Sequence[int], limit: int, progress: Progress | None = None
) -> Gallery:
    """Draw frames in order until their base64 has `limit` bytes.

    The pictures are of the first of `SIZES` that lets every frame in, else the last and fewer. The
    same store gives the same pictures on any number of threads.

    Raises
    ------
    StoreError
        The store is damaged.
    """
    names = list(artist.looks)

    def paint(size: tuple[int, int], index: int) -> dict[str, str]:
        pictures = {}
        for name in names:
            data = encode_picture(artist.draw(index, name, size[0]), "webp", size[1])
            pictures[name] = base64.b64encode(data).decode()
        return pictures

    size = _size(paint, order, limit)
    expected = max(1, min(len(order), limit // _length(paint(size, order[0]))))
    done = (progress or no_progress)("drawing", expected)
    frames: dict[int, dict[str, str]] = {}
    used = 0
    with closing(map_in_order(partial(paint, size), order)) as painted:
        for frame, pictures in zip(order, painted, strict=True):
            used += _length(pictures)
            if used > limit:
                break
            frames[frame] = pictures
            done()
    return Gallery(size[0], dict(sorted(frames.items())))


def _length(pictures: dict[str, str]) -> int:
    # The names, quotes and the element around them.
    return sum(len(name) + len(data) + 8 for name, data in pictures.items()) + 80


def _size(
    paint: Callable[[tuple[int, int], int], dict[str, str]],
    order: Sequence[int],
    limit: int,
) -> tuple[int, int]:
    """Return the first of `SIZES` with which all frames should fit, judged by some of them."""
    number = min(_PROBES, len(order))
    probes = [order[i * len(order) // number] for i in range(number)]
    for size in SIZES[:-1]:
        lengths = [_length(p) for p in map_in_order(partial(paint, size), probes)]
        # A tenth in reserve: the probes are a sample.
        if 1.1 * sum(lengths) / number * len(order) <= limit:
            return size
    return SIZES[-1]
