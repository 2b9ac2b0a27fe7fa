"""Write a store: arrays first, shard by shard; what makes it readable comes last."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.depth_unit import MILLIMETRES, ChosenUnit
from nimprep.errors import StoreError
from nimprep.folders import adopt, adopt_tree, place_of, refuse_inside, refuse_within, sync_folder
from nimprep.frame import LabelClass
from nimprep.modality import MODALITIES, Modality
from nimprep.schema import json_bytes, schema_problems
from nimprep.store.attributes import StoreAttributes
from nimprep.store.checksums import chunk_checksum, with_digest
from nimprep.store.extras import check_replaceable, discard
from nimprep.store.memory import MemoryFiles
from nimprep.store.metadata import ROOT, read_attributes
from nimprep.store.shards import encode_shard
from nimprep.store.spec import ArraySpec, ChunkCodec, Codec, chunk_codec, format_of, image_spec
from nimprep.store.storage import LocalStorage, Storage
from nimprep.store.swap import swap_folders
from nimprep.store.table_specs import table_key, table_specs

if TYPE_CHECKING:
    import zarr


@dataclass(frozen=True)
class StoreLayout:
    """Fix a store's shape before anything is written.

    Attributes
    ----------
    frames : int
    height, width : int
        Of the largest frame; smaller ones are padded at the bottom and right.
    modalities : tuple of str
    classes : tuple of LabelClass
    normal_dtype : {"int8", "int16"}
    codec : {"fast", "small"}
        A name in `PRESETS`.
    shard_length : int
        Frames per shard.
    planes : tuple of Modality
        Those of the modalities that are the dataset's own.
    depth_unit : ChosenUnit
        In which depth is stored.
    """

    frames: int
    height: int
    width: int
    modalities: tuple[str, ...]
    classes: tuple[LabelClass, ...]
    normal_dtype: str
    codec: Codec
    shard_length: int
    planes: tuple[Modality, ...] = ()
    depth_unit: ChosenUnit = MILLIMETRES

    def modality(self, name: str) -> Modality:
        """Return a modality as the store is to hold it."""
        for plane in self.planes:
            if plane.name == name:
                return plane
        held, unit = MODALITIES[name].as_dtype(self.normal_dtype), self.depth_unit
        return held.as_unit(unit.unit_m, rounded=unit.rounded)

    def spec(self, modality: str) -> ArraySpec:
        """Return the array a modality is stored in."""
        return image_spec(self.modality(modality), self.classes)

    def chunk_codec(self, modality: str) -> ChunkCodec:
        """Return the codec of a modality's chunks."""
        return chunk_codec(self.codec, self.spec(modality).dtype)

    def image_shape(self, modality: str) -> tuple[int, ...]:
        """Return the shape of one padded image: (height, width) or (height, width, 3)."""
        return self.modality(modality).image_shape(self.height, self.width)


def check_target(target: Path, *, overwrite: bool, grows: bool = False) -> None:
    """Make sure that a store may be written to `target`.

    A store cut short may be replaced without asking; a complete one only where `overwrite` says
    so; a folder of anything else never, nor a store with something in it that is not nimprep's.

    Parameters
    ----------
    grows : bool
        What is written has all that is there in it: then that is no matter.

    Raises
    ------
    StoreError
        Something is there that must stay.
    """
    refuse_inside(target, error=StoreError)
    try:
        taken = target.is_symlink() or (target.exists() and not target.is_dir())
        filled = not taken and target.is_dir() and any(target.iterdir())
    except OSError as error:
        raise StoreError(f"{target}: expected a writable place, found {error.strerror}") from error
    if taken:
        raise StoreError(f"{target}: expected a free name for the store, found a file or link")
    if target.is_dir():
        refuse_within(target, StoreError)
    if not filled:
        return
    try:
        found = read_attributes(target, complete=False)
    except StoreError as error:
        raise StoreError(
            f"{target}: expected a free name for the store, found a folder that is no "
            "nimprep store; choose another name"
        ) from error
    if found.get("complete") is True and not overwrite:
        raise StoreError(
            f"{target}: expected a free name for the store, found a complete store; "
            "use --overwrite to replace it"
        )
    if not grows:
        check_replaceable(LocalStorage(target))


OLD = ".old"
"""The suffix, in the place a store is moved from, of the one that it replaces meanwhile."""


def move_into_place(partial: Path, target: Path, *, overwrite: bool, grows: bool = False) -> None:
    """Give a finished store its name, and the owner and mode of what it replaces.

    That goes only afterwards; `overwrite` and `grows` are as for `check_target`.

    Killed at any moment, it leaves at the target the one store or the other, whole. Where folders
    cannot change names at once, there is a moment without either: `put_back` helps then.

    Raises
    ------
    StoreError
        Something has come there since that must stay, or it cannot be moved.
    """
    target = place_of(target)
    check_target(target, overwrite=overwrite, grows=grows)
    old = None
    try:
        before = target.stat() if target.is_dir() else None
        if before is not None:
            adopt_tree(partial, target)
        if target.is_dir() and any(target.iterdir()):
            if swap_folders(partial, target):
                old = partial
            else:
                old = partial.with_suffix(OLD)
                target.replace(old)
                try:
                    partial.replace(target)
                except OSError:
                    old.replace(target)
                    raise
        else:
            partial.replace(target)
        if before is not None:
            adopt(target, before)
        sync_folder(target.parent)
        if old is not None:
            discard(old, target)
    except OSError as error:
        raise StoreError(f"{target}: expected to write it, found {error.strerror}") from error


def put_back(partial: Path, target: Path) -> bool:
    """Undo what `move_into_place` had done when it was killed between its two renamings.

    Returns
    -------
    bool
        Whether there was anything to undo; then the target is the store it was before.

    Raises
    ------
    StoreError
        It cannot be moved.
    """
    old = partial.with_suffix(OLD)
    if target.exists() or not (old / ROOT).is_file():
        return False
    try:
        old.replace(target)
    except OSError as error:
        raise StoreError(f"{target}: expected to write it, found {error.strerror}") from error
    return True


class StoreWriter:
    """Write one store.

    Parameters
    ----------
    storage : Storage
        An empty place, or one that holds what this writer's like has written so far.
    layout : StoreLayout
        Its number of frames counts in `finish` only.
    """

    def __init__(self, storage: Storage, layout: StoreLayout) -> None:
        self.storage = storage
        self.layout = layout

    def begin(self, attributes: dict[str, Any]) -> None:
        """Write the root, which says that the store is not complete."""
        root = {
            "zarr_format": 3,
            "node_type": "group",
            "attributes": {"nimprep": {**attributes, "complete": False}},
        }
        self.storage.write(ROOT, [json_bytes(root)])

    def shard_key(self, modality: str, shard: int) -> str:
        """Return where a shard of a modality lies."""
        return "/".join((modality, "c", str(shard), *self._rest(modality)))

    def _rest(self, modality: str) -> list[str]:
        return ["0"] * (len(self.layout.spec(modality).dims) - 1)

    def write_shard(self, modality: str, shard: int, chunks: Sequence[bytes]) -> int:
        """Write one shard of one modality from its encoded chunks; return its index's checksum."""
        parts = encode_shard(chunks, self.layout.shard_length)
        self.storage.write(self.shard_key(modality, shard), parts)
        return chunk_checksum(parts[-1])

    def finish(self, tables: Mapping[str, npt.NDArray[Any]], about: StoreAttributes) -> None:
        """Write the per-frame tables and the arrays' metadata; then the store is complete.

        Parameters
        ----------
        tables : mapping
            One array per name in `table_specs`, frame first.
        about : StoreAttributes
            Of the finished store, but for its format and checksums.

        Raises
        ------
        StoreError
            The store could not be opened: the attributes do not fit their schema.
        """
        import zarr

        memory = MemoryFiles({})
        group = zarr.open_group(memory.zarr, mode="w", zarr_format=3)
        for modality in self.layout.modalities:
            self._create_images(group, modality)
        unit_m = self.layout.depth_unit.unit_m
        specs = table_specs(self.layout.modalities, classes=about.class_ids, unit_m=unit_m)
        for name, spec in specs.items():
            create_table(group, name, spec, tables[name])
        with warnings.catch_warnings():
            # Consolidated metadata is an extension that xarray reads, and warns without.
            warnings.filterwarnings("ignore", message="Consolidated metadata")
            zarr.consolidate_metadata(memory.zarr)
        files = memory.contents()
        root = json.loads(files.pop(ROOT))
        chunks = {name: files[table_key(name)] for name in specs}
        sums = {name: chunk_checksum(chunk) for name, chunk in chunks.items()}
        version = format_of(map(self.layout.modality, self.layout.modalities))
        about = replace(about, format_version=version, complete=True, tables=sums)
        root["attributes"]["nimprep"] = with_digest(about.to_json())
        if problems := schema_problems(root["attributes"]["nimprep"], "store"):
            raise StoreError(
                f"{self.storage}: expected attributes that a store can have, found {problems[0]}; "
                "nothing has been published"
            )
        for key, data in files.items():
            self.storage.write(key, [data])
        self.storage.write(ROOT, [json_bytes(root)])

    def _create_images(self, group: zarr.Group, modality: str) -> None:
        from zarr.codecs import BloscCodec, Crc32cCodec

        spec = self.layout.spec(modality)
        image = self.layout.image_shape(modality)
        group.create_array(
            modality,
            shape=(self.layout.frames, *image),
            chunks=(1, *image),
            shards=(self.layout.shard_length, *image),
            dtype=spec.dtype,
            fill_value=spec.fill,
            compressors=[
                BloscCodec(**self.layout.chunk_codec(modality).configuration),
                Crc32cCodec(),
            ],
            dimension_names=spec.dims,
            attributes=spec.attributes,
        )


def create_table(group: zarr.Group, name: str, spec: ArraySpec, values: npt.NDArray[Any]) -> None:
    """Write one per-frame array as a single checked chunk."""
    from zarr.codecs import Crc32cCodec, ZstdCodec

    shape = (len(values), *spec.rest)
    array = group.create_array(
        name,
        shape=shape,
        chunks=shape,
        dtype=spec.dtype,
        fill_value=float(spec.fill) if spec.dtype == "float64" else spec.fill,
        compressors=[ZstdCodec(level=3), Crc32cCodec()],
        dimension_names=spec.dims,
        attributes=spec.attributes,
        # An absent chunk would read as fill value: a deleted file must be an error instead.
        config={"write_empty_chunks": True},
    )
    array[...] = values if spec.dtype == "string" else np.asarray(values, dtype=spec.dtype)
