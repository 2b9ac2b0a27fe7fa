"""Which files make a frame: patterns are looked for below the dataset's folder, and paired."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from nimprep.errors import DecodeError, LayoutError
from nimprep.files import read_start
from nimprep.images.signatures import NEEDED, unread_format
from nimprep.readers.chosen import chosen_colors, chosen_of
from nimprep.readers.description import CONFIDENCE, Description, PlaneSource
from nimprep.readers.found import Found, by_placeholders, found_images, only
from nimprep.readers.found import Place as Place
from nimprep.readers.pairing import paired
from nimprep.readers.patterns import capture, placeholders
from nimprep.readers.tree import found_files


@dataclass(frozen=True)
class Matched:
    """Hold which files make which frame.

    Attributes
    ----------
    ids : tuple of str
        Every frame, sorted, those that lack something among them.
    places : mapping of kind of image to mapping of frame id to Place
    lacking : mapping of frame id to str
        Why a frame is bad, as a whole message.
    captured : mapping of frame id to mapping of placeholder to str
        What the placeholders stand for in the frame's colour image.
    notes : tuple of str
        One line each: what was passed over, and why.
    """

    ids: tuple[str, ...]
    places: Mapping[str, Mapping[str, Place]]
    lacking: Mapping[str, str] = field(default_factory=dict)
    captured: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def of(self, frame_id: str) -> dict[str, Place]:
        """Return the frame's files by kind of image."""
        return {name: by_id[frame_id] for name, by_id in self.places.items() if frame_id in by_id}


def matched_frames(root: Path, description: Description, wanted: Collection[str]) -> Matched:
    """Find the files of every frame; what one lacks, `nimprep.readers.missing` judges.

    A file whose placeholders say a whole id makes a frame too where that has no colour image.

    Parameters
    ----------
    wanted : collection of str
        Kinds of image that will be read; the others need not be there.

    Raises
    ------
    LayoutError
        A folder is missing or empty, there are no frames, or two files claim to be one.
    """
    template = description.id or "{id}"
    colors = _colors(root, description.rgb, template, description.only)
    captured = {i: found.values for i, found in colors.items()}
    known = next(iter(captured.values()))
    places = {"rgb": {i: found.place for i, found in colors.items()}}
    others = {
        name: chosen_of(_images(root, source, labels=source is description.label), description.only)
        for name, source in description.sources()
        if source is not description.rgb and name in wanted
    }
    pairing = paired(root, description, colors, others)
    notes: list[str] = []
    for name, images in others.items():
        if name in pairing.places:
            places[name] = pairing.places[name]
            continue
        names = [n for n in images[0].values if n in known] if images else []
        places[name] = _joined(images, names, colors)
        notes += _shared(root, name, places[name])
        if set(placeholders(template)) <= set(names):
            for frame_id, found in _alone(images, template, colors).items():
                captured.setdefault(frame_id, found.values)
                places[name][frame_id] = found.place
    ids = tuple(sorted(captured.keys() - pairing.left_out))
    if not ids:
        raise LayoutError(f"{root}: expected frames, found none: {'; '.join(pairing.notes)}")
    return Matched(ids, places, captured=captured, notes=(*pairing.notes, *notes))


def _images(root: Path, source: PlaneSource, *, labels: bool) -> list[Found]:
    """Return every image of another kind than colour."""
    try:
        images = found_images(root, source)
        if not images:
            raise LayoutError(
                f"{root}: expected files {source.files!r}, found none; compare the pattern with "
                "the names there"
            )
    except LayoutError as error:
        if source.missing == "none":
            return []
        if labels:
            raise LayoutError(f"{error}; use --no-labels to convert without") from error
        raise
    return images


def _colors(
    root: Path, source: PlaneSource, template: str, wanted: Mapping[str, Sequence[str]]
) -> dict[str, Found]:
    """Return the colour image of every frame that has one, by id."""
    images = found_images(root, source)
    if not images:
        raise LayoutError(
            f"{root}: expected rgb files {source.files!r}, found none; compare the pattern with "
            "the names there"
        )
    images = chosen_colors(root, images, wanted)
    known = images[0].values
    if lost := [name for name in placeholders(template) if name not in known]:
        _refuse_unread(images[0].place.path)
        raise LayoutError(
            f"{root}: expected an id {template!r} of the placeholders of rgb's files "
            f'{source.files!r}, found no {{{lost[0]}}} there; say it in "id" with those there are'
        )
    by_id: dict[str, list[Found]] = {}
    for found in images:
        by_id.setdefault(formatted(template, found.values), []).append(found)
    for frame_id, same in by_id.items():
        only([found.place for found in same], frame_id)
    return {i: same[0] for i, same in by_id.items()}


def _refuse_unread(path: Path) -> None:
    """Raise `LayoutError` where a file that was to be all frames is of a format not read."""
    try:
        known = unread_format(read_start(path, NEEDED))
    except DecodeError:
        return
    if known is not None:
        raise LayoutError(f"{path}: expected images, found {known[0]}; {known[1]}")


def _joined(
    images: Sequence[Found], names: Sequence[str], colors: Mapping[str, Found]
) -> dict[str, Place]:
    """Return each frame's image: that whose placeholders stand for what its colour's do."""
    places = by_placeholders(images, names)
    keys = {i: tuple(found.values[name] for name in names) for i, found in colors.items()}
    return {i: only(places[key], i) for i, key in keys.items() if key in places}


def _shared(root: Path, name: str, places: Mapping[str, Place]) -> Iterator[str]:
    """Yield what is said of an image that several frames have, as they may have lost theirs."""
    several = [place for place, n in Counter(places.values()).items() if n > 1]
    if several and name != CONFIDENCE:
        first = several[0].path.relative_to(root).as_posix()
        those = sum(place in several for place in places.values())
        yield (
            f"{those} frames share {len(several)} file{'s' * (len(several) > 1)} of {name}, first "
            f"{first}; if each has its own, its pattern needs the placeholders of rgb's"
        )


def _alone(images: Sequence[Found], template: str, colors: Mapping[str, Found]) -> dict[str, Found]:
    """Return the images, by id, of frames that have no colour image."""
    alone: dict[str, Found] = {}
    for found in images:
        frame_id = formatted(template, found.values)
        if frame_id in colors:
            continue
        if frame_id in alone:
            only([alone[frame_id].place, found.place], frame_id)
        alone[frame_id] = found
    return alone


def files_by_id(root: Path, pattern: str) -> dict[str, Path]:
    """Return {frame id: file} for a pattern with ``{id}``.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, its folder is missing, or two files give one id.
    """
    if pattern.count("{id}") != 1:
        raise LayoutError(f"{root}: expected a pattern with one {{id}}, found {pattern!r}")
    found = by_placeholders(found_images(root, PlaneSource(files=pattern)), ("id",))
    return {key[0]: only(places, key[0]).path for key, places in found.items()}


def files_for(
    root: Path, pattern: str, captured: Mapping[str, Mapping[str, str]]
) -> dict[str, Place]:
    """Return each frame's file: that whose placeholders stand for what the frame's do.

    Parameters
    ----------
    pattern : str
        Of its placeholders those count that every frame has. With fewer than frames have, these
        share a file: the camera of a scene; with none of them, all do.
    captured : mapping of frame id to mapping of placeholder to str
        As `Matched.captured`.

    Returns
    -------
    dict of frame id to Place
        Frames without such a file are not in it.

    Raises
    ------
    LayoutError
        The pattern leaves the folder, its folder is missing, or a frame has two such files.
    """
    names = [n for n in placeholders(pattern) if all(n in values for values in captured.values())]
    every = {i: Found(values, Place(root)) for i, values in captured.items()}
    images = list(found_files(root, pattern))
    return _joined([Found(values, Place(path)) for path, values in images], names, every)


def formatted(template: str, values: Mapping[str, str]) -> str:
    """Return a template with what its placeholders stand for."""
    return re.sub(r"\{(\w+)\}", lambda found: values[found[1]], template)


def check_group(root: Path, description: Description, matched: Matched) -> None:
    """Raise `LayoutError` where groups are of placeholders that rgb's files have not."""
    group = description.group
    if group is None or "{group}" in group:
        return
    known = matched.captured[next(iter(matched.places["rgb"]))]
    if lost := [name for name in placeholders(group) if name not in known]:
        raise LayoutError(
            f"{root}: expected a group {group!r} of the placeholders of rgb's files "
            f"{description.rgb.files!r}, found no {{{lost[0]}}} there; name it in their pattern"
        )


def group_of(frame_id: str, pattern: str | None) -> str:
    """Return the scene in a frame id by a pattern with ``{group}``; "" where it does not fit."""
    return "" if pattern is None else capture(pattern, frame_id, "group", lazy=True) or ""
