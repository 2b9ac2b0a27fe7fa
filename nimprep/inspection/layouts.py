"""Which reader's layout a folder has, and how a dataset known by name is described."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from nimprep.errors import LayoutError, NimprepError
from nimprep.readers import READERS, ReaderName, ReaderOptions, open_reader
from nimprep.readers.named import description_in
from nimprep.readers.nearby import nearby_dataset
from nimprep.readers.recognition import (
    is_meant,
    known_by_files,
    known_file,
    place_of,
    refusal,
)
from nimprep.readers.signs import Listings


def meant_instead(root: Path) -> Path | None:
    """Return the folder near another that is the dataset which is meant; None = there is none."""
    return nearby_dataset(root, lambda folder: is_meant(folder, root, Listings(MOST_FOLDERS)))


def reader_of_names(names: Iterable[str]) -> ReaderName | None:
    """Return the reader whose signs are among the names in an archive, or in a folder of it."""
    listings = Listings.of_names(names)
    for folder in (Path(), *(Path(name) for name in listings.of(".").folders)):
        try:
            known = known_by_files(folder, listings)
        except LayoutError:
            continue
        if known is not None:
            return known.reader
    return None


MOST_FOLDERS = 400
"""So many folders are looked into for a dataset near a folder."""

ANY_CAMERA = (1.0, 1.0, 0.0, 0.0)
"""To count the frames of a dataset that does not say its own."""


def description_of(name: ReaderName, root: Path) -> dict[str, Any] | None:
    """Return the description of a dataset known by name, as it is in a folder; None = has none."""
    layout, listings = READERS[name], Listings()
    root = root.parent if root.is_file() else root
    place = place_of(layout, root, listings) or root
    if layout.dataset is None or not layout.dataset.found(place, listings).described:
        return None
    return description_in(layout.dataset, root, place)


def needs_camera(description: Mapping[str, Any] | None) -> bool:
    """Return whether a dataset does not say its camera, so that the user has to."""
    return description is not None and description.get("camera") is False


def fitting_reader(root: Path, notes: list[str]) -> tuple[ReaderName, int] | None:
    """Return the reader that opens a folder as it is, and its number of frames; None = none.

    A reader's folders alone do not tell: TUM's rgb/ is GMRP's too. What keeps a dataset that is
    known by its files from being opened is added to the notes.
    """
    listings = Listings()
    try:
        known = known_file(root) or known_by_files(root, listings)
    except LayoutError as error:
        notes.append(str(error))
        return None
    if known is None and (told := refusal(root, listings)) is not None:
        notes.append(told)
    for name, layout in READERS.items():
        if known is not None and name != known.reader:
            continue
        if known is None and not any((root / mark).is_dir() for mark in layout.marks):
            continue
        camera = ANY_CAMERA if needs_camera(description_of(name, root)) else None
        for labels in (True, False):
            try:
                options = ReaderOptions(reader=name, camera=camera)
                reader = open_reader(root, options, labels=labels)
                if reader.ids:
                    reader.shape(reader.ids[0])
                    notes += reader.info.notes if layout.dataset else ()
                    return name, len(reader.ids)
            except NimprepError as error:
                if known is not None and labels:
                    notes.append(f"files of {name}, but {error}")
    return None
