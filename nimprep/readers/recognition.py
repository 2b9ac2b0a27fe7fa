"""Which dataset a folder is, by signs of files; or what it lacks to be one."""

from __future__ import annotations

import os
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
    if (marked or told) and dataset_above(root, lambda f: is_meant(f, root, listings)) is None:
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
        It has the signs of several, of which none is the special case of the others; or one of
        another beside sequences.
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
    if not left:
        return None
    found = Recognised(left[0], fitting[left[0]])
    _check_sequences(found, listings)
    return found


def is_meant(folder: Path, root: Path, listings: Listings) -> bool:
    """Return whether a folder within or above another is a dataset, of which the other is a part.

    One above that merely lies there, as of another dataset beside, is not meant.
    """
    try:
        found = known_by_files(folder, listings)
    except LayoutError:
        return False
    return found is not None and _is_part(found, root, listings)


def _is_part(found: Recognised, root: Path, listings: Listings) -> bool:
    """Return whether files that a dataset is known by, or made of, lie in a folder.

    A folder that is not below the dataset's is one above it: it has them.
    """
    top = Path(os.path.abspath(found.root))  # noqa: PTH100 - "." has no parts
    below = Path(os.path.abspath(root))  # noqa: PTH100
    if not below.is_relative_to(top) or below == top:
        return True
    parts = below.relative_to(top).parts
    layout = READERS[found.reader]
    if layout.each and not _has_signs(layout, top, listings):
        return _has_signs(layout, top / parts[0], listings)
    signs = [each for sign in layout.signs for each in ([sign] if isinstance(sign, str) else sign)]
    signs += layout.parts
    if layout.dataset is not None:
        form = layout.dataset.found(top, listings)
        kinds = ("rgb", "depth", "label", "camera")
        signs += [probed(p) for kind in kinds if (p := form.pattern(kind)) is not None]
    return any(listings.leads_through(str(top), sign, parts) for sign in signs)


def place_of(layout: Layout, root: Path, listings: Listings) -> Path | None:
    """Return the folder in which a layout's signs are; None = they are not."""
    for inner in layout.roots if layout.signs else ():
        place = root / inner
        if _has_signs(layout, place, listings):
            return place
        if layout.each and next(_sequences(layout, place, listings), None) is not None:
            return place
    return None


def _has_signs(layout: Layout, place: Path, listings: Listings) -> bool:
    if any(listings.has(place, sign) for sign in layout.not_signs):
        return False
    return all(listings.has(place, sign) for sign in layout.signs)


def _sequences(layout: Layout, place: Path, listings: Listings) -> Iterator[Path]:
    """Yield the folders in a folder that have a layout's signs, each all of them."""
    folders = (place / name for name in listings.of(str(place)).folders)
    return (folder for folder in folders if _has_signs(layout, folder, listings))


def _check_sequences(found: Recognised, listings: Listings) -> None:
    """Raise `LayoutError` where other datasets lie beside the sequences that a folder is known by.

    Their frames would be missing without a word.
    """
    layout = READERS[found.reader]
    if not layout.each or _has_signs(layout, found.root, listings):
        return
    for name in listings.of(str(found.root)).folders:
        folder = found.root / name
        try:
            other = known_by_files(folder, listings)
        except LayoutError:
            other = None
        if other is not None and other.reader != found.reader:
            raise LayoutError(
                f"{found.root}: expected files of one dataset, found those of {found.reader} and, "
                f"in {name}, of {other.reader}; give the folder of one, or --reader {found.reader}"
            )


def _step(root: Path, listings: Listings) -> str:
    """Return what to do about a folder that is none."""
    near = nearby_dataset(root, lambda folder: is_meant(folder, root, listings))
    if near is not None:
        return f"did you mean {near}?"
    lacking = sorted(_lacking(root, listings), key=lambda each: -each[0])
    if lacking and (len(lacking) == 1 or lacking[0][0] > lacking[1][0]):
        return lacking[0][1]
    return f"nimprep inspect {root} says what it is"


def _lacking(root: Path, listings: Listings) -> Iterator[tuple[int, str]]:
    """Yield the datasets of which a folder has some files, but not all signs: how many, and what.

    Depth or labels alone, as of archives that were unpacked without colour's. What colour's files
    are, and of its other signs one must be there: depth/ alone is anybody's.
    """
    for name, layout in READERS.items():
        if layout.dataset is None:
            continue
        for inner in layout.roots:
            lost = [sign for sign in layout.signs if not listings.has(root / inner, sign)]
            form = layout.dataset.found(root / inner, listings)
            patterns = [form.pattern(kind) for kind in ("depth", "label")]
            there = sum(listings.has(root / inner, probed(p)) for p in patterns if p is not None)
            if lost[:1] == [*layout.signs[:1]] and len(lost) == 1 and there:
                first = lost[0] if isinstance(lost[0], str) else lost[0][0]
                comes = layout.dataset.document.get("unpack", {}).get("rgb")
                step = f"; unpack {comes} there" if comes else ""
                yield there, f"for {name} it lacks {first!r}{step}"
