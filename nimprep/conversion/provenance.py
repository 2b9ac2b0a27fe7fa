"""What the metadata says of a store whose frames came at several times or from several stores."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from nimprep import __version__

_ORIGINS = ("nominal", "user", "file")
"""Where calibrations come from, the least certain first."""


def parts(attributes: Mapping[str, Any], frames: int) -> list[dict[str, Any]]:
    """Return the parts of a store of so many frames: what was converted or appended at once."""
    source = attributes["source"]
    whole = {
        "frames": frames,
        "dataset": attributes["dataset"],
        "calibration": attributes["calibration"]["origin"],
        "tool_version": attributes["tool_version"],
        "digest": source["digest"],
    }
    return [dict(part) for part in source.get("parts", [whole])]


def joined_attributes(
    first: Mapping[str, Any],
    made: Sequence[Mapping[str, Any]],
    fixed: Sequence[Mapping[str, Sequence[str]]],
    metadata: Sequence[tuple[Mapping[str, Any], int]],
    skipped: Sequence[Mapping[str, str]],
) -> dict[str, Any]:
    """Return the `nimprep` object of a store that is made of parts: its first one's, but for these.

    Parameters
    ----------
    first : mapping
        That of the store whose frames come first.
    made : sequence of mapping
        The parts: see `parts`.
    fixed, metadata : sequence
        Each part's `fixed_splits`, and `frame_metadata` with its number of frames.
    skipped : sequence of mapping
        Of all parts.
    """
    extra = {
        "fixed_splits": joined_fixed(fixed),
        "frame_metadata": joined_metadata(metadata),
        "skipped": list(skipped),
    }
    return {
        **{name: value for name, value in first.items() if name not in ("complete", *extra)},
        "tool_version": __version__,
        "calibration": {**first["calibration"], "origin": _least_certain(made)},
        **{name: value for name, value in extra.items() if value},
        "source": _joined_source(made),
    }


def _joined_source(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the `source` of a store that is made of parts.

    Its digest is the SHA-256 of the parts' digests in order, each followed by a line feed.
    """
    digest = hashlib.sha256()
    for part in found:
        digest.update(f"{part['digest']}\n".encode())
    return {"digest": f"sha256:{digest.hexdigest()}", "parts": [dict(part) for part in found]}


def _least_certain(found: Sequence[Mapping[str, Any]]) -> str:
    """Return the calibration's origin that holds for all parts: the least certain of theirs."""
    return _ORIGINS[min(_ORIGINS.index(part["calibration"]) for part in found)]


def joined_metadata(found: Sequence[tuple[Mapping[str, Any], int]]) -> dict[str, Any]:
    """Return the `frame_metadata` of frames of which these, so many each, say what they say.

    Where some frames have a column and others do not, the others' value in it is None.
    """
    names = list(dict.fromkeys(name for columns, _ in found for name in columns))
    return {name: _joined_column([(c.get(name), n) for c, n in found]) for name in names}


def _joined_column(found: Sequence[tuple[Mapping[str, Any] | None, int]]) -> dict[str, Any]:
    values: list[Any] = []
    of_frame: list[int] = []
    for column, frames in found:
        column = column or {"values": [None], "of_frame": [0] * frames}
        for value in column["values"]:
            if value not in values:
                values.append(value)
        places = [values.index(value) for value in column["values"]]
        of_frame += [places[i] for i in column["of_frame"]]
    return {"values": values, "of_frame": of_frame}


def joined_fixed(found: Sequence[Mapping[str, Sequence[str]]]) -> dict[str, list[str]]:
    """Return `fixed_splits`, ids by split, of them all."""
    joined: dict[str, list[str]] = {}
    for fixed in found:
        for split, ids in fixed.items():
            joined.setdefault(split, []).extend(ids)
    return joined
