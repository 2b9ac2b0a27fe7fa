"""Glob patterns against the regular expression they stand for."""

from __future__ import annotations

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep.readers.patterns import capture

SPANS = {"*": "[^/]*", "?": "[^/]", "**": ".*", "**/": "(?:.*/)?"}
PARTS = st.lists(st.sampled_from([*SPANS, "a", "b", "A", "/", "{x}"]), max_size=5)


def by_regular_expression(parts: list[str], name: str, *, lazy: bool) -> str | None:
    """Match as Python's re does, which tries the ways in the same order."""
    span = "(?P<id>.+?)" if lazy else "(?P<id>.+)"
    spans = {**SPANS, "{id}": span}
    # Neighbouring stars are read as one part from the left.
    tokens = re.split(r"(\{\w+\}|\*\*/?|\*|\?)", "".join(parts))
    regex = "".join(spans.get(token, re.escape(token)) for token in tokens)
    match = re.fullmatch(regex, name, re.DOTALL | re.IGNORECASE)
    return match["id"] if match else None


@given(before=PARTS, after=PARTS, name=st.text("abB/{x}\n", max_size=10), lazy=st.booleans())
@settings(max_examples=300)
def test_it_takes_what_a_regular_expression_takes(
    before: list[str], after: list[str], name: str, lazy: bool
) -> None:
    parts = [*before, "{id}", *after]
    expected = by_regular_expression(parts, name, lazy=lazy)
    assert capture("".join(parts), name, "id", lazy=lazy) == expected


def test_case_does_not_count_and_is_kept() -> None:
    assert capture("RGB/{id}.png", "rgb/A\u0130b.PNG", "id") == "A\u0130b"
