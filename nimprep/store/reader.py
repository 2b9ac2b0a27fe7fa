"""Open a store and read its frames."""

from __future__ import annotations

import operator
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import StoreError
from nimprep.frame import Frame, LabelClass
from nimprep.schema import check_json
from nimprep.splits import SPLIT_CODES, SPLIT_NAMES
from nimprep.store.frames import StoredFrame, check_size
from nimprep.store.images import ImageArray
from nimprep.store.location import Place, location_from, storage_from
from nimprep.store.memory import table_key
from nimprep.store.metadata import ROOT, consolidated, read_document, read_root
from nimprep.store.spec import TABLE_SHAPES, TABLES, stored_modalities
from nimprep.store.storage import LocalStorage, Storage
from nimprep.store.tables import LARGEST_CHUNK, decode_table

_SLASHES = re.compile(r"[/\\]")


@dataclass(frozen=True)
class Tables:
    """Hold what a store says of each frame; every array has the frame first."""

    frame_id: tuple[str, ...]
    split: npt.NDArray[np.uint8]
    group: tuple[str, ...]
    image_size: npt.NDArray[np.int32]
    intrinsics: npt.NDArray[np.float64]
    baseline: npt.NDArray[np.float64]
    cam_to_road: npt.NDArray[np.float64]
    gravity: npt.NDArray[np.float64]
    channel_sums: npt.NDArray[np.int64]


def read_tables(storage: Storage, copies: Mapping[str, dict[str, Any]] | None = None) -> Tables:
    """Read the per-frame arrays of a store.

    Parameters
    ----------
    copies : mapping of str to dict, optional
        Metadata of arrays that has been read already.

    Raises
    ------
    StoreError
        One is missing, damaged, of another dtype or of another length than the others.
    """
    documents = dict(copies or {})
    keys = {name: table_key(name) for name in TABLES}
    chunks = storage.read_many(list(keys.values()), LARGEST_CHUNK)
    arrays: dict[str, npt.NDArray[Any]] = {}
    for name, spec in TABLES.items():
        where = f"{storage}/{name}"
        try:
            document = documents.get(name) or read_document(storage, f"{name}/{ROOT}")
            # A chunk that is gone would be all fill value to a Zarr library.
            if (chunk := chunks[keys[name]]) is None:
                raise StoreError(f"{where}: expected its chunk, found none")
            arrays[name] = decode_table(document, spec, TABLE_SHAPES.get(name, ()), chunk)
        except StoreError:
            raise
        except ValueError as error:
            raise StoreError(f"{where}: expected a table in one chunk, found {error}") from error
    lengths = {name: len(values) for name, values in arrays.items()}
    if len(set(lengths.values())) != 1:
        raise StoreError(f"{storage}: expected tables of one length, found {lengths}")
    for frame_id in arrays["frame_id"]:
        _check_id(frame_id, storage)
    return Tables(
        frame_id=tuple(str(i) for i in arrays["frame_id"]),
        split=arrays["split"],
        group=tuple(str(g) for g in arrays["group"]),
        image_size=arrays["image_size"],
        intrinsics=arrays["intrinsics"],
        baseline=arrays["baseline"],
        cam_to_road=arrays["cam_to_road"],
        gravity=arrays["gravity"],
        channel_sums=arrays["channel_sums"],
    )


def _check_id(frame_id: str, storage: Storage) -> None:
    """Raise `StoreError` for an id that would lead elsewhere as a file's name: others write it."""
    parts = _SLASHES.split(frame_id)
    if not frame_id.isprintable() or not {"", ".", ".."}.isdisjoint(parts):
        raise StoreError(
            f"{storage}/frame_id: expected names that files below a folder can have, "
            f"found {frame_id!a}"
        )


class Store:
    """Read a store's frames by number.

    ``len(store)`` frames; ``store[i]`` is a `Frame` whose images are decompressed when asked for.
    Safe to share between threads and forked processes, and to pickle.

    Attributes
    ----------
    path : Path or str
        The folder, or the URL.
    storage : Storage
        What reads it.
    attributes : dict
        The `nimprep` object of the store's root (schemas/store.schema.json).
    ids : tuple of str
        Frame ids, in the order of the arrays.
    classes : tuple of LabelClass
        What the labels mean; empty where the store has none.
    modalities : tuple of str
        The images frames have here.
    tables : Tables
        What the store says of each frame.
    arrays : dict of str to ImageArray
        The image arrays, for reading pixels as they are stored.
    """

    def __init__(self, place: Place | Storage, modalities: Collection[str] | None = None) -> None:
        storage = self.storage = storage_from(place)
        local = isinstance(storage, LocalStorage)
        path: Place = storage.root if isinstance(storage, LocalStorage) else str(storage)
        self.path = path
        root = read_root(storage)
        # One request in place of one per array; `validate` compares them with the arrays' own.
        copies = {} if local else consolidated(root)
        self.attributes: dict[str, Any] = root["attributes"]["nimprep"]
        check_json(self.attributes, "store", f"{path}: attributes", StoreError)
        self.classes = tuple(
            LabelClass(c["id"], c["name"], tuple(c["color"])) for c in self.attributes["classes"]
        )
        stored = stored_modalities(self.attributes["modalities"])
        self.modalities = tuple(stored if modalities is None else modalities)
        for name in self.modalities:
            if name not in stored:
                raise StoreError(
                    f"{path}: expected one of the stored modalities {', '.join(stored)}, "
                    f"found {name!r}; convert again with --modalities"
                )
        self.tables = read_tables(storage, copies)
        self.ids = self.tables.frame_id
        self.arrays = {
            name: ImageArray(storage, stored[name], self.classes, copies.get(name))
            for name in self.modalities
        }
        for name, array in self.arrays.items():
            if array.shape[0] != len(self.ids):
                raise StoreError(
                    f"{path}/{name}: expected {len(self.ids)} frames, found {array.shape[0]}"
                )

    def __len__(self) -> int:
        return len(self.ids)

    def __getitem__(self, number: SupportsIndex) -> Frame:
        index = operator.index(number)
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self.path}: expected a frame below {len(self)}, found {index}")
        index %= len(self)
        return StoredFrame.fetch(
            index,
            self.arrays,
            self.camera(index),
            id=self.ids[index],
            group=self.tables.group[index],
            baseline_m=float(self.tables.baseline[index]),
            cam_to_road=self.cam_to_road(index),
        )

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        return f"<nimprep store {self.path}: {len(self)} frames, {', '.join(self.modalities)}>"

    def camera(self, number: int) -> Camera:
        """Return the camera of a frame, of the frame's own size."""
        height, width = (int(n) for n in self.tables.image_size[number])
        for array in self.arrays.values():
            check_size((height, width), array.shape[1:], f"{self.path}: frame {number}")
        return Camera.from_matrix(self.tables.intrinsics[number], width, height)

    def cam_to_road(self, number: int) -> npt.NDArray[np.float64] | None:
        """Return a frame's (3, 4) transform from the camera to the road frame; None = none."""
        transform = self.tables.cam_to_road[number]
        return None if np.isnan(transform).any() else transform

    def indices(self, split: str | None = None) -> npt.NDArray[np.int64]:
        """Return the numbers of a split's frames; None = all.

        Raises
        ------
        StoreError
            There is no split of that name.
        """
        if split is None:
            return np.arange(len(self))
        if split not in SPLIT_CODES:
            raise StoreError(
                f"{self.path}: expected a split of {list(SPLIT_CODES)}, found {split!r}"
            )
        return np.flatnonzero(self.tables.split == SPLIT_CODES[split])

    @property
    def splits(self) -> dict[str, str]:
        """Each frame id's split: "train", "val", "test" or "none"."""
        names = (SPLIT_NAMES.get(int(code), "none") for code in self.tables.split)
        return dict(zip(self.ids, names, strict=True))


def open_store(path: Place | Storage, modalities: Collection[str] | None = None) -> Store:
    """Open a store for reading.

    Parameters
    ----------
    path : path, URL or storage
        What `convert` wrote: a folder, or s3://bucket/out.zarr and the like, which needs the extra
        `cloud`; `nimprep.store.objects.ObjectStorage` for options that no variable sets.
    modalities : collection of str, optional
        Only these images are read; None = all there are.

    Returns
    -------
    Store
        ``len(store)``, ``store[i] -> Frame``, ``store.ids``, ``store.classes``.

    Raises
    ------
    StoreError
        There is no store, it is not complete, of a newer format, or damaged.
    """
    return Store(path if isinstance(path, Storage) else location_from(path), modalities)
