"""Ways to damage bytes and JSON documents."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from typing import Any

from hypothesis import strategies as st

NUMBERS = [0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]
"""Where counts turn around."""


@st.composite
def damaged(draw: st.DrawFn, whole: bytes, most: int = 4) -> bytes:
    """Flip, cut, repeat and overwrite bytes of a file, a few times, anywhere."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(1, most))):
        place = draw(st.integers(0, max(0, len(data) - 1)))
        kind = draw(st.sampled_from(("flip", "cut", "number", "insert", "remove", "repeat")))
        if kind == "flip" and data:
            data[place] ^= draw(st.integers(1, 255))
        elif kind == "cut":
            del data[place:]
        elif kind == "number":
            size = draw(st.sampled_from((1, 2, 4, 8)))
            order = draw(st.sampled_from(("little", "big")))
            number = draw(st.sampled_from(NUMBERS)) % (1 << 8 * size)
            data[place : place + size] = number.to_bytes(size, order)
        elif kind == "insert":
            data[place:place] = draw(st.binary(max_size=20))
        elif kind == "remove":
            del data[place : place + draw(st.integers(1, 40))]
        else:
            data[place:place] = data[place : place + draw(st.integers(1, 60))]
    return bytes(data)


JUNK: st.SearchStrategy[Any] = st.one_of(
    st.sampled_from(
        [
            None,
            True,
            0,
            -1,
            1.0,
            1e308,
            5e-324,
            2**31,
            2**63,
            10**400,
            "",
            "..",
            "../../../etc/passwd",
            "/etc/passwd",
            "\x00",
            "\x1b[31m\n",
            "\ud800",
            "x" * 300,
            "file:///etc/passwd",
            "https://localhost:9/x",
            [],
            {},
            [[]] * 50,
            {"name": "pickle"},
        ]
    ),
    st.integers(),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(max_size=12),
    st.lists(st.integers(-3, 300), max_size=4),
)
"""Values of every JSON type, more of those that somebody might forget."""


def places(document: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value in a JSON document, the document's own too."""
    yield path
    children: Any = ()
    if isinstance(document, dict):
        children = document.items()
    elif isinstance(document, list):
        children = enumerate(document)
    for key, value in children:
        yield from places(value, (*path, key))


@st.composite
def damaged_document(
    draw: st.DrawFn, whole: Any, junk: st.SearchStrategy[Any] = JUNK, most: int = 3
) -> Any:
    """Replace, remove and add values of a JSON document, a few of them, anywhere."""
    document = copy.deepcopy(whole)
    for _ in range(draw(st.integers(1, most))):
        path = draw(st.sampled_from(list(places(document))))
        if not path:
            continue
        parent = document
        for key in path[:-1]:
            parent = parent[key]
        kind = draw(st.sampled_from(("replace", "replace", "remove", "add")))
        if kind == "replace":
            parent[path[-1]] = copy.deepcopy(draw(junk))
        elif kind == "remove":
            del parent[path[-1]]
        elif isinstance(parent, dict):
            parent[draw(st.sampled_from(["x", "", "..", "../x", "a/b"]))] = copy.deepcopy(
                draw(junk)
            )
        else:
            parent.insert(path[-1], copy.deepcopy(draw(junk)))
    return document


def sometimes(strategy: st.SearchStrategy[Any], change: Callable[[Any], Any]) -> Any:
    """Return examples of a strategy, half of them changed once more."""
    return st.one_of(strategy, strategy.map(change))
