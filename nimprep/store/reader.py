"""Open a store and read its frames."""

from __future__ import annotations

import operator
from collections.abc import Collection, Iterator
from typing import Any, SupportsIndex

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import StoreError
from nimprep.frame import Frame, LabelClass
from nimprep.modality import MODALITIES, Modality
from nimprep.schema import MAX_BYTES, check_json
from nimprep.splits import SPLIT_CODES, SPLIT_NAMES
from nimprep.store.access import storage_from
from nimprep.store.attributes import GravitySource, StoreAttributes
from nimprep.store.checksums import digest_problem
from nimprep.store.connection import RequestError
from nimprep.store.frame_tables import read_tables
from nimprep.store.frames import StoredFrame, check_size
from nimprep.store.images import ImageArray, OwnChunks
from nimprep.store.location import Place
from nimprep.store.metadata import ROOT, consolidated, root_from
from nimprep.store.spec import WITHOUT_CHECKSUMS, check_units, stored_modalities
from nimprep.store.storage import Storage

_TRIES = 5
"""Times that a store is opened which is replaced each time while it is being opened."""


class Store:
    """Read a store's frames by index.

    ``len(store)`` frames; ``store[i]`` is a `Frame` whose images are decompressed when asked for.
    Safe to share between threads and forked processes, and to pickle.

    Attributes
    ----------
    path : Path or str
        The folder, or the URL.
    storage : Storage
        What reads it.
    attributes : dict
        The `nimprep` object of the store's root (schemas/store.schema.json), as it is in force.
    ids : tuple of str
        Frame ids, in the order of the arrays.
    classes : tuple of LabelClass
        What the labels mean; empty where the store has none.
    modalities : tuple of str
        The images frames have here.
    planes : tuple of Modality
        Those of all that it holds that are the dataset's own: see `nimprep.plane`.
    stored : dict of str to Modality
        All that it holds, as it holds it.
    tables : Tables
        What the store says of each frame.
    arrays : dict of str to ImageArray
        The image arrays, for reading pixels as they are stored.
    """

    def __init__(self, place: Place | Storage, modalities: Collection[str] | None = None) -> None:
        storage = self.storage = storage_from(place)
        self.path: Place = storage.root or str(storage)
        before = storage.read(ROOT, MAX_BYTES)
        for _ in range(_TRIES):
            failure = None
            try:
                self._open(root_from(before, storage), modalities)
                if self.tables.chunk_crc32c is not None:
                    return
            except RequestError:
                raise
            except StoreError as error:
                failure = error
            # What was read may be of two stores, the one that was here and the one that took its
            # place; of format 1.0, without a sign that it is.
            after = storage.read(ROOT, MAX_BYTES)
            if after == before:
                if failure is not None:
                    raise failure
                return
            before = after
        raise StoreError(
            f"{self.path}: expected a store that stays while it is opened, found it replaced "
            f"{_TRIES} times; open it again"
        )

    def _open(self, root: dict[str, Any], modalities: Collection[str] | None) -> None:
        storage, path = self.storage, self.path
        # One request in place of one per array; `validate` compares them with the arrays' own.
        copies = {} if storage.root else consolidated(root)
        attributes: dict[str, Any] = root["attributes"]["nimprep"]
        check_json(attributes, "store", f"{path}: attributes", StoreError)
        if problem := digest_problem(attributes):
            raise StoreError(f"{path}: attributes: {problem}")
        about = StoreAttributes.from_json(attributes)
        self.stored = stored = stored_modalities(about.modalities)
        check_units(about.format_version, stored.values(), str(path))
        self.planes = tuple(m for name, m in stored.items() if name not in MODALITIES)
        if self.planes and about.format_version == WITHOUT_CHECKSUMS:
            raise StoreError(
                f"{path}: attributes: expected no planes in format {WITHOUT_CHECKSUMS}, found "
                f"{self.planes[0].name!r}; convert it again"
            )
        self.modalities = tuple(stored if modalities is None else modalities)
        for name in self.modalities:
            if name not in stored:
                raise StoreError(
                    f"{path}: expected one of the stored modalities {', '.join(stored)}, "
                    f"found {name!r}; convert again with --modalities"
                )
        self.tables, about = read_tables(storage, about, tuple(stored), copies)
        self.attributes = about.to_json()
        self.ids = self.tables.frame_id
        self.classes = tuple(
            LabelClass(c["id"], c["name"], tuple(c["color"])) for c in about.classes
        )
        own = {name: self._own_chunks(column) for column, name in enumerate(stored)}
        self.arrays = {
            name: ImageArray(storage, stored[name], self.classes, copies.get(name), own[name])
            for name in self.modalities
        }
        for name, array in self.arrays.items():
            if array.shape[0] != len(self.ids):
                raise StoreError(
                    f"{path}/{name}: expected {len(self.ids)} frames, found {array.shape[0]}"
                )

    def _own_chunks(self, column: int) -> OwnChunks | None:
        checksums = self.tables.chunk_crc32c
        if checksums is None:
            return None
        return OwnChunks(self.ids, checksums[:, column].astype("<u4").tobytes())

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
            gravity=self.given_gravity(index),
        )

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        return f"<nimprep store {self.path}: {len(self)} frames, {', '.join(self.modalities)}>"

    def modality(self, name: str) -> Modality:
        """Return all that is known of one of the store's modalities, as it holds it.

        Raises
        ------
        StoreError
            It was not opened with such.
        """
        if name not in self.arrays:
            raise StoreError(
                f"{self.path}: expected one of {', '.join(self.modalities)}, found {name!r}; "
                "convert again with --modalities"
            )
        return self.arrays[name].modality

    def camera(self, index: int) -> Camera:
        """Return the camera of a frame, of the frame's own size."""
        height, width = (int(n) for n in self.tables.image_size[index])
        for array in self.arrays.values():
            check_size((height, width), array.shape[1:], f"{self.path}: frame {index}")
        return Camera.from_matrix(self.tables.intrinsics[index], width, height)

    def cam_to_road(self, index: int) -> npt.NDArray[np.float64] | None:
        """Return a frame's (3, 4) transform from the camera to the road frame; None = none."""
        transform = self.tables.cam_to_road[index]
        return None if np.isnan(transform).any() else transform

    def gravity_source(self, index: int) -> GravitySource:
        """Return where a frame's direction of gravity, in the table, comes from."""
        said = self.about.gravity_from(index)
        if said is not None:
            return said
        if np.isnan(self.tables.gravity[index]).any():
            return "none"
        return "estimated" if self.cam_to_road(index) is None else "cam_to_road"

    def given_gravity(self, index: int) -> npt.NDArray[np.float64] | None:
        """Return a frame's direction of gravity, (3,), where it was given; None = it was not."""
        given = self.gravity_source(index) == "given"
        return self.tables.gravity[index] if given else None

    def indices(self, split: str | None = None) -> npt.NDArray[np.int64]:
        """Return the indices of a split's frames; None = all.

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
    def about(self) -> StoreAttributes:
        """The `attributes`, by name and type."""
        return StoreAttributes.from_json(self.attributes)

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
    return Store(path, modalities)
