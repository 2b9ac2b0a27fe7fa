"""What the metadata says of a store whose frames came at several times or from several stores."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from nimprep import __version__
from nimprep.conversion.compatibility import as_said_now
from nimprep.conversion.doubted import joined_doubts
from nimprep.doubts.surfaces import joined_noise
from nimprep.splits import SplitName
from nimprep.store.attributes import StoreAttributes

_ORIGINS = ("nominal", "user", "file")
"""Where calibrations come from, the least certain first."""


_LAST = (
    *("references", "fixed_splits", "frame_metadata", "skipped", "doubts", "findings"),
    *("normal_noise", "depth_lost", "complete", "tables", "digest"),
)
"""What a store's `nimprep` object ends with where frames joined it."""


def joined_attributes(
    found: Sequence[tuple[StoreAttributes, int]], **changes: Any
) -> StoreAttributes:
    """Return what is said of a store made of these, so many frames each: the first's, mostly.

    Of doubts, those of labels are left out: they are counted anew (`with_doubts_of_all`).

    Its source's digest is the SHA-256 of the parts' digests in order, each followed by a line feed.

    Parameters
    ----------
    **changes
        Fields that are none of these stores'.
    """
    first = found[0][0]
    made = list(chain.from_iterable(_parts(about, frames) for about, frames in found))
    fixed: dict[SplitName, list[str]] = {}
    for split, ids in chain.from_iterable(about.fixed_splits.items() for about, _ in found):
        fixed.setdefault(split, []).extend(ids)
    # Of all, the least certain one's.
    origin = min((part["calibration"] for part in made), key=_ORIGINS.index)
    digests = "".join(f"{part['digest']}\n" for part in made)
    digest = f"sha256:{hashlib.sha256(digests.encode()).hexdigest()}"
    joined = replace(
        first,
        document={k: v for k, v in first.document.items() if k not in _LAST},
        tool_version=__version__,
        modalities={name: as_said_now(made) for name, made in first.modalities.items()},
        calibration={**first.calibration, "origin": origin},
        references=_joined_references(about for about, _ in found),
        fixed_splits=fixed,
        frame_metadata=joined_metadata([(about.frame_metadata, n) for about, n in found]),
        normals_chosen=_joined_choice(about.normals_chosen for about, _ in found),
        skipped=list(chain.from_iterable(about.skipped for about, _ in found)),
        doubts=joined_doubts(about.doubts for about, _ in found),
        findings=joined_doubts(about.findings for about, _ in found),
        normal_noise=joined_noise([about.normal_noise for about, _ in found]),
        source={"digest": digest, "parts": made},
    )
    return replace(joined, **changes)


def _joined_references(found: Iterable[StoreAttributes]) -> list[dict[str, str]]:
    """Return whose datasets the stores' frames are of, each once."""
    references: list[dict[str, str]] = []
    for about in found:
        references += [each for each in about.references if each not in references]
    return references


def _joined_choice(found: Iterable[Mapping[str, Any] | None]) -> dict[str, Any] | None:
    """Return the choice of stores' one method, by the frames of all that chose."""
    made = [choice for choice in found if choice is not None]
    if not made:
        return None
    return {**made[0], "frames": [frame for choice in made for frame in choice["frames"]]}


def with_prefix(choice: Mapping[str, Any] | None, prefix: str) -> dict[str, Any] | None:
    """Return a store's `normals_chosen` with a prefix before its frames' ids."""
    if choice is None:
        return None
    frames = [{**frame, "id": prefix + frame["id"]} for frame in choice["frames"]]
    return {**choice, "frames": frames}


def _parts(about: StoreAttributes, frames: int) -> list[dict[str, Any]]:
    """Return the parts of a store of so many frames: what was converted or appended at once."""
    whole = {
        "frames": frames,
        "dataset": about.dataset,
        "calibration": about.calibration["origin"],
        "tool_version": about.tool_version,
        "digest": about.source["digest"],
    }
    return about.source.get("parts", [whole])


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
