"""What the metadata says of a store whose frames came at several times or from several stores."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from itertools import chain
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

    Its source's digest is the SHA-256 of the parts' digests in order, each followed by a line feed.

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
    joined: dict[str, list[str]] = {}
    for split, ids in chain.from_iterable(of_part.items() for of_part in fixed):
        joined.setdefault(split, []).extend(ids)
    extra = {
        "fixed_splits": joined,
        "frame_metadata": joined_metadata(metadata),
        "skipped": list(skipped),
    }
    # Of all, the least certain one's.
    origin = min((part["calibration"] for part in made), key=_ORIGINS.index)
    digests = "".join(f"{part['digest']}\n" for part in made)
    digest = f"sha256:{hashlib.sha256(digests.encode()).hexdigest()}"
    return {
        **{name: value for name, value in first.items() if name not in ("complete", *extra)},
        "tool_version": __version__,
        "calibration": {**first["calibration"], "origin": origin},
        **{name: value for name, value in extra.items() if value},
        "source": {"digest": digest, "parts": [dict(part) for part in made]},
    }


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
