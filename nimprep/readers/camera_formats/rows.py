"""A camera per row of a table, as Virtual KITTI 2 has one per frame and camera.

Its intrinsic.txt begins with ``frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from nimprep.errors import CameraError
from nimprep.readers.camera_formats.numbers import CameraNumbers, number_of, size_of

_NAMES = {"k[0,0]": "fx", "k[1,1]": "fy", "k[0,2]": "cx", "k[1,2]": "cy"}
_NAMES |= {"fl_x": "fx", "fl_y": "fy", "ppx": "cx", "ppy": "cy"}
_GRAVITY = ("gravity_x", "gravity_y", "gravity_z")
_NAMES |= {name: name for name in ("fx", "fy", "cx", "cy", "width", "height", "baseline_m")}
_NAMES |= {name: name for name in _GRAVITY}
_SEPARATOR = re.compile(r"\s*[,;\t](?![^\[\]]*\])\s*|\s+")


@dataclass(frozen=True)
class CameraTable:
    """Hold a table's cameras.

    Attributes
    ----------
    where : str
    names : tuple of str
        What tells the rows: columns that are no numbers of a camera.
    rows : mapping of what these columns hold to camera
    """

    where: str
    names: tuple[str, ...]
    rows: Mapping[tuple[str, ...], CameraNumbers]
    _shared: dict[tuple[str, ...], Mapping[tuple[str, ...], CameraNumbers | None]] = field(
        default_factory=dict, compare=False, repr=False
    )

    def of(self, captured: Mapping[str, str]) -> CameraNumbers:
        """Return the camera of the frame whose placeholders stand for these.

        Columns that no placeholder is called like do not tell: rows that differ in these alone must
        have the same camera.

        Raises
        ------
        CameraError
            There is no row for it, or several that differ.
        """
        known = tuple(name for name in self.names if name in captured)
        key = tuple(plain(captured[name]) for name in known)
        by_key = self._shared.get(known)
        if by_key is None:
            by_key = self._shared[known] = self._by(known)
        said = ", ".join(f"{n} {v}" for n, v in zip(known, key, strict=True)) or "every frame"
        if key not in by_key:
            raise CameraError(
                f"{self.where}: expected a row for {said}, found none; "
                "name the columns by the description's placeholders in camera.columns"
            )
        found = by_key[key]
        if found is None:
            others = ", ".join(name for name in self.names if name not in known)
            raise CameraError(
                f"{self.where}: expected one camera for {said}, found several by {others}; "
                "have placeholders of these names in the pattern of rgb"
            )
        return found

    def _by(self, known: tuple[str, ...]) -> Mapping[tuple[str, ...], CameraNumbers | None]:
        places = [self.names.index(name) for name in known]
        made: dict[tuple[str, ...], CameraNumbers | None] = {}
        for key, camera in self.rows.items():
            short = tuple(key[place] for place in places)
            made[short] = camera if made.get(short, camera) == camera else None
        return made


def is_table(text: str) -> bool:
    """Return whether the first line is a table's header that names fx, fy, cx and cy."""
    first = text.lstrip("\ufeff\n ").partition("\n")[0]
    columns = _columns_of(_SEPARATOR.split(first.strip().lower()))
    return {"fx", "fy", "cx", "cy"} <= {*columns}


def table_of(text: str, where: str, columns: tuple[str, ...]) -> CameraTable:
    """Read a table; columns are those given, or its header's.

    Raises
    ------
    CameraError
        A row has another count of columns, no numbers, or is there twice.
    """
    lines = [(n, s.strip()) for n, s in enumerate(text.splitlines(), 1) if s.strip("\ufeff \t")]
    lines = [(n, s) for n, s in lines if not s.startswith("#")]
    header = _SEPARATOR.split(lines[0][1].lstrip("\ufeff")) if lines else []
    titles = tuple(c.strip("{}") for c in columns) if columns else tuple(_columns_of(header))
    if missing := [name for name in ("fx", "fy", "cx", "cy") if name not in titles]:
        raise CameraError(
            f"{where}: expected columns fx, fy, cx and cy, found no {missing[0]}; "
            "name them by the description's camera.columns"
        )
    names = tuple(dict.fromkeys(t for t in titles if t and t not in _NAMES.values()))
    rows: dict[tuple[str, ...], CameraNumbers] = {}
    for place, (line, row) in enumerate(lines):
        words = _SEPARATOR.split(row)
        if place == 0 and not any(number_of(word) == number_of(word) for word in words):
            continue
        key, camera = _row(words, titles, names, f"{where}:{line}")
        if rows.setdefault(key, camera) != camera:
            raise CameraError(
                f"{where}:{line}: expected one row for {' '.join(key)[:80]!r}, found another; "
                "remove one"
            )
    return CameraTable(where, names, rows)


def _columns_of(header: list[str]) -> Iterator[str]:
    for title in header:
        yield _NAMES.get(title.lower(), title)


def _row(
    words: list[str], titles: tuple[str, ...], names: tuple[str, ...], where: str
) -> tuple[tuple[str, ...], CameraNumbers]:
    if len(words) != len(titles):
        raise CameraError(
            f"{where}: expected {len(titles)} columns, found {len(words)}; "
            'name all of them in camera.columns, "" for those to pass over'
        )
    cells = {title: word for title, word in zip(titles, words, strict=True) if title}
    fx, fy, cx, cy = (number_of(cells[name]) for name in ("fx", "fy", "cx", "cy"))
    if fx + fy + cx + cy != fx + fy + cx + cy:
        raise CameraError(
            f"{where}: expected numbers for fx, fy, cx and cy, found {' '.join(words)[:100]!r}; "
            "mend the row"
        )
    camera = CameraNumbers(
        (fx, fy, cx, cy),
        "table",
        size_of(cells.get("width"), cells.get("height")),
        number_of(cells.get("baseline_m")),
        gravity=_gravity(cells, where),
    )
    return tuple(plain(cells[name]) for name in names), camera


def _gravity(cells: Mapping[str, str], where: str) -> tuple[float, ...] | None:
    """Return the direction of gravity in a row; None = the table has no such columns."""
    there = [name for name in _GRAVITY if name in cells]
    if not there:
        return None
    numbers = tuple(number_of(cells.get(name)) for name in _GRAVITY)
    if any(map(math.isnan, numbers)) or not any(numbers):
        raise CameraError(
            f"{where}: expected a direction in {', '.join(_GRAVITY)}, found "
            f"{', '.join(str(cells.get(name)) for name in _GRAVITY)}; give all three, not all 0"
        )
    return numbers


def plain(word: str) -> str:
    """Return a cell, or what a placeholder stands for, with 00012 as 12."""
    return str(int(word)) if word.isascii() and word.isdecimal() and len(word) < 20 else word
