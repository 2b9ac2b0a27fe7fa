"""Files that share no name, paired by time or by a list of pairs."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.files import read_file
from nimprep.readers.description import CONFIDENCE, Description, Match
from nimprep.readers.found import Found, Place
from nimprep.readers.nearest import exact, nearest_pairs, rows_of, time_from
from nimprep.readers.split_lists import FrameNames
from nimprep.readers.tree import found_files

MAX_BYTES = 1 << 28
"""A list of more bytes is no list."""


@dataclass
class Pairing:
    """Hold which files of other kinds belong to which colour image.

    Attributes
    ----------
    places : dict of kind of image to dict of frame id to Place
        Of the kinds that are paired so.
    left_out : set of frame id
        Those whose colour image has no partner.
    notes : list of str
    """

    places: dict[str, dict[str, Place]] = field(default_factory=dict)
    left_out: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def paired(
    root: Path,
    description: Description,
    colors: Mapping[str, Found],
    others: Mapping[str, list[Found]],
) -> Pairing:
    """Pair colour images with the files of other kinds, as far as the description says how.

    Parameters
    ----------
    colors : mapping of frame id to Found
    others : mapping of kind of image to its files

    Raises
    ------
    LayoutError
        A list is missing or is none, or a time stamp is no number.
    """
    match, made = description.match, Pairing()
    if match is None:
        return made
    _check_names(root, description, match)
    if match.pairs is not None:
        _by_pairs(root, match, colors, others, made)
    optional = {name for name, source in description.sources() if source.missing == "none"}
    timed = _times(root, match, "rgb", colors.values(), made.notes)
    for name, images in others.items():
        if name in made.places or not _is_timed(match, name, images):
            continue
        joined = _by_time(match, colors, timed, _times(root, match, name, images, made.notes))
        made.places[name] = joined
        lost = colors.keys() - joined.keys()
        if lost and name not in optional:
            made.left_out |= lost
            made.notes.append(
                f"{len(lost)} of {len(colors)} colour images have no {name} within "
                f"{match.tolerance_s:g} s, first {min(lost)!r}: they are left out; 'tolerance_s' "
                "and 'unit_s' of 'match' say how near"
            )
    return made


def _check_names(root: Path, description: Description, match: Match) -> None:
    """Raise `LayoutError` where lists or columns are of no kind of image that is described."""
    known = [name for name, _ in description.sources() if name != CONFIDENCE]
    for called in (*match.lists, *filter(None, match.columns)):
        if called not in known:
            raise LayoutError(
                f'{root}: expected {", ".join(known)} as lists or columns in "match", found '
                f"{called!r}; describe it, or leave it out"
            )


def _is_timed(match: Match, name: str, images: list[Found]) -> bool:
    if name in match.lists:
        return True
    return match.by is not None and any(match.by[1:-1] in found.values for found in images)


Timed = tuple[tuple[tuple[str, str], ...], Fraction, Place]
"""What else must be the same, when, and which image."""


def _times(
    root: Path, match: Match, name: str, images: Collection[Found], notes: list[str]
) -> list[Timed]:
    """Return when each image of a kind was taken, by its list or its name."""
    by = (match.by or "")[1:-1]
    listed = None
    if name in match.lists:
        there = {image.place.path.relative_to(root).as_posix() for image in images}
        listed, lost = listed_times(root, match.lists[name], there)
        if lost:
            notes.append(
                f"{len(lost)} images that lists of {name} name are not there, first {lost[0]}"
            )
    found: list[Timed] = []
    for image in images:
        path = image.place.path.relative_to(root).as_posix()
        if listed is not None:
            if path in listed:
                found.append((*listed[path], image.place))
            continue
        if by not in image.values:
            continue
        time = time_from(image.values[by])
        if time is None:
            raise LayoutError(
                f"{image.place.path}: expected a time stamp in place of {match.by}, found "
                f"{image.values[by]!r}; put what is none into other placeholders or stars"
            )
        rest = tuple(sorted((k, v) for k, v in image.values.items() if k not in (by, "id")))
        found.append((rest, time, image.place))
    return found


def listed_times(
    root: Path, pattern: str, there: Set[str] = frozenset()
) -> tuple[dict[str, tuple[tuple[tuple[str, str], ...], Fraction]], list[str]]:
    """Return the time of each file in TUM's lists, and what their own placeholders stand for.

    Then the paths in them of which there is no image.
    """
    lost: list[str] = []
    times: dict[str, tuple[tuple[tuple[str, str], ...], Fraction]] = {}
    lists = [(path, values) for path, values in found_files(root, pattern) if path.is_file()]
    if not lists:
        raise LayoutError(
            f"{root}: expected a list of times like {pattern!r}, found none; put it there, or "
            "mend the pattern"
        )
    for path, values in lists:
        for row in rows_of(text_of(path)):
            time = time_from(row[0])
            if time is None or len(row) < 2:
                raise LayoutError(
                    f"{path}: expected lines of a time and a path, found {' '.join(row)[:80]!r}; "
                    "mend it"
                )
            places = [base / row[1] for base in (path.parent, root)]
            names = [p.relative_to(root).as_posix() for p in places if p.is_relative_to(root)]
            for name in names:
                times.setdefault(name, (tuple(sorted(values.items())), time))
            if there.isdisjoint(names):
                lost.append(row[1])
    return times, lost


def _by_time(
    match: Match, colors: Mapping[str, Found], first: list[Timed], second: list[Timed]
) -> dict[str, Place]:
    """Return the image of a kind that is nearest to each colour image."""
    frames = {found.place: i for i, found in colors.items()}
    tolerance = exact(match.tolerance_s) / exact(match.unit_s)
    joined: dict[str, Place] = {}
    names = {k for rest, _, _ in first[:1] for k, _ in rest}
    names &= {k for rest, _, _ in second[:1] for k, _ in rest}

    def grouped(timed: list[Timed]) -> dict[object, list[tuple[Fraction, Place]]]:
        groups: dict[object, list[tuple[Fraction, Place]]] = {}
        for rest, time, place in timed:
            key = tuple(pair for pair in rest if pair[0] in names)
            groups.setdefault(key, []).append((time, place))
        return groups

    there = grouped(second)
    for key, ours in grouped(first).items():
        theirs = there.get(key, [])
        pairs = nearest_pairs([t for t, _ in ours], [t for t, _ in theirs], tolerance)
        joined |= {frames[ours[a][1]]: theirs[b][1] for a, b in pairs.items()}
    return joined


def _by_pairs(
    root: Path,
    match: Match,
    colors: Mapping[str, Found],
    others: Mapping[str, list[Found]],
    made: Pairing,
) -> None:
    """Pair as a list of pairs says."""
    kinds = [name for name in match.columns if name in others]
    if "rgb" not in match.columns:
        raise LayoutError(
            f'{root}: expected "rgb" among the columns of the pairs {match.pairs!r}, found '
            f'{list(match.columns)}; say in "columns" what each holds, "" for what is passed over'
        )
    names = {"rgb": _names(root, {i: found.place for i, found in colors.items()})}
    images = {kind: {str(n): f.place for n, f in enumerate(others[kind])} for kind in kinds}
    names |= {kind: _names(root, images[kind]) for kind in kinds}
    made.places = {kind: {} for kind in kinds}
    unknown, there = 0, set()
    for path, _ in found_files(root, match.pairs or ""):
        for row in rows_of(text_of(path)):
            if len(row) < len(match.columns):
                raise LayoutError(
                    f"{path}: expected {len(match.columns)} columns, found {' '.join(row)[:80]!r}; "
                    'say in "columns" what there is'
                )
            said = dict(zip(match.columns, row, strict=False))
            folder = path.parent.relative_to(root).as_posix()
            frame_id = _named(names["rgb"], folder, said["rgb"])
            if frame_id is None:
                unknown += 1
                continue
            there.add(frame_id)
            for kind in kinds:
                number = _named(names[kind], folder, said[kind])
                if number is None:
                    continue
                place = images[kind][number]
                if made.places[kind].setdefault(frame_id, place) != place:
                    raise LayoutError(
                        f"{path}: expected one pair per colour image, found {said['rgb']!r} with "
                        f"{place.path.name} and {made.places[kind][frame_id].path.name}; take one "
                        "out"
                    )
    if unknown:
        made.notes.append(f"{unknown} pairs of {match.pairs} name no colour image")
    if lost := colors.keys() - there:
        made.left_out |= lost
        made.notes.append(
            f"{len(lost)} of {len(colors)} colour images are in no pair of {match.pairs}, first "
            f"{min(lost)!r}: they are left out"
        )


def _named(names: FrameNames, folder: str, said: str) -> str | None:
    """Return what a list names, whose paths begin at its own folder or at the dataset's."""
    return names.find(f"{folder}/{said}") or names.find(said)


def _names(root: Path, places: Mapping[str, Place]) -> FrameNames:
    return FrameNames({i: [p.path.relative_to(root).as_posix()] for i, p in places.items()})


def text_of(path: Path) -> list[str]:
    """Return the lines of a list.

    Raises
    ------
    LayoutError
        It cannot be read.
    """
    data = read_file(path, MAX_BYTES, "a readable list", LayoutError)
    return data.decode("utf-8-sig", "replace").splitlines()
