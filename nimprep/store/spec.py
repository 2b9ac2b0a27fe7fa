"""Format 1.0 as data: which arrays a store holds, how they are laid out, coded and described."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from nimprep.errors import StoreError
from nimprep.frame import LabelClass
from nimprep.modality import MODALITIES, Modality
from nimprep.splits import SPLIT_CODES

FORMAT_VERSION = "1.0"

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
    """

    dims: tuple[str, ...]
    dtype: str
    fill: int | float | str
    attributes: dict[str, Any]


@dataclass(frozen=True)
class ChunkCodec:
    """Describe how one image is compressed within its chunk: a Zarr v3 codec and its settings."""

    name: str
    configuration: dict[str, Any]


def stored_modalities(described: Mapping[str, Any]) -> dict[str, Modality]:
    """Return the modalities that a store's attributes describe, as it holds them, in order."""
    return {
        name: modality.as_dtype(described[name].get("dtype", modality.dtype))
        for name, modality in MODALITIES.items()
        if name in described
    }


def image_spec(modality: Modality, classes: tuple[LabelClass, ...]) -> ArraySpec:
    """Return the array of a modality in a store of these classes."""
    attributes: dict[str, Any] = {"long_name": modality.long_name}
    if modality.units:
        attributes["units"] = modality.units
    if modality.steps > 1:
        attributes["scale_factor"] = 1 / modality.steps
    if modality.values == "numbers":
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


TABLES: dict[str, ArraySpec] = {
    "frame_id": ArraySpec(("frame",), "string", "", {"long_name": "frame id"}),
    "split": ArraySpec(
        ("frame",),
        "uint8",
        SPLIT_CODES["none"],
        {
            "long_name": "split",
            "flag_values": list(SPLIT_CODES.values()),
            "flag_meanings": " ".join(SPLIT_CODES),
        },
    ),
    "group": ArraySpec(("frame",), "string", "", {"long_name": "scene"}),
    "image_size": ArraySpec(
        ("frame", "size"),
        "int32",
        0,
        {
            "long_name": "height and width before padding",
            "units": "pixel",
            "coordinates": COORDINATES,
        },
    ),
    "intrinsics": ArraySpec(
        ("frame", "row", "column"),
        "float64",
        0.0,
        {
            "long_name": "camera matrix K, (0, 0) = centre of the top-left pixel",
            "units": "pixel",
            "coordinates": COORDINATES,
        },
    ),
    "baseline": ArraySpec(
        ("frame",),
        "float64",
        "NaN",
        {"long_name": "stereo baseline", "units": "m", "coordinates": COORDINATES},
    ),
    "cam_to_road": ArraySpec(
        ("frame", "row", "road_column"),
        "float64",
        "NaN",
        {
            "long_name": "transform from the camera frame of the stored image to the road frame",
            "units": "m",
            "coordinates": COORDINATES,
        },
    ),
    "gravity": ArraySpec(
        ("frame", "axis"),
        "float64",
        "NaN",
        {
            "long_name": "direction of gravity in the camera frame that HHA was made with",
            "units": "1",
            "coordinates": COORDINATES,
        },
    ),
    "channel_sums": ArraySpec(
        ("frame", "sum_channel", "sum"),
        "int64",
        0,
        {
            "long_name": "number, sum and sum of squares of the pixels with a value, per channel",
            "channels": ["red", "green", "blue", "depth in mm", "hha 1", "hha 2", "hha 3"],
            "coordinates": COORDINATES,
        },
    ),
}
"""The arrays with one entry per frame, which every store has."""

TABLE_SHAPES: dict[str, tuple[int, ...]] = {
    "image_size": (2,),
    "intrinsics": (3, 3),
    "cam_to_road": (3, 4),
    "gravity": (3,),
    "channel_sums": (7, 3),
}
"""What follows the frame dimension in the tables that have more than one."""


@dataclass(frozen=True)
class Preset:
    """Say how a kind of store compresses: a Blosc codec, and which byte order it sees."""

    cname: str
    clevel: int


PRESETS: dict[str, Preset] = {"fast": Preset("lz4hc", 5), "small": Preset("zstd", 9)}
"""Codec presets, chosen by scripts/benchmark_codecs.py; schemas/README.md has its outcome."""


def chunk_codec(preset: str, dtype: str) -> ChunkCodec:
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
    if not isinstance(version, str) or version.split(".")[0] != FORMAT_VERSION.split(".")[0]:
        raise StoreError(
            f"{where}: expected store format {FORMAT_VERSION}, found {version!r}; "
            "a newer nimprep may read it"
        )
