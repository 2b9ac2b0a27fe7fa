"""How an image array must be laid out, by its zarr.json."""

from __future__ import annotations

from typing import Any

from nimprep.frame import MAX_PIXELS
from nimprep.store.spec import MAX_FRAMES, ArraySpec


def layout_problems(document: dict[str, Any], spec: ArraySpec) -> list[str]:
    """Return in what an image array's zarr.json differs from the format, a line each."""
    try:
        return _layout_problems(document, spec)
    except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
        return [f"expected an array's metadata, found it malformed ({error!r:.200})"]


def _byte_orders(spec: ArraySpec, codec: dict[str, Any]) -> tuple[str, str]:
    found = codec.get("configuration", {}).get("endian", "little")
    return "little", found if spec.dtype.endswith("16") else "little"


def _layout_problems(document: dict[str, Any], spec: ArraySpec) -> list[str]:
    problems = []
    shape = document["shape"]
    grid = document["chunk_grid"]["configuration"]["chunk_shape"]
    sharding = document["codecs"][0]
    inner = sharding["configuration"]
    blosc = [codec["name"] for codec in inner["codecs"]]
    expected: list[tuple[str, Any, Any]] = [
        ("zarr_format", 3, document["zarr_format"]),
        ("node_type", "array", document["node_type"]),
        ("key encoding", "default", document["chunk_key_encoding"]["name"]),
        ("dimension names", list(spec.dims), document.get("dimension_names")),
        ("data type", spec.dtype, document["data_type"]),
        ("fill value", spec.fill, document["fill_value"]),
        ("dimensions", len(spec.dims), len(shape)),
        ("chunk grid", "regular", document["chunk_grid"]["name"]),
        ("key encoding", {"separator": "/"}, document["chunk_key_encoding"]["configuration"]),
        ("codec", "sharding_indexed", sharding["name"]),
        ("codecs", 1, len(document["codecs"])),
        ("chunk codecs", ["bytes", "blosc", "crc32c"], blosc),
        ("byte order", *_byte_orders(spec, inner["codecs"][0])),
        ("chunk shape", [1, *shape[1:]], inner["chunk_shape"]),
        ("shard shape", [grid[0], *shape[1:]], grid),
        ("index place", "end", inner.get("index_location", "end")),
        ("index codecs", ["bytes", "crc32c"], [c["name"] for c in inner["index_codecs"]]),
        (
            "index byte order",
            "little",
            inner["index_codecs"][0].get("configuration", {}).get("endian", "little"),
        ),
        ("transformers", [], document.get("storage_transformers", [])),
    ]
    for what, wanted, found in expected:
        if wanted != found:
            problems.append(f"expected {what} {wanted}, found {found!r:.200}")
    for key in ("scale_factor", "add_offset") if "scale_factor" in spec.attributes else ():
        # What others read the numbers by, and what they are read by here, must be the same.
        wanted, found = spec.attributes.get(key, 0), document["attributes"].get(key, 0)
        if wanted != found:
            problems.append(f"expected {key} {wanted}, found {found!r:.200}")
    numbers = [*shape, grid[0]]
    sane = all(type(n) is int and n > 0 for n in numbers)
    if not sane or grid[0] > 1 << 16 or shape[0] > MAX_FRAMES:
        problems.append(
            f"expected positive sizes, found shape {shape!r:.200} in shards of {grid[0]!r:.200}"
        )
    elif shape[1] * shape[2] > MAX_PIXELS or (len(shape) == 4 and shape[3] != 3):
        problems.append(f"expected images of at most {MAX_PIXELS} pixels, found shape {shape}")
    return problems
