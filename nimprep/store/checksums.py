"""What ties a store's parts to each other, since format 1.1.

The root's attributes hold the checksum that each table's chunk ends with, and a digest of
themselves; the table `chunk_crc32c` holds the images' checksums. So parts of two stores, or of two
versions of one, are not taken for one store.

A split is changed in two places, the table and the attributes. First the attributes get what is to
be, and beside it `split_before`: what is in force, with the checksum of the table it made. Writing
the table is what changes the split, at once for everyone; then `split_before` goes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from nimprep.store.attributes import StoreAttributes
from nimprep.store.spec import WITHOUT_CHECKSUMS

MEND = "copy the store again, or open it again if it was replaced"
"""What to do where parts of a store do not belong together."""

_EXACT = 1 << 53
"""Below it a whole number is the same number with a point and without, in any program."""


def chunk_checksum(chunk: bytes) -> int:
    """Return the CRC-32C that a chunk ends with."""
    return int.from_bytes(chunk[-4:], "little")


def with_digest(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Return attributes with the digest that they then have, if they are of a format with one."""
    found = {k: v for k, v in attributes.items() if k != "digest"}
    if found.get("format_version") != WITHOUT_CHECKSUMS:
        found["digest"] = attributes_digest(found)
    return found


def attributes_digest(attributes: Mapping[str, Any]) -> str:
    """Return the digest of a `nimprep` object, its own entry left out.

    SHA-256 of the object as JSON with keys sorted, without spaces, characters beyond ASCII
    escaped, and whole numbers below 2**53 without a point, as some programs write them.
    """
    plain = _plain({k: v for k, v in attributes.items() if k != "digest"})
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _plain(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer() and abs(value) < _EXACT:
        return int(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    # Lists with an entry for each frame hold nothing else; to look at each takes as long as all.
    if isinstance(value, list) and not {str, int} >= set(map(type, value)):
        return [_plain(item) for item in value]
    return value


def digest_problem(attributes: Mapping[str, Any]) -> str | None:
    """Return what is wrong with attributes that are not as they were written; None = nothing."""
    # By the entry too: a version that was damaged, or edited, must not switch the checks off.
    if attributes["format_version"] == WITHOUT_CHECKSUMS and "digest" not in attributes:
        return None
    found = attributes_digest(attributes)
    if found == attributes["digest"]:
        return None
    return (
        f"expected the digest {attributes['digest'][:19]}, found attributes with {found[:19]}: "
        f"they are damaged, or were changed by another program; {MEND}"
    )


def in_force(about: StoreAttributes, split_checksum: int) -> StoreAttributes:
    """Return attributes as they are in force: where a split was being changed, of the table there.

    Parameters
    ----------
    split_checksum : int
        That the table's chunk ends with.
    """
    before, tables = about.split_before, about.tables
    about = replace(about, split_before=None)
    if before is None or before["crc32c"] != split_checksum:
        return about
    split: Any = {name: value for name, value in before.items() if name != "crc32c"}
    if tables is not None:
        tables = {**tables, "split": split_checksum}
    return replace(about, split=split, tables=tables)
