"""Colours of label images as text files beside them name them: "Road 100 60 100" in a line."""

from __future__ import annotations

import re
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.files import read_file
from nimprep.readers.description import Color, LabelSource
from nimprep.readers.matching import Matched, files_for

_MAX_BYTES = 1 << 20


class NamedColors:
    """Give what each frame's colours mean, by the file that holds for it.

    Parameters
    ----------
    root : Path
        The dataset's folder.
    source : LabelSource, optional
        None = there are no labels.
    matched : Matched
        The frames; `lacking` says of which there is no file.
    """

    def __init__(self, root: Path, source: LabelSource | None, matched: Matched) -> None:
        self._source = source
        self.lacking: Mapping[str, str] = {}
        self._files: Mapping[str, Path] = {}
        self._read: dict[Path, LabelSource] = {}
        self._lock = threading.Lock()
        labelled = matched.places.get("label", {})
        if source is None or source.names is None or not labelled:
            return
        places = files_for(root, source.names, matched.captured)
        self._files = {i: place.path for i, place in places.items() if i in labelled}
        self.lacking = {
            i: f"{root}: expected names of colours of frame {i!r} like {source.names!r}, found none"
            for i in labelled
            if i not in self._files
        }

    def source(self, frame_id: str) -> LabelSource | None:
        """Return where labels are and what this frame's mean.

        Raises
        ------
        DecodeError
            Its file names no colours.
        """
        path = self._files.get(frame_id)
        if path is None or self._source is None:
            return self._source
        with self._lock:
            if path not in self._read:
                colors = classes_of_colors(path, self._source)
                self._read[path] = replace(self._source, colors=colors)
            return self._read[path]

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the files that say it."""
        return (self._files[frame_id],) if frame_id in self._files else ()


def classes_of_colors(path: Path, source: LabelSource) -> dict[Color, int]:
    """Return the class of each colour that a file names, and of those that the map does.

    Names that the description does not know have none, but for its default.

    Raises
    ------
    DecodeError
        The file names no colours, one twice, or none of the names that are known.
    """
    found = named_colors(path)
    known = {name.lower(): value for name, value in source.named.items()}
    if not any(name.lower() in known for name in found):
        raise DecodeError(
            f"{path}: expected names among {', '.join(source.named)}, found "
            f"{', '.join(list(found)[:8])}; name these in the description's label"
        )
    classes = dict(source.colors or {})
    named: dict[Color, str] = {}
    for name, color in found.items():
        other = named.setdefault(color, name)
        if known.get(other.lower()) != known.get(name.lower()):
            raise DecodeError(
                f"{path}: expected a colour for each name, found {color} of {other!r} and of "
                f"{name!r}; mend one of the lines"
            )
        if name.lower() in known:
            classes[color] = known[name.lower()]
    return classes


def named_colors(path: Path) -> dict[str, Color]:
    """Read a text file of names and colours: a line each, the three numbers last or first.

    A first line without numbers is a header; ``#`` begins a comment.

    Raises
    ------
    DecodeError
        It cannot be read, or a line is not such a one.
    """
    try:
        text = read_file(path, _MAX_BYTES, "a readable list of colours").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DecodeError(f"{path}: expected text, found other bytes; save it as text") from error
    colors: dict[str, Color] = {}
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    for number, line in enumerate(lines):
        words = [word for word in re.split(r"[\s,;]+", line) if word]
        last, first = _color(words[-3:]), _color(words[:3])
        color, name = (last, words[:-3]) if last is not None else (first, words[3:])
        if color is None or not name:
            if number == 0:
                continue
            raise DecodeError(
                f"{path}: expected a name and its colour from 0 to 255, as in 'Road 100 60 100', "
                f"found {line[:80]!r}; mend the line"
            )
        if colors.setdefault(" ".join(name), color) != color:
            raise DecodeError(
                f"{path}: expected one colour for {' '.join(name)[:80]!r}, found two; remove one"
            )
    if not colors:
        raise DecodeError(f"{path}: expected names of colours, found none; check the file")
    return colors


def _color(words: list[str]) -> Color | None:
    numbers = [int(word) for word in words if word.isascii() and word.isdecimal()]
    if len(numbers) != 3 or max(numbers) > 255:
        return None
    return (numbers[0], numbers[1], numbers[2])
