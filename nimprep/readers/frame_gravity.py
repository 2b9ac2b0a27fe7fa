"""The direction of gravity of each frame of a described dataset: one for all, or a row for each."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.camera import unit_gravity
from nimprep.errors import LayoutError
from nimprep.readers.camera_formats.numbers import number_of
from nimprep.readers.camera_formats.rows import plain
from nimprep.readers.description import Description, GravitySource
from nimprep.readers.matching import Matched, files_for
from nimprep.readers.nearest import exact, time_from
from nimprep.readers.pairing import listed_times, text_of
from nimprep.readers.patterns import placeholders

Gravity = npt.NDArray[np.float64]
Key = tuple[str, ...]

_QUATERNION = ("qx", "qy", "qz", "qw")
_VECTOR = ("x", "y", "z")
_OFF_UNIT = 0.05


@dataclass(frozen=True)
class GravityList:
    """Hold the rows of a list, by what tells them beside the time.

    Attributes
    ----------
    names : tuple of str
        The columns that do: placeholders.
    rows : mapping of what these hold to rows of (time, direction), in order of time
        Without times, each is 0.
    """

    names: tuple[str, ...]
    rows: Mapping[Key, Sequence[tuple[Fraction, Gravity]]]

    def nearest(self, key: Key, time: Fraction, tolerance: Fraction) -> Gravity | None:
        """Return the direction of the row that is nearest in time; None = none is so near."""
        rows = self.rows.get(key, ())
        place = bisect_left(rows, time, key=lambda row: row[0])
        near = rows[max(place - 1, 0) : place + 1]
        found = min(near, key=lambda row: abs(row[0] - time), default=None)
        return found[1] if found is not None and abs(found[0] - time) <= tolerance else None


class FrameGravity:
    """Give the direction of gravity of each frame.

    Parameters
    ----------
    root : Path
        The dataset's folder.
    description : Description
    matched : Matched
        The frames.
    given : (3,), optional
        Of all frames, in place of what the description says.

    Attributes
    ----------
    notes : tuple of str
        What is to be said.

    Raises
    ------
    LayoutError
        A list is missing or is none, nothing says when frames were taken, or no frame has a row.
    """

    def __init__(
        self,
        root: Path,
        description: Description,
        matched: Matched,
        given: Sequence[float] | None = None,
    ) -> None:
        source = description.gravity if given is None else tuple(given)
        self._same = None if isinstance(source, GravitySource) or not source else source
        self._of_frame: dict[str, Gravity] = {}
        self._files: Mapping[str, Path] = {}
        self.notes: tuple[str, ...] = ()
        if isinstance(source, GravitySource):
            self._join(root, description, source, matched)

    def of(self, frame_id: str, camera: Sequence[float] | None) -> Gravity | None:
        """Return a frame's direction, (3,); None = it has none.

        Parameters
        ----------
        camera : (3,), optional
            What its camera's file says, where nothing else is said of the frame.
        """
        if self._same is not None:
            return unit_gravity(self._same)
        if frame_id in self._of_frame:
            return self._of_frame[frame_id]
        return None if camera is None else unit_gravity(camera)

    def sources(self, frame_id: str) -> tuple[Path, ...]:
        """Return the file that says it."""
        return (self._files[frame_id],) if frame_id in self._files else ()

    def _join(
        self, root: Path, description: Description, source: GravitySource, matched: Matched
    ) -> None:
        places = files_for(root, source.files, matched.captured)
        self._files = {i: place.path for i, place in places.items() if i in matched.ids}
        lists = {path: _read(path, source) for path in dict.fromkeys(self._files.values())}
        times = _FrameTimes(root, description, source, matched)
        tolerance = exact(source.tolerance_s)
        for frame_id, path in self._files.items():
            found = lists[path]
            captured = matched.captured[frame_id]
            if lost := [name for name in found.names if name not in captured]:
                raise LayoutError(
                    f"{path}: expected columns of rgb's placeholders, found {lost[0]!r}; name "
                    'others "" in gravity\'s columns'
                )
            key = tuple(plain(captured[name]) for name in found.names)
            time = times.of(frame_id) if times.needed else Fraction(0)
            nearest = None if time is None else found.nearest(key, time, tolerance)
            if nearest is not None:
                self._of_frame[frame_id] = nearest
        lost = [i for i in matched.ids if i not in self._of_frame]
        within = f" within {source.tolerance_s:g} s" if times.needed else ""
        if lost and len(lost) == len(matched.ids):
            raise LayoutError(
                f"{root}: expected gravity of frames in {source.files!r}, found none of any"
                f"{within}; compare its rows with the frames' names, unit_s and tolerance_s"
            )
        if lost:
            self.notes = (
                f"{len(lost)} of {len(matched.ids)} frames have no gravity{within} in "
                f"{source.files!r}, first {min(lost)!r}: theirs is the camera's or is estimated",
            )


class _FrameTimes:
    """When frames were taken, seconds."""

    def __init__(
        self, root: Path, description: Description, source: GravitySource, matched: Matched
    ) -> None:
        self._root, self._match = root, description.match
        self._matched, self._source = matched, source
        self.needed = "time" in source.columns
        by = source.by or (None if self._match is None else self._match.by)
        self._by = None if by is None else by[1:-1]
        listed = self._match is not None and "rgb" in self._match.lists
        if self.needed and self._by is None and not listed:
            raise LayoutError(
                f"{root}: expected what says when frames were taken beside gravity's times, found "
                'nothing; give "by", the placeholder of rgb\'s files that is a time stamp'
            )
        known = placeholders(description.rgb.files)
        if self.needed and self._by is not None and self._by not in known:
            raise LayoutError(
                f"{root}: expected a placeholder of rgb's files as gravity's time, found "
                f"{self._by!r}; name one of {', '.join(known) or 'them'}"
            )

    @cached_property
    def _unit_s(self) -> Fraction:
        match = self._match
        return exact(self._source.unit_s if match is None else match.unit_s)

    @cached_property
    def _listed(self) -> Mapping[str, Fraction]:
        lists = {} if self._match is None else self._match.lists
        found, _ = listed_times(self._root, lists["rgb"])
        return {path: time for path, (_, time) in found.items()}

    def of(self, frame_id: str) -> Fraction | None:
        """Return a frame's time; None = it has no time stamp."""
        place = self._matched.places["rgb"].get(frame_id)
        if self._by is not None:
            said = self._matched.captured[frame_id].get(self._by)
            time = None if said is None else time_from(said)
            if said is not None and time is None:
                raise LayoutError(
                    f"{self._root}: frame {frame_id!r}: expected a time stamp in place of "
                    f'{{{self._by}}}, found {said!r}; name another placeholder as gravity\'s "by"'
                )
        else:
            path = None if place is None else place.path.relative_to(self._root).as_posix()
            time = None if path is None else self._listed.get(path)
        return None if time is None else time * self._unit_s


def _read(path: Path, source: GravitySource) -> GravityList:
    """Read a list.

    Raises
    ------
    LayoutError
        A row has too few columns, no direction, no time, or is there twice.
    """
    numbers = {*_VECTOR, *_QUATERNION, "time", ""}
    titles = source.columns
    names = tuple(dict.fromkeys(title for title in titles if title not in numbers))
    rows: dict[Key, list[tuple[Fraction, Gravity]]] = {}
    for line, words in _rows(path):
        where = f"{path}:{line}"
        if len(words) < len(titles):
            raise LayoutError(
                f"{where}: expected {len(titles)} columns, found {' '.join(words)[:80]!r}; say in "
                'gravity\'s "columns" what there is'
            )
        cells = dict(zip(titles, words, strict=False))
        time = time_from(cells["time"]) if "time" in cells else Fraction(0)
        if time is None:
            raise LayoutError(
                f"{where}: expected a time, found {cells['time'][:40]!r}; mend the row"
            )
        key = tuple(plain(cells[name]) for name in names)
        row = time * exact(source.unit_s), _direction(cells, source, where)
        if "time" not in cells and key in rows and not np.array_equal(rows[key][0][1], row[1]):
            raise LayoutError(
                f"{where}: expected one row for {' '.join(key)[:80]!r}, found another; remove one"
            )
        rows.setdefault(key, []).append(row)
    names = tuple(name.strip("{}") for name in names)
    return GravityList(names, {k: sorted(v, key=lambda row: row[0]) for k, v in rows.items()})


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the columns of each line that is no comment, without a header of names alone."""
    first = True
    for line, text in enumerate(text_of(path), 1):
        stripped = text.strip()
        if not stripped or stripped.startswith("#"):
            continue
        words = [word.strip() for word in stripped.replace(";", ",").replace("\t", ",").split(",")]
        if len(words) == 1:
            words = stripped.split()
        if not (first and all(np.isnan(number_of(word)) for word in words)):
            yield line, words
        first = False


def _direction(cells: Mapping[str, str], source: GravitySource, where: str) -> Gravity:
    """Return the direction of gravity that a row says, in the camera's frame."""
    rotation = source.down is not None
    wanted = _QUATERNION if rotation else _VECTOR
    numbers = np.array([number_of(cells[name]) for name in wanted])
    length = float(np.linalg.norm(numbers))
    if not (abs(length - 1) <= _OFF_UNIT if rotation else 0 < length < np.inf):
        what = "a unit quaternion" if rotation else "a direction"
        raise LayoutError(
            f"{where}: expected {what} in {', '.join(wanted)}, found "
            f"{' '.join(cells[name] for name in wanted)[:80]!r}; mend the row, or its columns"
        )
    if not rotation:
        vector = numbers / length * (-1 if source.values == "acceleration" else 1)
    else:
        matrix = _matrix(numbers / length)
        matrix = matrix.T if source.values == "camera_to_world" else matrix
        vector = matrix @ np.array(source.down, np.float64)
    if source.sensor_to_camera is not None:
        vector = np.array(source.sensor_to_camera) @ vector
    return unit_gravity(vector)


def _matrix(quaternion: Gravity) -> npt.NDArray[np.float64]:
    """Return the rotation of a unit quaternion (x, y, z, w)."""
    x, y, z, w = quaternion.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
