"""Folders as networks' own loaders read them: what goes where, by split, and what must be there."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import StoreError
from nimprep.export.encoding import FILE, describe_encoding, encode_image, folder_of
from nimprep.export.made import Images, can_be_made
from nimprep.export.places import flat_names, write_new
from nimprep.folders import whole_folder
from nimprep.frame import IGNORE_LABEL
from nimprep.kitti.images import png_bytes
from nimprep.modality import MODALITIES, Modality
from nimprep.parallel import Progress, map_frames
from nimprep.schema import json_bytes
from nimprep.splits import SPLIT_CODES, SPLIT_NAMES
from nimprep.store.reader import Store

SPLITS = tuple(name for name in SPLIT_CODES if name != "none")

Image = npt.NDArray[Any]


@dataclass(frozen=True)
class Folder:
    """Say where a modality's images go, and as what.

    Attributes
    ----------
    path : str
        Below OUT; "{split}" stands for the split's name.
    encode : callable
        Makes the file's bytes of an image as a `Frame` has it.
    entry : mapping
        What its entry in encodings.json says otherwise than the modality itself.
    stored : bool
        `encode` takes the integers of the store instead.
    suffix : str
    """

    path: str
    encode: Callable[[Image], bytes]
    entry: Mapping[str, Any] = field(default_factory=dict)
    stored: bool = False
    suffix: str = ".png"


@dataclass(frozen=True)
class Job:
    """Hold what is exported.

    Attributes
    ----------
    store : Store
    splits : dict of split to indices
        Every split, in the store's order.
    names : dict of index to str
        The files' names, without ending.
    modalities : tuple of str
    notes : list of str
        What is said once all is written.
    """

    store: Store
    splits: Mapping[str, Sequence[int]]
    names: Mapping[int, str]
    modalities: tuple[str, ...]
    notes: list[str]

    @property
    def frames(self) -> list[tuple[int, str]]:
        """Each frame's index and split, in the store's order."""
        return sorted((i, split) for split, indices in self.splits.items() for i in indices)


@dataclass(frozen=True)
class Layout:
    """Describe a layout.

    Attributes
    ----------
    form : str
        Its name in `--format`.
    needs : tuple of tuple of str
        Of each, at least one modality must be there; all that are, are written.
    folders : callable
        Gives the folder of each modality of a job, but of those that are in the lists alone.
    others : tuple of str, optional
        What else can be asked for; None = all that a store has.
    finish : callable
        Writes the lists once the images are there; what it gets of each frame is what `look` gave.
    look : callable, optional
        Called with each frame's label.
    splits : mapping
        What the layout calls each split.
    """

    form: str
    needs: tuple[tuple[str, ...], ...]
    folders: Callable[[Job, Progress | None], Mapping[str, Folder]]
    finish: Callable[[Path, Job, Sequence[Any]], None]
    others: tuple[str, ...] | None = ()
    look: Callable[[Image], Any] | None = None
    splits: Mapping[str, str] = field(default_factory=lambda: {name: name for name in SPLITS})


def export_layout(
    layout: Layout,
    store: Store,
    numbers: Sequence[int],
    out: Path,
    chosen: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> list[str]:
    """Write frames in a layout, whole or not at all; return the ids of those written.

    Raises
    ------
    StoreError
        A modality is neither in the store nor can be made, or no frame has a split.
    LayoutError
        `out` cannot be written, or a frame's id can be no file name.
    """
    job = _job(layout, store, numbers, chosen)
    folders = layout.folders(job, progress)
    images = Images(store, job.modalities)
    labelled = "label" in job.modalities

    def write(folder: Path, index: int, split: str) -> tuple[Any, bool]:
        shown = images.of(index)
        for name, to in folders.items():
            place = folder / to.path.format(split=layout.splits[split])
            image = shown.integers(name) if to.stored else shown.image(name)
            write_new(place / (job.names[index] + to.suffix), to.encode(image))
        if not labelled:
            return None, True
        label = shown.image("label")
        seen = layout.look(label) if layout.look else None
        return seen, bool((label != IGNORE_LABEL).any())

    with whole_folder(out, Path(store.path)) as partial:
        for to in folders.values():
            for split in layout.splits.values():
                (partial / to.path.format(split=split)).mkdir(parents=True, exist_ok=True)
        done = list(
            map_frames("export", lambda frame: write(partial, *frame), job.frames, progress)
        )
        layout.finish(partial, job, [seen for seen, _ in done])
        _write_encodings(partial, job, folders)
    if bare := sum(not any_class for _, any_class in done):
        job.notes.append(f"{bare} of {len(done)} frames have no pixel of a class in their labels")
    for note in job.notes:
        warnings.warn(f"{out}: {note}", stacklevel=3)
    return [store.ids[i] for i, _ in job.frames]


def _job(layout: Layout, store: Store, numbers: Sequence[int], chosen: Sequence[str] | None) -> Job:
    there = tuple(name for name in (*MODALITIES, *store.modalities) if can_be_made(store, name))
    wanted = (
        _needed(layout, store, there) if chosen is None else _asked(layout, store, there, chosen)
    )
    modalities = tuple(name for name in dict.fromkeys(there) if name in wanted)
    codes = {i: SPLIT_NAMES.get(int(store.tables.split[i]), "none") for i in numbers}
    splits = {split: [i for i in numbers if codes[i] == split] for split in SPLITS}
    notes = []
    left = sum(code not in splits for code in codes.values())
    if left == len(numbers):
        raise StoreError(
            f"{store.path}: expected frames of a split for --format {layout.form}, found {left} "
            "of none; split the store with nimprep split, or choose other --frames"
        )
    if left:
        notes.append(f"{left} of {len(numbers)} frames have no split and are left out")
    if made := [name for name in modalities if name not in store.modalities]:
        notes.append(
            f"{', '.join(made)}: not in the store, made from its depth as convert does by default"
        )
    taken = [i for i in numbers if codes[i] in splits]
    names = flat_names([store.ids[i] for i in taken], ".png")
    return Job(store, splits, {i: names[store.ids[i]] for i in taken}, modalities, notes)


def _needed(layout: Layout, store: Store, there: Sequence[str]) -> set[str]:
    """Return what the layout has by itself.

    Raises
    ------
    StoreError
        There is nothing of something that it needs.
    """
    for kinds in layout.needs:
        if not set(kinds) & set(there):
            raise StoreError(
                f"{store.path}: expected {' or '.join(kinds)} for --format {layout.form}, found "
                f"{', '.join(store.modalities)}; convert with it, or name what to write of those "
                "with --modalities"
            )
    return {name for kinds in layout.needs for name in kinds if name in there}


def _asked(layout: Layout, store: Store, there: Sequence[str], chosen: Sequence[str]) -> set[str]:
    """Return what was asked for by name.

    Raises
    ------
    StoreError
        The layout has no place for it, or it is not there.
    """
    places = [name for kinds in layout.needs for name in kinds]
    places = [*there] if layout.others is None else [*places, *layout.others]
    for name in chosen or [""]:
        if name not in there or name not in places:
            known = [place for place in dict.fromkeys(places) if place in there]
            raise StoreError(
                f"{store.path}: expected modalities of {', '.join(known)} for --format "
                f"{layout.form}, found {name!r}; leave it out, or convert with it"
            )
    return set(chosen)


def as_png(entry: Mapping[str, Any], path: str, numbers: Callable[[Image], Image]) -> Folder:
    """Return a folder of PNGs of these numbers."""
    return Folder(path, lambda image: png_bytes(np.ascontiguousarray(numbers(image))), entry)


def unchanged(image: Image) -> Image:
    """Return an image as it is."""
    return image


def as_stored(modality: Modality, path: str | None = None) -> Folder:
    """Return a folder of PNGs that say exactly what the store does, as with `--format png`."""

    def encode(image: Image) -> bytes:
        return png_bytes(np.ascontiguousarray(encode_image(image, modality)))

    return Folder(path or folder_of(modality), encode, stored=True)


def write_classes(folder: Path, job: Job) -> None:
    """Write classes.txt: the name of each class a line, that of id 0 first; "-" where none is."""
    named = {c.id: " ".join(c.name.split()) for c in job.store.classes}
    lines = [named.get(i, "-") for i in range(max(named, default=-1) + 1)]
    write_new(folder / "classes.txt", "".join(f"{line}\n" for line in lines).encode())


def _write_encodings(folder: Path, job: Job, folders: Mapping[str, Folder]) -> None:
    """Write how the numbers of each folder are to be read (schemas/encodings.schema.json)."""
    entries = {}
    for name, to in folders.items():
        files = f"{to.path}/{{id}}{to.suffix}"
        modality = record_of(job.store, name)
        entries[name] = {**describe_encoding(modality), "files": files, **to.entry}
    document = {"format": "nimprep-encodings", "version": "1.0", "modalities": entries}
    write_new(folder / FILE, json_bytes(document))


def record_of(store: Store, name: str) -> Modality:
    """Return the record of what is exported: the store's, or of what is made anew."""
    return store.modality(name) if name in store.modalities else MODALITIES[name]
