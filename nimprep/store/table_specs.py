"""The per-frame arrays of the format, as data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nimprep.depth_unit import MILLIMETRE, unit_words
from nimprep.frame import IGNORE_LABEL
from nimprep.modality import MODALITIES
from nimprep.splits import SPLIT_CODES
from nimprep.store.spec import COORDINATES, FORMAT_VERSION, WITHOUT_CHECKSUMS, ArraySpec

_IN_UNITS = "depth in mm"
"""The channel of depth, which counts in the store's unit."""

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
        (2,),
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
        (3, 3),
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
        (3, 4),
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
        (3,),
    ),
    "channel_sums": ArraySpec(
        ("frame", "sum_channel", "sum"),
        "int64",
        0,
        {
            "long_name": "number, sum and sum of squares of the pixels with a value, per channel",
            "channels": ["red", "green", "blue", _IN_UNITS, "hha 1", "hha 2", "hha 3"],
            "coordinates": COORDINATES,
        },
        (7, 3),
    ),
}
"""The arrays with one entry per frame that are the same in every store."""

CLASS_PIXELS = "class_pixels"
"""The table that says how many pixels each class has."""

CHUNK_CHECKSUMS = "chunk_crc32c"
"""The table that says which chunks are the store's own."""


def table_specs(
    modalities: Sequence[str] = (),
    version: str = FORMAT_VERSION,
    classes: Sequence[int] = (),
    unit_m: float = MILLIMETRE,
) -> dict[str, ArraySpec]:
    """Return the per-frame arrays of a store, by name.

    Parameters
    ----------
    modalities : sequence of str
        All that the store has, in the order of `nimprep.frame.MODALITIES`, then planes.
    version : str
        Its format.
    classes : sequence of int
        The ids of its classes, in the order of its attributes.
    unit_m : float
        The unit of its depth.
    """
    if version == WITHOUT_CHECKSUMS:
        return TABLES
    checksums = ArraySpec(
        ("frame", "modality"),
        "uint32",
        0,
        {
            "long_name": "CRC-32C that the chunk of a frame ends with, per modality",
            "modalities": list(modalities),
            "coordinates": COORDINATES,
        },
        (len(modalities),),
    )
    pixels = ArraySpec(
        ("frame", "class_or_ignored"),
        "uint32",
        0,
        {
            "long_name": "number of pixels of each class, and last of those to be ignored",
            "classes": [*classes, IGNORE_LABEL],
            "coordinates": COORDINATES,
        },
        (len(classes) + 1,),
    )
    planes = [name for name in modalities if name not in MODALITIES]
    sums = {"channel_sums": _sums_spec(planes, unit_m)}
    return {**TABLES, **sums, CLASS_PIXELS: pixels, CHUNK_CHECKSUMS: checksums}


def _sums_spec(planes: Sequence[str], unit_m: float) -> ArraySpec:
    """Return the table of sums in a store of these planes: each has a row below those of all."""
    spec = TABLES["channel_sums"]
    depth = "depth in " + unit_words(unit_m).removeprefix("1 ")
    own = [depth if name == _IN_UNITS else name for name in spec.attributes["channels"]]
    channels = [*own, *planes]
    return replace(
        spec, attributes={**spec.attributes, "channels": channels}, rest=(len(channels), 3)
    )


def table_key(name: str) -> str:
    """Return where a per-frame array's one chunk lies."""
    return "/".join((name, "c", *("0" for _ in table_specs()[name].dims)))
