"""Glob patterns with a placeholder, matched in time that no pattern can blow up.

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
    fits = [bytearray(len(text)) + b"\1"]
    for kind, literal in reversed(parts):
        fits.append(_fits(kind, literal, text, fits[-1]))
    if not fits[-1][0]:
        return None
    place, captured = 0, None
    for (kind, literal), after in zip(parts, reversed(fits[:-1]), strict=True):
        stops = [k for k in _stops(kind, literal, text, place) if after[k]]
        stop = stops[0] if kind == "placeholder" and lazy else stops[-1]
        if kind == "placeholder":
            captured = name[place:stop]
        place = stop
    return captured


@lru_cache(maxsize=64)
def _split(pattern: str, placeholder: str) -> tuple[tuple[str, str], ...]:
    """Return a pattern's parts: each one's kind, and the text that a literal one stands for."""
    kinds = {**_KINDS, f"{{{placeholder}}}": "placeholder"}
    found = (part for part in _PARTS.split(pattern) if part)
    return tuple((kinds.get(part, "literal"), _folded(part)) for part in found)


def _folded(text: str) -> str:
    """Return the text in small letters, letter by letter: places stay what they are."""
    return "".join(small if len(small := letter.lower()) == 1 else letter for letter in text)


def _between(parts: tuple[tuple[str, str], ...], name: str, text: str) -> str | None:
    """Return what the placeholder stands for where all else stands for itself."""
    place = [kind for kind, _ in parts].index("placeholder")
    head, tail = ("".join(t for _, t in some) for some in (parts[:place], parts[place + 1 :]))
    if not (text.startswith(head) and text.endswith(tail)) or len(text) <= len(head + tail):
        return None
    return name[len(head) : len(name) - len(tail)]


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
    return range(place, (len(text) if slash < 0 else slash) + 1)
