"""What becomes of frames that lack a file: bad, left out, or without that image."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from nimprep.errors import LayoutError
from nimprep.frame import IGNORE_LABEL
from nimprep.readers.base import OfficialSplit
from nimprep.readers.description import CONFIDENCE, Description, PlaneSource
from nimprep.readers.matching import Matched


def judged(
    root: Path, description: Description, matched: Matched, splits: Mapping[str, OfficialSplit]
) -> Matched:
    """Return the frames that there are, with those that are bad, and why.

    Parameters
    ----------
    splits : mapping of frame id to split
        Of the dataset's authors: where no frame of one has labels, these are 255 throughout.

    Raises
    ------
    LayoutError
        No frame is left, or an image can be none that cannot say so.
    """
    lacking: dict[str, str] = {}
    left_out: set[str] = set()
    notes: list[str] = []
    unlabelled = _unlabelled(description, matched, splits, notes)
    for name, source in description.sources():
        if name not in matched.places:
            continue
        lost = [i for i in matched.ids if i not in matched.places[name]]
        if source is description.label:
            lost = [i for i in lost if i not in unlabelled]
        elif name == CONFIDENCE:
            lost = [i for i in lost if i in matched.places["depth"]]
        elif source.missing == "split":
            none = _lacking_splits(matched.places[name], matched.ids, splits)
            if none:
                _check_none(root, description, name, source)
            lost = [i for i in lost if splits.get(i) not in none]
            notes += [f"none of the frames of split {split} has {name}" for split in sorted(none)]
        if source.missing in ("error", "split"):
            _add_lacking(root, description, matched, (name, source), lost, lacking)
        elif source.missing == "skip":
            left_out.update(lost)
        else:
            _check_none(root, description, name, source)
        if lost and source.missing not in ("error", "split"):
            what = "are left out: they have" if source.missing == "skip" else "have"
            notes.append(f"{len(lost)} of {len(matched.ids)} frames {what} no {name}")
    ids = tuple(i for i in matched.ids if i not in left_out)
    if not ids:
        reason = "; ".join(notes) or "its split leaves out all of them"
        raise LayoutError(f"{root}: expected frames, found none that has every image; {reason}")
    left = {i: message for i, message in lacking.items() if i not in left_out}
    return replace(matched, ids=ids, lacking=left, notes=(*matched.notes, *notes))


def _add_lacking(
    root: Path,
    description: Description,
    matched: Matched,
    kind: tuple[str, PlaneSource],
    lost: Collection[str],
    lacking: dict[str, str],
) -> None:
    """Add why the frames that lost a kind of image are bad, to those that are already."""
    name, source = kind
    for i in lost:
        # Paired in another way, its name does not follow from colour's.
        known = {} if description.match else {"id": i, **matched.captured[i]}
        path = _expected(source.files, known)
        told = f"{root / path}: expected {name} of frame {i!r}, found none"
        # The first is the one that ends a conversion, and looking costs.
        lacking.setdefault(i, told if lacking else told + _other_ending(root / path))


def _unlabelled(
    description: Description,
    matched: Matched,
    splits: Mapping[str, OfficialSplit],
    notes: list[str],
) -> Collection[str]:
    """Return the frames of the splits that have no labels at all, where others have."""
    if description.label is None or description.label.missing not in ("error", "split"):
        return ()
    labelled = matched.places.get("label", {})
    found: set[str] = set()
    # Those that found no partner in time are left out already.
    splits = {i: splits[i] for i in matched.ids if i in splits}
    for split in sorted(set(splits.values()) - {splits.get(i) for i in labelled}):
        those = [i for i, name in splits.items() if name == split]
        found.update(those)
        if labelled:
            notes.append(
                f"none of the {len(those)} frames of split {split} has labels: there they are "
                f"{IGNORE_LABEL} throughout"
            )
    return found if labelled else ()


def _lacking_splits(
    places: Collection[str], ids: Collection[str], splits: Mapping[str, OfficialSplit]
) -> set[OfficialSplit]:
    """Return the splits none of whose frames has an image, where frames of others have it."""
    lost = {splits[i] for i in ids if i in splits} - {splits[i] for i in places if i in splits}
    return lost if places else set()


def _expected(pattern: str, values: Mapping[str, str]) -> str:
    """Return a pattern with what is known of a frame, and a star for what is not."""
    return re.sub(r"\{(\w+)\}", lambda part: values.get(part[1], "*"), pattern)


def _other_ending(path: Path) -> str:
    """Return what to say where a file is there but for its ending."""
    beside = path.parent.iterdir() if path.parent.is_dir() else ()
    other = min((p.name for p in beside if p.stem == path.stem), default=None)
    return f" but {other!r}; an ending .* in the pattern takes each" if other else ""


def _check_none(root: Path, description: Description, name: str, source: PlaneSource) -> None:
    """Raise `LayoutError` where a kind of image cannot say that there is none."""
    if source is description.rgb:
        raise LayoutError(
            f'{root}: expected "missing" of rgb to be "error" or "skip", found "none"; every '
            "frame has colour"
        )
    if name in description.planes and description.planes[name].fill is None:
        raise LayoutError(
            f'{root}: expected "fill" of the plane {name!r} with "missing": "none", found none; '
            "say which stored number means none"
        )
