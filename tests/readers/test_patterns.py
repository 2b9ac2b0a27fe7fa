"""Glob patterns against the regular expression they stand for."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nimprep.readers.patterns import capture, captures, placeholders

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


NAMES = ["{id}", "{x}", "{y}", "{z}"]
SEVERAL = st.lists(st.sampled_from([*SPANS, "a", "b", "A", "/", "_"]), max_size=3)


@given(
    order=st.permutations(NAMES),
    count=st.integers(0, 4),
    between=st.lists(SEVERAL, min_size=5, max_size=5),
    name=st.text("abB/_\n", max_size=12),
)
@settings(max_examples=500)
def test_several_take_what_a_regular_expression_takes(
    order: list[str], count: int, between: list[list[str]], name: str
) -> None:
    parts = list(between[0])
    for each, after in zip(order[:count], between[1:], strict=False):
        parts += [each, *after]
    pattern = "".join(parts)
    spans = {**SPANS, **{n: f"(?P<{n[1:-1]}>[^/]+)" for n in NAMES}, "{id}": "(?P<id>.+)"}
    tokens = re.split(r"(\{\w+\}|\*\*/?|\*|\?)", pattern)
    regex = "".join(spans.get(token, re.escape(token)) for token in tokens)
    match = re.fullmatch(regex, name, re.DOTALL | re.IGNORECASE)
    assert captures(pattern, name) == (match.groupdict() if match else None)


@pytest.mark.parametrize(
    ("pattern", "name", "found"),
    [
        (
            "{split}/{scene}/image/{name}.png",
            "train/a_1/image/0.PNG",
            {"split": "train", "scene": "a_1", "name": "0"},
        ),
        ("{split}/{scene}/image/{name}.png", "train/a/b/image/0.png", None),
        ("{id}/image/*.jpg", "kv1/NYU/1/image/x.jpg", {"id": "kv1/NYU/1"}),
        ("rgb/{id}.*", "rgb/a/b.c.JPG", {"id": "a/b.c"}),
        ("{a}_{b}.png", "x_y_z.png", {"a": "x_y", "b": "z"}),
        ("{scene}/{scene}_{n}.png", "s_1/s_1_07.png", {"scene": "s_1", "n": "07"}),
        ("{scene}/{scene}_{n}.png", "s_1/s_2_07.png", None),
        ("{n}_{scene}/x_{n}.png", "1_2_3/x_1.png", {"scene": "2_3", "n": "1"}),
        ("{id}/{id}.png", "a/a/a/a.png", {"id": "a/a"}),
        ("{n}{n}", "abab", {"n": "ab"}),
        ("camera.json", "Camera.json", {}),
        ("camera.json", "other.json", None),
    ],
)
def test_a_placeholder_stays_within_a_folder_and_stands_for_one_thing(
    pattern: str, name: str, found: dict[str, str] | None
) -> None:
    assert captures(pattern, name) == found


def test_placeholders_are_named_once_in_order() -> None:
    assert placeholders("{b}/{a}/{b}_*.png") == ("b", "a")
