"""The format as data: which images a store holds, how arrays are laid out, coded and described."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from nimprep.errors import ArrayError, StoreError
from nimprep.frame import LabelClass
from nimprep.modality import MODALITIES, Modality
from nimprep.plane import by_name, plane_from

FORMAT_VERSION = "1.2"

OTHER_UNITS = "2.0"
"""The format of stores whose depth does not count in millimetres: 1.2 in all else.

Versions before it read any 1.x and take its depth for millimetres, so that a tenth of the depth
would pass for depth; stores of another number before the dot they refuse.
"""

WITHOUT_CHECKSUMS = "1.0"
"""The format whose stores do not say which chunks are theirs: any that are whole are taken."""

KNOWN_VERSIONS = (WITHOUT_CHECKSUMS, "1.1", FORMAT_VERSION, OTHER_UNITS)
"""Formats all of which this version knows; of a newer one it reads what these have."""

COORDINATES = "frame_id split group"

NORMAL_SCALES = {d: MODALITIES["normal"].as_dtype(d).steps for d in MODALITIES["normal"].dtypes}
"""Kept for a release, for those who import it: `nimprep.modality` says it."""


@dataclass(frozen=True)
class ArraySpec:
    """Describe one array of a store.

    Attributes
    ----------
    dims : tuple of str
        Dimension names; "frame" first.
    dtype : str
        Zarr data type.
    fill : int or float or str
        What a pixel, or a frame's entry, is before it is written.
    attributes : dict
        CF attributes, which xarray decodes by.
    rest : tuple of int
        Of a table, what follows the frame dimension; images are of a store's own size.
    """

    dims: tuple[str, ...]
    dtype: str
    fill: int | float | str
    attributes: dict[str, Any]
    rest: tuple[int, ...] = ()


@dataclass(frozen=True)
class ChunkCodec:
    """Describe how one image is compressed within its chunk: a Zarr v3 codec and its settings."""

    name: str
    configuration: dict[str, Any]


def stored_modalities(described: Mapping[str, Any]) -> dict[str, Modality]:
    """Return the modalities that a store's attributes describe, as it holds them, in order.

    Those that every store can have come first, in the order of their table; then planes by name.

    Raises
    ------
    StoreError
        A plane is described that there cannot be.
    """
    known = {
        name: modality.as_dtype(described[name].get("dtype", modality.dtype)).as_unit(
            described[name].get("unit_m"), rounded=described[name].get("rounded", False)
        )
        for name, modality in MODALITIES.items()
        if name in described
    }
    try:
        planes = [plane_from(name, described[name]) for name in described if name not in known]
    except ArrayError as error:
        raise StoreError(f"attributes: modalities: {error}") from error
    return known | by_name(planes)


def format_of(modalities: Iterable[Modality]) -> str:
    """Return the format of a store that holds these."""
    return OTHER_UNITS if any(m.has_other_unit for m in modalities) else FORMAT_VERSION


def check_units(version: str, modalities: Iterable[Modality], where: str) -> None:
    """Refuse a store whose format is not that of its unit of depth.

    Raises
    ------
    StoreError
        The number before the dot is another than its modalities have.
    """
    wanted = format_of(modalities)
    if version.partition(".")[0] != wanted.partition(".")[0]:
        raise StoreError(
            f"{where}: expected store format {wanted}, found {version!r}; a newer nimprep may read "
            "it"
        )


def image_spec(modality: Modality, classes: tuple[LabelClass, ...]) -> ArraySpec:
    """Return the array of a modality in a store of these classes."""
    attributes: dict[str, Any] = {"long_name": modality.long_name}
    if modality.units:
        attributes["units"] = modality.units
    if modality.steps > 1 or modality.own_unit:
        attributes["scale_factor"] = modality.step
    if modality.values == "measures" and (modality.scale, modality.offset) != (1, 0):
        attributes["scale_factor"] = modality.scale
        attributes["add_offset"] = modality.offset
    if modality.values == "numbers" or (modality.values == "measures" and modality.has_none):
        attributes["_FillValue"] = modality.fill
    if modality.channels:
        attributes["channels"] = list(modality.channels)
    if modality.comment:
        attributes["comment"] = modality.comment
    if modality.values == "classes":
        names = [c.name.replace(" ", "_") for c in classes]
        attributes["flag_values"] = [*(c.id for c in classes), modality.fill]
        attributes["flag_meanings"] = " ".join([*names, "ignore"])
    attributes["coordinates"] = COORDINATES
    dims = ("frame", "y", "x", "channel")
    return ArraySpec(
        dims if modality.channels else dims[:3], modality.dtype, modality.fill, attributes
    )


@dataclass(frozen=True)
class Preset:
    """Say how a kind of store compresses: a Blosc codec, and which byte order it sees."""

    cname: str
    clevel: int


Codec = Literal["fast", "small"]

PRESETS: dict[Codec, Preset] = {"fast": Preset("lz4hc", 5), "small": Preset("zstd", 9)}
"""Codec presets, chosen by scripts/benchmark_codecs.py; schemas/README.md has its outcome."""


def chunk_codec(preset: Codec, dtype: str) -> ChunkCodec:
    """Return the codec of an image array: bytes are shuffled only where values have two.

    Bitshuffle, and shuffling the three channels apart, made real frames larger and slower to read.
    """
    typesize = 2 if dtype.endswith("16") else 1
    return ChunkCodec(
        "blosc",
        {
            "typesize": typesize,
            "cname": PRESETS[preset].cname,
            "clevel": PRESETS[preset].clevel,
            "shuffle": "shuffle" if typesize == 2 else "noshuffle",
            "blocksize": 0,
        },
    )


MAX_FRAMES = 1 << 20
"""A store that claims more frames is refused: its tables, of some hundred bytes a frame, can be
packed to almost nothing, and are unpacked when it is opened."""

SHARD_LENGTH = 32
"""Frames per shard: the unit of work and of writing."""


def check_version(version: object, where: str) -> None:
    """Refuse a format that this version cannot read.

    Raises
    ------
    StoreError
        It is newer, or none.
    """
    known = {each.split(".")[0] for each in KNOWN_VERSIONS}
    if not isinstance(version, str) or version.split(".")[0] not in known:
        raise StoreError(
            f"{where}: expected store format {FORMAT_VERSION}, found {version!r}; "
            "a newer nimprep may read it"
        )


def check_changeable(version: object, where: str) -> None:
    """Refuse to change, or to copy into another, a store that may hold what is not known here.

    Raises
    ------
    StoreError
        Its format is newer.
    """
    if version not in KNOWN_VERSIONS:
        raise StoreError(
            f"{where}: expected store format {FORMAT_VERSION} or older to work on, "
            f"found {version!r}; a newer nimprep can do it"
        )
