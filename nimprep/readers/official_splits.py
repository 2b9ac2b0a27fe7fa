"""The split that a dataset's authors chose, as folders' names or list files say it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from nimprep.errors import LayoutError, SplitError
from nimprep.readers.base import OfficialSplit
from nimprep.readers.description import Description, SplitSource
from nimprep.readers.matching import Matched, formatted
from nimprep.readers.patterns import placeholders
from nimprep.readers.split_lists import CALLED, FrameNames, listed_splits, lists_beside
from nimprep.readers.split_signs import split_note
from nimprep.readers.tree import found_files
from nimprep.splits import LEAST_GROUPS, SplitName


@dataclass(frozen=True)
class OfficialSplits:
    """Hold which frames the authors put into which split.

    Attributes
    ----------
    of_frame : mapping of frame id to split
        Frames that are not in it are free; those of "none" are in no split.
    skipped : frozenset of frame id
        Those to be left out.
    notes : tuple of str
        One line each: what was taken for a split.
    """

    of_frame: Mapping[str, OfficialSplit] = field(default_factory=dict)
    skipped: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()


def official_splits(
    root: Path, description: Description, matched: Matched, *, kept: bool = True
) -> OfficialSplits:
    """Return the split of the dataset's authors.

    Parameters
    ----------
    kept : bool
        Whether it will be kept; if not, what contradicts it is nothing to stop for.

    Raises
    ------
    LayoutError
        A list is missing or names what is no frame, or a frame is in no list or in several.
    """
    source = description.split
    if description.no_split:
        return OfficialSplits()
    if source is not None and source.of is not None:
        return _by_template(root, source, matched)
    if source is not None and source.frames is not None:
        return _by_frames(source.frames, matched)
    try:
        if source is not None:
            return _by_lists(root, source, matched)
        taken = _by_folders(root, matched) or _by_lists_found(root, matched)
        if taken.of_frame or taken.notes:
            return taken
        return OfficialSplits(notes=split_note(root, matched) if kept else ())
    except SplitError as error:
        if not kept and source is None:
            return OfficialSplits()
        way_out = "" if source else f"; {_WAY_OUT}"
        raise LayoutError(f"{error}{way_out}") from error


def _by_frames(frames: Mapping[str, SplitName], matched: Matched) -> OfficialSplits:
    """Return the splits that code knows; frames in none of them are said."""
    rest = sum(i not in frames for i in matched.ids)
    told = (f"{rest} of {len(matched.ids)} frames are in no official split",) if rest else ()
    none: OfficialSplit = "none"
    return OfficialSplits({i: frames.get(i, none) for i in matched.ids}, notes=told)


def without_labelled(splits: OfficialSplits, matched: Matched) -> OfficialSplits:
    """Return the splits that stay where another is asked for: those without labels alone."""
    if not splits.of_frame:
        return splits
    labelled = matched.places.get("label", {})
    there = {splits.of_frame.get(i) for i in labelled} or set(splits.of_frame.values())
    stay = {i: split for i, split in splits.of_frame.items() if split not in there}
    but = f", but for {counted(stay)} without labels" if stay else ""
    free = {split for i, split in splits.of_frame.items() if i not in stay}
    told = "; frames of its test may be in train" if "test" in free else ""
    note = (
        f"the official split ({counted(splits.of_frame)}) is not kept{but}, as another is given, "
        f"or is the store's{told}"
    )
    return OfficialSplits(stay, splits.skipped, (*splits.notes[: bool(splits.skipped)], note))


def whole_scenes(splits: OfficialSplits, group_of: Mapping[str, str]) -> OfficialSplits:
    """Return splits that keep a dataset's scenes whole where they are too few to be split.

    For one whose usual rule is by scene, and whose splits nobody chose. Frames of fewer than three
    scenes are all in train: their variations show the same places, and would be in train and test.
    """
    if len(set(group_of.values())) >= LEAST_GROUPS:
        return splits
    note = (
        f"fewer than {LEAST_GROUPS} scenes, which cannot be split as a whole: all frames are in "
        "train; --split-by frame splits them one by one, though those of a scene are alike"
    )
    everything: dict[str, OfficialSplit] = dict.fromkeys(group_of, "train")
    return replace(splits, of_frame=everything, notes=(*splits.notes, note))


_WAY_OUT = '"split": false in the description or --split-by to split anew'


def _by_template(root: Path, source: SplitSource, matched: Matched) -> OfficialSplits:
    """Return the splits that a template of placeholders names."""
    template, names = source.of or "", source.names
    found: dict[str, OfficialSplit] = {}
    skipped = set()
    for frame_id in matched.ids:
        values = matched.captured[frame_id]
        lost = [name for name in placeholders(template) if name not in values]
        if lost and frame_id not in matched.places["rgb"]:
            # A bad frame, without a colour image: its other files may say less.
            continue
        if lost:
            raise LayoutError(
                f"{root}: expected a split {template!r} of the placeholders of rgb's files, found "
                f"no {{{lost[0]}}} there; name it in their pattern"
            )
        called = formatted(template, values)
        split = CALLED.get(called.lower()) if names is None else names.get(called)
        if split is None:
            known = ", ".join(CALLED if names is None else names)
            raise LayoutError(
                f"{root}: expected a split called {known}, found {called!r} of frame "
                f'{frame_id!r}; say in "names" what it is, "skip" leaves those frames out'
            )
        if split == "skip":
            skipped.add(frame_id)
        else:
            found[frame_id] = split
    return OfficialSplits(found, frozenset(skipped), _skip_note(skipped, matched))


def _skip_note(skipped: Collection[str], matched: Matched) -> tuple[str, ...]:
    if not skipped:
        return ()
    return (
        f"{len(skipped)} of {len(matched.ids)} frames are left out, as their split is to be: first "
        f"{min(skipped)!r}",
    )


def _twice_note(frames: Sequence[str]) -> tuple[str, ...]:
    if not frames:
        return ()
    return (
        f"{len(frames)} frames are in the lists of several splits, first {frames[0]!r}: they are "
        "in the last of train, val and test",
    )


def _by_lists(root: Path, source: SplitSource, matched: Matched) -> OfficialSplits:
    """Return the splits that the description's lists name."""
    lists = []
    for called, files in source.lists.items():
        found = [(called, path) for path, _ in found_files(source.folder or root, files)]
        if not found:
            raise SplitError(
                f"{root}: expected lists {files!r} of {called}, found none; mend the pattern"
            )
        lists += found
    listed = listed_splits(lists, _names(root, matched), last=source.twice == "last")
    if listed.unknown:
        others = len(listed.unknown) - 1
        more = f", and {others} more lines are none" if others else ""
        raise SplitError(
            f"{listed.unknown[0]} is no frame's id or file{more}; mend the lists, or the patterns"
        )
    rest = [i for i in matched.ids if i not in listed.of_frame]
    if rest and source.rest == "error":
        raise SplitError(
            f"{root}: expected each frame in a list, found {len(rest)} of {len(matched.ids)} in "
            f'none, first {rest[0]!r}; say with "rest" in "split" what becomes of them, "skip" '
            "leaves them out"
        )
    notes = _twice_note(listed.twice)
    if source.rest == "skip" or source.rest == "error":
        notes += _skip_note(rest, matched)
        return OfficialSplits(listed.of_frame, frozenset(rest), notes)
    if source.rest == "none" and rest:
        notes += (f"{len(rest)} of {len(matched.ids)} frames are in none of its lists: no split",)
    every: dict[str, OfficialSplit] = {**listed.of_frame, **dict.fromkeys(rest, source.rest)}
    return OfficialSplits(every, notes=notes)


def _by_folders(root: Path, matched: Matched) -> OfficialSplits | None:
    """Return the splits that folders of colour images are called by; None = there are none."""
    folders = {
        i: place.path.relative_to(root).parts[:-1] for i, place in matched.places["rgb"].items()
    }
    best: dict[str, OfficialSplit] = {}
    for level in range(max(map(len, folders.values()))):
        called = {
            i: split
            for i, parts in folders.items()
            if len(parts) > level and (split := CALLED.get(parts[level].lower()))
        }
        there = set(called.values())
        if "train" in there and len(there) > 1 and len(called) > len(best):
            best = dict(called)
    # Where few are, folders of that name are scenes among others.
    if 2 * len(best) < len(folders):
        return None
    return _taken(best, matched, "folders")


def _by_lists_found(root: Path, matched: Matched) -> OfficialSplits:
    """Return the splits of lists in the dataset's folder that are called by them."""
    lists = lists_beside(root)
    there = {split for split, _ in lists}
    if "train" not in there or len(there) < 2:
        return OfficialSplits()
    listed = listed_splits(lists, _names(root, matched))
    named = " and ".join(path.name for _, path in lists)
    if not listed.of_frame:
        note = f"{named} name none of the frames, and are not taken for a split"
        return OfficialSplits(notes=(note,))
    taken = _taken({**listed.of_frame}, matched, f"the lists {named}")
    if not listed.unknown:
        return taken
    note = f"{len(listed.unknown)} lines of {named} name no frame, first {listed.unknown[0]}"
    return OfficialSplits(taken.of_frame, notes=(*taken.notes, note))


def _taken(splits: dict[str, OfficialSplit], matched: Matched, by: str) -> OfficialSplits:
    """Return splits that nobody said were some, with the note that says so."""
    rest = [i for i in matched.ids if i not in splits]
    none: dict[str, OfficialSplit] = dict.fromkeys(rest, "none")
    every = {**splits, **none}
    note = f"official split by {by}: {counted(every)}; {_WAY_OUT}"
    return OfficialSplits(every, notes=(note,))


def counted(splits: Mapping[str, str]) -> str:
    """Return how many frames there are of each split, for people."""
    counts = Counter(splits.values())
    named = ("train", "val", "test", "none")
    return ", ".join(
        f"{name} {counts[name]}" if name != "none" else f"{counts[name]} in none"
        for name in named
        if counts[name]
    )


def _names(root: Path, matched: Matched) -> FrameNames:
    return FrameNames(
        {
            i: [place.path.relative_to(root).as_posix() for place in matched.of(i).values()]
            for i in matched.ids
        }
    )
