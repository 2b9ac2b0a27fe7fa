"""How names of files that belong together differ: left0 and depth0, or a stamp a little later."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from nimprep.inspection.templates import Member, Template

_ID = "{id}"
_MOST = 2000
"""So many files of a pattern are compared."""


@dataclass(frozen=True)
class Pairing:
    """Say how a file is found for a colour image.

    Attributes
    ----------
    color, other : str
        Names without ending, with placeholders.
    matched : int
        Colour images that have such a file, of those compared.
    compared : int
    """

    color: str
    other: str
    matched: int
    compared: int


def paired(color: Template, other: Template) -> Pairing | None:
    """Return how the names of two patterns go together; None = they do not."""
    theirs = _by_place(other)
    ours = _by_place(color)
    compared = sum(map(len, ours.values()))
    if _ID in color.folder or _ID in other.folder:
        count = sum(len(ours[place]) for place in ours if place in theirs)
        same = color.folder.count("{") == other.folder.count("{")
        return Pairing("*", "*", count, compared) if count and same else None
    if other.fixed or color.fixed:
        keys = {name for member in other.members for name in member.captured}
        known = {name for member in color.members for name in member.captured}
        return Pairing(_ID, "", compared, compared) if keys <= known else None
    shared = _shared(color, other)
    ours, theirs = (_by_place(template, shared) for template in (color, other))
    best: tuple[int, str, str, str] | None = None
    for left, right, kind in _differences(ours, theirs):
        matched = _count(ours, theirs, left, right, kind)
        if matched and (best is None or matched > best[0]):
            best = matched, left, right, kind
    if best is None:
        return None
    matched, left, right, kind = best
    if kind == "within":
        head = _common_word(name.partition(left)[0] for names in ours.values() for name in names)
        left, right = head + left, head + right
    return _pairing(left, right, kind, matched, compared)


def _shared(first: Template, second: Template) -> frozenset[str]:
    names = [set(template.members[0].captured) for template in (first, second)]
    return frozenset(names[0] & names[1])


def _by_place(
    template: Template, names: Iterable[str] | None = None
) -> dict[tuple[str, ...], set[str]]:
    """Return files' stems by what the folders' placeholders stand for."""
    found: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for member in template.members[:_MOST] if names is not None else template.members:
        found[_place(member, names)].add(member.stem)
    return found


def _place(member: Member, names: Iterable[str] | None) -> tuple[str, ...]:
    known = member.captured
    return tuple(known[name] for name in sorted(known if names is None else names))


Stems = Mapping[tuple[str, ...], set[str]]


def _differences(ours: Stems, theirs: Stems) -> list[tuple[str, str, str]]:
    """Return what may be put in the place of what: (of colour, of the other, where)."""
    found: dict[tuple[str, str, str], None] = {("", "", "same"): None}
    places = [place for place in ours if place in theirs][:3]
    for place in places:
        for mine in sorted(ours[place])[:3]:
            numbers = re.findall(r"\d+", mine)
            for other in sorted(theirs[place])[:400]:
                there = re.findall(r"\d+", other)
                if numbers[: len(there)] == there or there[: len(numbers)] == numbers:
                    found[_difference(mine, other)] = None
    return list(found)[:40]


def _difference(mine: str, other: str) -> tuple[str, str, str]:
    """Return the parts in which two names differ, whole words, and whether they begin or end."""
    head = _alike(mine, other)
    while head and (mine[head - 1].isalpha() or _goes_on(mine, head) or _goes_on(other, head)):
        head -= 1
    back, back_other = mine[head:][::-1], other[head:][::-1]
    tail = _alike(back, back_other)
    while tail and (back[tail - 1].isalpha() or _goes_on(back, tail) or _goes_on(back_other, tail)):
        tail -= 1
    while tail and head == 0 and back[tail - 1] in "_-. ":
        tail -= 1
    while head and mine[head - 1] in "_-. ":
        head -= 1
    left, right = mine[head : len(mine) - tail], other[head : len(other) - tail]
    if head == 0:
        return left, right, "begins"
    return left, right, "ends" if tail == 0 else "within"


def _common_word(heads: Iterable[str]) -> str:
    """Return the last word that all texts end with, as "_sync", where more comes before it."""
    words = {match[0] if (match := re.search(r"[_\-. ][A-Za-z]+$", head)) else "" for head in heads}
    return words.pop() if len(words) == 1 else ""


def _alike(first: str, second: str) -> int:
    """Return how many letters two texts have in common at their beginnings."""
    pairs = enumerate(zip(first, second, strict=False))
    return next((k for k, (a, b) in pairs if a != b), min(len(first), len(second)))


def _goes_on(name: str, place: int) -> bool:
    """Tell whether a number goes on over a place."""
    return 0 < place < len(name) and name[place - 1].isdigit() and name[place].isdigit()


def _count(ours: Stems, theirs: Stems, left: str, right: str, kind: str) -> int:
    """Return how many names of ours become names of theirs."""
    count = 0
    for place, names in ours.items():
        others = theirs.get(place, set())
        for name in names:
            if kind == "same":
                made = name
            elif kind == "begins" and name.startswith(left):
                made = right + name[len(left) :]
            elif kind == "ends" and name.endswith(left):
                made = name[: len(name) - len(left)] + right
            elif kind == "within" and left and left in name:
                made = name.replace(left, right, 1)
            else:
                continue
            count += made in others
    return count


def _pairing(left: str, right: str, kind: str, matched: int, compared: int) -> Pairing:
    forms = {
        "same": (_ID, _ID),
        "begins": (f"{left}{_ID}", f"{right}{_ID}"),
        "ends": (f"{_ID}{left}", f"{_ID}{right}"),
        "within": (f"{_ID}{left}{{view}}", f"{_ID}{right}{{view}}"),
    }
    return Pairing(*forms[kind], matched, compared)


def common_end(stems: Iterable[str], others: Iterable[str]) -> str:
    """Return an end that all stems have after a separator, and some others have not: "_10"."""
    names = list(stems)
    match = re.search(r"[_\-.][^_\-.]+$", names[0]) if names else None
    if match is None or not all(name.endswith(match[0]) for name in names):
        return ""
    return "" if all(name.endswith(match[0]) for name in others) else match[0]


def stamp_unit(color: Template, other: Template) -> float | None:
    """Return seconds per unit of time stamps that names are; None = they are none.

    Stamps are numbers of a time since 1970, of which those of the two patterns lie close together.
    """
    stems = [[member.stem for member in t.members[:_MOST]] for t in (color, other)]
    if not all(re.fullmatch(r"\d{9,19}(\.\d+)?", stem) for some in stems for stem in some):
        return None
    digits = len(stems[0][0].partition(".")[0])
    unit = {10: 1.0, 13: 1e-3, 16: 1e-6, 19: 1e-9}.get(digits)
    if unit is None:
        return None
    times, theirs = (sorted(float(stem) * unit for stem in some) for some in stems)
    near = sum(any(abs(a - b) < 0.05 for b in theirs) for a in times[:100])
    return unit if near >= 0.5 * min(len(times), 100) else None
