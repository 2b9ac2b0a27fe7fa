"""Which dataset a folder is, by signs of files; or what it lacks to be one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from nimprep.errors import DecodeError, LayoutError
from nimprep.images import read_header
from nimprep.readers.layouts import READERS, Layout, ReaderName
from nimprep.readers.nearby import dataset_above, nearby_dataset
from nimprep.readers.signs import Listings, probed
from nimprep.readers.tree import check_root


class Recognised(NamedTuple):
    """Name the reader of a folder, and the folder that it reads."""

    reader: ReaderName
    root: Path


def recognised(root: Path) -> Recognised:
    """Return the reader whose layout a folder has.

    Files that are there tell; where none do, folders' names, as what lacks files is to be said so
    by the reader.

    Raises
    ------
    LayoutError
        The folder is missing, or has no known layout, or several.
    """
    one = known_file(root)
    if one is not None:
        return one
    check_root(root)
    listings = Listings()
    found = known_by_files(root, listings)
    if found is not None:
        return found
    marked = [n for n, each in READERS.items() if any((root / m).is_dir() for m in each.marks)]
    told = refusal(root, listings)
    # rgb/ alone may be that of a scene, in a dataset of many. To look is not free.
    if (marked or told) and dataset_above(root, lambda each: _is_one(each, listings)) is None:
        if marked:
            return Recognised(marked[0], root)
        raise LayoutError(told)
    entries = sorted(p.name for p in root.iterdir())[:5]
    there = ", ".join(entries) if entries else "an empty folder"
    known = ", ".join(READERS)
    raise LayoutError(
        f"{root}: expected a known layout ({known}), found {there}; {_step(root, listings)}"
    )


def known_file(path: Path) -> Recognised | None:
    """Return the reader of a dataset that is one file, given itself; None = it is no such."""
    if not path.is_file():
        return None
    for name, layout in READERS.items():
        if layout.dataset is not None and layout.dataset.file == path.name:
            return Recognised(name, path.parent)
    return None


def refusal(root: Path, listings: Listings, reader: ReaderName | None = None) -> str | None:
    """Return what is said of a folder that looks like a dataset and cannot be read; None = nothing.

    Parameters
    ----------
    reader : str, optional
        Of this dataset's forms alone.
    """
    for name, layout in READERS.items():
        if layout.dataset is None or reader not in (None, name):
            continue
        for said in layout.dataset.refused:
            if not all(listings.has(root, sign) for sign in said["there"]):
                continue
            if _has_8_bits(listings.find(root, said["eight_bits"])):
                return f"{root}: expected a known layout, found {said['found']}; {said['step']}"
    return None


def _has_8_bits(file: str | None) -> bool:
    try:
        # Colours may be a number's bytes, as CARLA has them.
        header = None if file is None else read_header(Path(file))
        return header is not None and (header.bits, header.channels) == (8, 1)
    except DecodeError:
        return False


def known_by_files(root: Path, listings: Listings) -> Recognised | None:
    """Return the reader whose signs a folder has; None = it has none's.

    Raises
    ------
    LayoutError
        It has the signs of several, of which none is the special case of the others.
    """
    fitting = {
        name: place
        for name, layout in READERS.items()
        if (place := place_of(layout, root, listings)) is not None
    }
    general = {other for name in fitting for other in READERS[name].over}
    left = [name for name in fitting if name not in general]
    if len(left) > 1:
        raise LayoutError(
            f"{root}: expected files of one dataset, found those of {' and '.join(left)}; say "
            f"which is meant with --reader {left[0]}"
        )
    return Recognised(left[0], fitting[left[0]]) if left else None


def _is_one(folder: Path, listings: Listings) -> bool:
    """Return whether a folder has the files of one dataset that is known."""
    try:
        return known_by_files(folder, listings) is not None
    except LayoutError:
        return False


def place_of(layout: Layout, root: Path, listings: Listings) -> Path | None:
    """Return the folder in which a layout's signs are; None = they are not."""
    for inner in layout.roots if layout.signs else ():
        place = root / inner
        if any(listings.has(place, sign) for sign in layout.not_signs):
            continue
        if all(listings.has(place, sign) for sign in layout.signs):
            return place
    return None


def _step(root: Path, listings: Listings) -> str:
    """Return what to do about a folder that is none."""
    near = nearby_dataset(root, lambda folder: known_by_files(folder, listings) is not None)
    if near is not None:
        return f"did you mean {near}?"
    lacking = sorted(_lacking(root, listings), key=lambda each: -each[0])
    if lacking and (len(lacking) == 1 or lacking[0][0] > lacking[1][0]):
        return lacking[0][1]
    return f"nimprep inspect {root} says what it is"


def _lacking(root: Path, listings: Listings) -> Iterator[tuple[int, str]]:
    """Yield the datasets of which a folder has some files, but not all signs: how many, and what.

    Depth or labels alone, as of archives that were unpacked without colour's.
    """
    for name, layout in READERS.items():
        if layout.dataset is None:
            continue
        for inner in layout.roots:
            lost = [sign for sign in layout.signs if not listings.has(root / inner, sign)]
            form = layout.dataset.found(root / inner, listings)
            patterns = [form.pattern(kind) for kind in ("depth", "label")]
            there = sum(listings.has(root / inner, probed(p)) for p in patterns if p is not None)
            if lost and there:
                first = lost[0] if isinstance(lost[0], str) else lost[0][0]
                comes = layout.dataset.document.get("unpack", {}).get("rgb")
                step = f"; unpack {comes} there" if comes else ""
                yield there, f"for {name} it lacks {first!r}{step}"
