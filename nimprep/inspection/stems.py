"""Names of files: what in them tells a kind of file, and what varies from frame to frame."""

from __future__ import annotations

import re
from collections.abc import Sequence

from nimprep.inspection.words import has_role

_FIELDS = re.compile(r"[^_\-. ]+|[_\-. ]+")
_END = re.compile(
    r"(?<=\d)[_\-. ]+[A-Za-z][A-Za-z\d]*(?:[_\-. ][A-Za-z][A-Za-z\d]*)*$|[_\-. ][A-Za-z]+$|$"
)
VIEW = re.compile(r"(im|view|disp)\d(GT|[ynLE])?$")
"""Middlebury's names: the digit is the camera."""

MIXED = {"png", "jpg", "jpeg", "bmp", "webp"}
_PICTURES = {"png", "jpg", "jpeg", "bmp", "tif", "tiff", "webp", "npy", "npz", "pgm", "ppm", "pfm"}
"""Endings of images that are often mixed in one folder, and of all images, without the dot."""


def name_key(name: str) -> tuple[str, ...]:
    """Return what tells a file's kind from that of others in its folder."""
    stem, _, ending = name.rpartition(".")
    if VIEW.match(stem):
        return (ending.lower(), stem)
    parts = [part for part in _FIELDS.findall(stem or ending) if part[0] not in "_-. "]
    numbers = [place for place, part in enumerate(parts) if part[0].isdigit()]
    last = numbers[-1] if numbers else len(parts)
    told = [
        re.sub(r"\d{2,}$|(?<=[a-z])\d$", "", part)
        for place, part in enumerate(parts)
        if has_role(part) or (place > last and not re.search(r"\d", part))
    ]
    if not any(letter.isdigit() for letter in stem or ending) and not told:
        told = [stem or ending] if ending.lower() not in _PICTURES else []
    return (ending.lower(), *told)


def affixes(stems: Sequence[str]) -> tuple[str, str]:
    """Return what all names begin and end with, whole words without numbers."""
    first, last = stems[0], stems[-1]
    shortest = min(map(len, stems))
    head = 0
    while head < shortest and first[head] == last[head]:
        head += 1
    match = re.match(r"[^\d]*", first[:head])
    prefix = match[0] if match else ""
    backwards = [stem[::-1] for stem in stems]
    low, high = min(backwards), max(backwards)
    tail = 0
    while tail < shortest and low[tail] == high[tail]:
        tail += 1
    match = _END.search(first)
    suffix = match[0] if match else ""
    if len(suffix) > tail or len(prefix) + len(suffix) >= shortest:
        suffix = ""
    if len(prefix) < len(first) and prefix and first[len(prefix)].isalpha():
        # The names part within a word.
        cut = max(prefix.rfind(sign) for sign in "_-. ")
        prefix = prefix[: cut + 1]
    return prefix, suffix
