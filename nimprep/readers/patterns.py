"""Glob patterns with placeholders, matched in time that no pattern can blow up.

A regular expression with several stars tries every way to share a name among them: with ten of
them, one long name that does not fit keeps it busy for ever. Here the places from which the rest
of the pattern can still match are found first, from the end; then each part takes what it likes of
them, from the start: one pass each, whatever the pattern.
"""

from __future__ import annotations

import re
from functools import lru_cache

_PARTS = re.compile(r"(\{\w+\}|\*\*/?|\*|\?)")
_KINDS = {"*": "star", "?": "one", "**": "any", "**/": "folders"}
_SPANNING = "id"
"""The placeholder that may span folders."""
_MOST_STEPS = 200_000
"""Letters looked at, for a placeholder that comes again, before it is said not to fit."""

Parts = tuple[tuple[str, str], ...]
"""A pattern's parts: each one's kind, and the text of a literal one or a placeholder's name."""


def placeholders(pattern: str) -> tuple[str, ...]:
    """Return the names of a pattern's placeholders, each once, in order."""
    return tuple(dict.fromkeys(re.findall(r"\{(\w+)\}", pattern)))


def captures(pattern: str, name: str) -> dict[str, str] | None:
    """Return what each of a pattern's placeholders stands for in a name; None = it does not fit.

    Parameters
    ----------
    pattern : str
        As of `capture`, but that ``{id}`` alone spans folders: every other placeholder is one
        character or more within a folder. Each takes as much as it can, the first ones first; one
        that comes again stands for the same again.
    name : str
        A path, with "/".
    """
    within = _within_folders(pattern)
    if within is None:
        return _captured(_parts(pattern), name)
    names = name.split("/")
    if len(names) != len(within):
        return None
    found: dict[str, str] = {}
    for parts, each in zip(within, names, strict=True):
        captured = _captured(parts, each)
        if captured is None:
            return None
        found |= captured
    return found


def capture(pattern: str, name: str, placeholder: str, *, lazy: bool = False) -> str | None:
    """Return what a pattern's placeholder stands for in a name; None = it does not fit.

    Parameters
    ----------
    pattern : str
        ``*`` and ``?`` stay within a folder, ``**`` crosses folders, ``**/`` is any folders or
        none, ``{placeholder}`` is one character or more. Case does not count.
    name : str
        A path, with "/".
    placeholder : str
    lazy : bool
        The placeholder takes as little as it can; all else, from the left, as much as it can.
    """
    parts, text = _split(pattern, placeholder), _folded(name)
    if sum(kind != "literal" for kind, _ in parts) == 1:
        return _between(parts, name, text)
    fits = _fits_from(parts, text)
    if not fits[0][0]:
        return None
    place, captured = 0, None
    for (kind, literal), after in zip(parts, fits[1:], strict=True):
        stops = [k for k in _stops(kind, literal, text, place) if after[k]]
        stop = stops[0] if kind == "placeholder" and lazy else stops[-1]
        if kind == "placeholder":
            captured = name[place:stop]
        place = stop
    return captured


@lru_cache(maxsize=64)
def _parts(pattern: str) -> Parts:
    found: list[tuple[str, str]] = []
    for part in filter(None, _PARTS.split(pattern)):
        name = part[1:-1]
        if part == f"{{{name}}}" and name:
            found.append(("placeholder" if name == _SPANNING else "name", name))
        else:
            found.append((_KINDS.get(part, "literal"), _folded(part)))
    return tuple(found)


@lru_cache(maxsize=64)
def _within_folders(pattern: str) -> tuple[Parts, ...] | None:
    """Return the parts for each folder and the name; None where something goes across."""
    parts = _parts(pattern)
    names = [name for kind, name in parts if kind == "name"]
    if any(kind in ("placeholder", "any", "folders") for kind, _ in parts):
        return None
    # One that comes again ties a folder to another.
    if len(set(names)) != len(names):
        return None
    return tuple(map(_parts, pattern.split("/")))


def _captured(parts: Parts, name: str) -> dict[str, str] | None:
    """Return what the placeholders stand for, where the parts fit all of a name."""
    text = _folded(name)
    special = [kind for kind, _ in parts if kind != "literal"]
    if not special:
        return {} if text == "".join(literal for _, literal in parts) else None
    if special == ["placeholder"] or (special == ["name"] and "/" not in name):
        value = _between(parts, name, text)
        named = next(name for kind, name in parts if kind != "literal")
        return None if value is None else {named: value}
    fits = _fits_from(parts, text)
    if not fits[0][0]:
        return None
    found: dict[str, str] = {}
    place = 0
    for number in range(len(parts)):
        kind, literal = parts[number]
        stops = [k for k in _stops(kind, literal, text, place) if fits[number + 1][k]]
        if kind in ("placeholder", "name"):
            stop: int | None = stops[-1]
            if (kind, literal) in parts[number + 1 :]:
                stop, parts, fits = _repeated(parts, fits, text, number, place, stops)
            if stop is None:
                return None
            found[literal] = name[place:stop]
            place = stop
        else:
            place = stops[-1]
    return found


def _repeated(
    parts: Parts, fits: list[bytearray], text: str, number: int, place: int, stops: list[int]
) -> tuple[int | None, Parts, list[bytearray]]:
    """Return where a placeholder that comes again stops, and the rest with what it stands for."""
    before, rest = parts[: number + 1], parts[number + 1 :]
    tried = (k for k in reversed(stops) if text.find(text[place:k], k) >= 0)
    for stop, _ in zip(tried, range(1 + _MOST_STEPS // len(parts) // len(text)), strict=False):
        same = ("literal", text[place:stop])
        known = tuple(same if part == parts[number] else part for part in rest)
        further = _fits_from(known, text)
        if further[0][stop]:
            return stop, before + known, [*fits[: number + 1], *further]
    return None, parts, fits


@lru_cache(maxsize=64)
def _split(pattern: str, placeholder: str) -> Parts:
    """Return a pattern's parts, one placeholder alone being one: others stand for themselves."""
    kinds = {**_KINDS, f"{{{placeholder}}}": "placeholder"}
    found = (part for part in _PARTS.split(pattern) if part)
    return tuple((kinds.get(part, "literal"), _folded(part)) for part in found)


def _folded(text: str) -> str:
    """Return the text in small letters, letter by letter: places stay what they are."""
    return "".join(small if len(small := letter.lower()) == 1 else letter for letter in text)


def _between(parts: Parts, name: str, text: str) -> str | None:
    """Return what the placeholder stands for where all else stands for itself."""
    place = [kind != "literal" for kind, _ in parts].index(True)
    head, tail = ("".join(t for _, t in some) for some in (parts[:place], parts[place + 1 :]))
    if not (text.startswith(head) and text.endswith(tail)) or len(text) <= len(head + tail):
        return None
    return name[len(head) : len(name) - len(tail)]


def _fits_from(parts: Parts, text: str) -> list[bytearray]:
    """Return from which places each part and all after it fit; last, where a name ends."""
    fits = [bytearray(len(text)) + b"\1"]
    for kind, literal in reversed(parts):
        fits.append(_fits(kind, literal, text, fits[-1]))
    return fits[::-1]


def _fits(kind: str, literal: str, text: str, after: bytearray) -> bytearray:
    """Return from which places a part and all after it fit, from where all after it does."""
    length = len(text)
    here = bytearray(length + 1)
    if kind == "literal":
        for stop in range(len(literal), length + 1):
            start = stop - len(literal)
            here[start] = after[stop] and text.startswith(literal, start)
        return here
    further = 0
    for place in range(length, -1, -1):
        # `further`: whether some stop beyond this place fits.
        if kind == "one":
            here[place] = further and text[place] != "/"
            further = after[place]
        elif kind == "placeholder":
            here[place] = further
            further |= after[place]
        elif kind == "name":
            inside = place < length and text[place] != "/"
            here[place] = further and inside
            further = (further and inside) | after[place]
        elif kind == "folders":
            here[place] = further | after[place]
            further |= after[place] and place > 0 and text[place - 1] == "/"
        else:
            if kind == "star" and place < length and text[place] == "/":
                further = 0
            further |= after[place]
            here[place] = further
    return here


def _stops(kind: str, literal: str, text: str, place: int) -> range | list[int]:
    """Return where a part that starts at a place can stop, in order."""
    if kind == "literal":
        return range(place + len(literal), place + len(literal) + 1)
    if kind in ("one", "placeholder"):
        return range(place + 1, place + 2 if kind == "one" else len(text) + 1)
    if kind == "any":
        return range(place, len(text) + 1)
    if kind == "folders":
        return [place, *(k + 1 for k in range(place, len(text)) if text[k] == "/")]
    slash = text.find("/", place)
    return range(place + (kind == "name"), (len(text) if slash < 0 else slash) + 1)
