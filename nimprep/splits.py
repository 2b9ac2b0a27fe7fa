"""Who is train, val and test: pure functions over frame ids."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from nimprep.errors import SplitError
from nimprep.files import write_whole
from nimprep.schema import check_json, json_bytes, read_json

SplitName = Literal["train", "val", "test"]

SPLIT_CODES: dict[str, int] = {"train": 0, "val": 1, "test": 2, "none": 255}
"""How a store's `split` array writes each split."""

SplitRule = Literal["frame", "group", "stratified", "eighth"]

SPLIT_RULES: tuple[SplitRule, ...] = get_args(SplitRule)
"""By frame; by whole scenes; by frame within each scene; an eighth of each scene for val."""

LEAST_GROUPS = 3
"""So many scenes are needed for three splits of whole ones."""

SPLITS: dict[str, SplitName] = {"train": "train", "val": "val", "test": "test"}

SPLIT_NAMES: dict[int, str] = {code: name for name, code in SPLIT_CODES.items()}

_OF_CATEGORIES = frozenset({"kitti-road"})
"""Datasets whose groups are kinds of place, which each split is to have, and not scenes."""


def are_categories(dataset: str, rule: str) -> bool:
    """Return whether a dataset's groups are categories, which may stand in several splits."""
    return rule == "eighth" or dataset in _OF_CATEGORIES


def check_scenes(dataset: str, rule: str, groups: Iterable[str]) -> None:
    """Raise `SplitError` where whole scenes are to be split, and groups are categories."""
    if rule == "group" and dataset in _OF_CATEGORIES:
        known = ", ".join(sorted({*groups} - {""}))
        raise SplitError(
            f"split by group: expected scenes, found that {known} are categories of {dataset}, "
            "which each split is to have; use --split-by eighth, stratified or frame"
        )


def held_out_count(total: int) -> int:
    """Return the size of val, and of test: min(ceil(0.15 N), floor(N / 3))."""
    return min(math.ceil(15 * total / 100), total // 3)


def _held_out(total: int, rule: SplitRule) -> tuple[int, int]:
    """Return the sizes of val and test in so many frames, or so many of a scene."""
    if rule == "eighth":
        return min(max((total + 4) // 8, 1), total // 3), 0
    return held_out_count(total), held_out_count(total)


def hash_order(names: Iterable[str], seed: int = 0) -> list[str]:
    """Order names by SHA-256 of "{seed}:{name}": the same on every machine and in any version."""
    return sorted(names, key=lambda name: hashlib.sha256(f"{seed}:{name}".encode()).digest())


def split_by_frame(ids: Sequence[str], seed: int = 0) -> dict[str, SplitName]:
    """Split frames in hash order: val first, then as many for test, the rest train.

    3896 frames give 2726 train, 585 val and 585 test, GMRP's own sizes (Wang et al., IROS 2020).
    """
    return _split_frames(ids, seed, "frame")


def _split_frames(ids: Sequence[str], seed: int, rule: SplitRule) -> dict[str, SplitName]:
    val, test = _held_out(len(ids), rule)
    ordered = hash_order(ids, seed)
    held: dict[str, SplitName] = dict.fromkeys(ordered[:val], "val")
    held |= dict.fromkeys(ordered[val : val + test], "test")
    return {i: held.get(i, "train") for i in ids}


def split_by_group(groups: Mapping[str, str], seed: int = 0) -> dict[str, SplitName]:
    """Split whole scenes, so that no scene has frames in two splits.

    Scenes are taken in hash order, for val and then for test, as long as each brings the split
    nearer to the number of frames the default rule gives it (at least one scene each); one scene
    at least is left for train.

    Parameters
    ----------
    groups : mapping of frame id to scene

    Raises
    ------
    SplitError
        A frame has no scene, or there are fewer than three scenes.
    """
    _check_named(groups)
    sizes = Counter(groups.values())
    if len(sizes) < LEAST_GROUPS:
        raise SplitError(
            f"split by group: expected at least {LEAST_GROUPS} groups, found {len(sizes)}; "
            "split by frame"
        )
    chosen = _choose_scenes(sizes, {}, held_out_count(len(groups)), seed)
    return {i: chosen[group] for i, group in groups.items()}


def _check_named(groups: Mapping[str, str]) -> None:
    nameless = [i for i, group in groups.items() if not group]
    if nameless:
        raise SplitError(
            f"{nameless[0]}: expected a group to split by, found none "
            f"({len(nameless)} of {len(groups)} frames); split by frame or use a split file"
        )


def _choose_scenes(
    sizes: Mapping[str, int], known: Mapping[str, SplitName], target: int, seed: int
) -> dict[str, SplitName]:
    """Return the split of every scene; those that are known keep theirs."""
    chosen = dict(known)
    frames: Counter[SplitName] = Counter()
    for scene, split in known.items():
        frames[split] += sizes[scene]
    queue = hash_order(sizes.keys() - known.keys(), seed)
    order: tuple[tuple[SplitName, tuple[SplitName, ...]], ...] = (
        ("val", ("test", "train")),
        ("test", ("train",)),
    )
    for name, later in order:
        # What stays in the queue must do for those of the splits still to come that have none.
        needed = sum(not frames[split] for split in later)
        while len(queue) > needed:
            after = frames[name] + sizes[queue[0]]
            if frames[name] and abs(after - target) >= abs(frames[name] - target):
                break
            chosen[queue.pop(0)] = name
            frames[name] = after
    return chosen | dict.fromkeys(queue, "train")


def assign_splits(
    groups: Mapping[str, str],
    rule: SplitRule = "frame",
    seed: int = 0,
    fixed: Mapping[str, SplitName] | None = None,
) -> dict[str, SplitName]:
    """Give every frame its split.

    Parameters
    ----------
    groups : mapping of frame id to scene
        Every frame, in order.
    rule : {"frame", "group", "stratified", "eighth"}
        By frame; by whole scenes; by frame within each scene, so that each split holds the same
        share of every scene; or so with an eighth of each scene, to the nearest frame, for val and
        none for test (KITTI road's categories: 253 of its 289 frames for train, 36 for val, as is
        usual in the field; its test frames are fixed).
    seed : int
        Another seed gives another order.
    fixed : mapping of frame id to split, optional
        Frames whose split the dataset's authors chose. Where some are fixed as test, the others
        are split into train and val only.

    Raises
    ------
    SplitError
        There is no such rule, or it does not fit the frames.
    """
    if rule not in SPLIT_RULES:
        raise SplitError(f"split rule: expected one of {', '.join(SPLIT_RULES)}, found {rule!r}")
    fixed = dict(fixed or {})
    free = {i: group for i, group in groups.items() if i not in fixed}
    if rule == "group":
        chosen = split_by_group(free, seed) if free else {}
    else:
        chosen = {}
        for members in _strata(free, rule):
            chosen.update(_split_frames(members, seed, rule))
    if "test" in fixed.values():
        chosen = {i: "train" if split == "test" else split for i, split in chosen.items()}
    return {i: fixed.get(i) or chosen[i] for i in groups}


def _strata(groups: Mapping[str, str], rule: SplitRule) -> Iterable[list[str]]:
    """Return the frames that are split by themselves: each scene's, or all."""
    strata: dict[str, list[str]] = {}
    for i, group in groups.items():
        strata.setdefault("" if rule == "frame" else group, []).append(i)
    return strata.values()


def extend_splits(
    groups: Mapping[str, str],
    known: Mapping[str, str],
    rule: SplitRule | Literal["file"] = "frame",
    seed: int = 0,
    fixed: Mapping[str, SplitName] | None = None,
) -> dict[str, str]:
    """Give frames that join a dataset their split by its rule; the others keep theirs.

    By frame, val and test are to have as many of all frames together as the rule gives them: in
    hash order, new frames go to val until it has, then to test, the rest to train. Stratified and
    by eighths, the same holds within each scene. By group, a new frame of a known scene goes where
    its scene is; new scenes in hash order go to val, then test, as long as each brings it nearer to
    that number. Where nothing is known this is `assign_splits`.

    Parameters
    ----------
    groups : mapping of frame id to scene
        Every frame, known and new, in order.
    known : mapping of frame id to split
        The frames that have one already.
    rule : {"frame", "group", "stratified", "eighth", "file"}
        "file" = a split file chose; new frames get "none".
    seed : int
        The one the known frames were split with.
    fixed : mapping of frame id to split, optional
        As for `assign_splits`, known frames included.

    Returns
    -------
    dict of frame id to split
        Every frame, in order.

    Raises
    ------
    SplitError
        There is no such rule, or a new frame has no scene to go by.
    """
    if rule == "file":
        return {i: known.get(i, "none") for i in groups}
    if not known:
        return dict(assign_splits(groups, rule, seed, fixed))
    if rule not in SPLIT_RULES:
        raise SplitError(f"split rule: expected one of {', '.join(SPLIT_RULES)}, found {rule!r}")
    fixed = dict(fixed or {})
    free = {i: group for i, group in groups.items() if i not in fixed}
    chosen: dict[str, str] = {}
    if rule == "group":
        chosen = _extend_scenes(free, known, seed)
    else:
        for members in _strata(free, rule):
            chosen.update(_extend_frames(members, known, seed, rule))
    if "test" in fixed.values():
        chosen = {i: "train" if split == "test" else split for i, split in chosen.items()}
    return {i: known.get(i) or fixed.get(i) or chosen[i] for i in groups}


def _extend_frames(
    ids: Sequence[str], known: Mapping[str, str], seed: int, rule: SplitRule
) -> dict[str, str]:
    there = Counter(known[i] for i in ids if i in known)
    targets = zip(_held_out(len(ids), rule), ("val", "test"), strict=True)
    val, test = (max(0, target - there[name]) for target, name in targets)
    new = hash_order((i for i in ids if i not in known), seed)
    splits = dict.fromkeys(new, "train")
    splits |= dict.fromkeys(new[:val], "val") | dict.fromkeys(new[val : val + test], "test")
    return splits


def _extend_scenes(
    groups: Mapping[str, str], known: Mapping[str, str], seed: int
) -> dict[str, str]:
    _check_named({i: group for i, group in groups.items() if i not in known})
    scenes = {group: SPLITS[known[i]] for i, group in groups.items() if known.get(i) in SPLITS}
    sizes = Counter(groups.values())
    chosen = _choose_scenes(sizes, scenes, held_out_count(len(groups)), seed)
    return {i: chosen[group] for i, group in groups.items()}


def count_splits(splits: Iterable[str]) -> dict[str, int]:
    """Count frames per split: train, val and test always, none where there are any."""
    counts = Counter(splits)
    names = [name for name in SPLIT_CODES if name != "none" or counts["none"]]
    return {name: counts[name] for name in names}


def splits_from_file(path: Path | str, ids: Sequence[str]) -> dict[str, str]:
    """Read a split file (schemas/split.schema.json) for these frames.

    Frames that the file does not name get "none".

    Raises
    ------
    SplitError
        The file is not a split file, names a frame twice or one that is not there.
    """
    document = read_json(Path(path), SplitError)
    check_json(document, "split", str(path), SplitError)
    splits = dict.fromkeys(ids, "none")
    named: set[str] = set()
    for name in ("train", "val", "test"):
        for frame_id in document[name]:
            if frame_id not in splits:
                raise SplitError(
                    f"{path}: expected ids of the dataset's {len(ids)} frames, "
                    f"found {frame_id!r} in {name!r}; check the file belongs to this dataset"
                )
            if frame_id in named:
                raise SplitError(f"{path}: expected each frame once, found {frame_id!r} twice")
            named.add(frame_id)
            splits[frame_id] = name
    return splits


def split_document(splits: Mapping[str, str]) -> dict[str, Any]:
    """Return what a split file holds for these frames, ids in order."""
    document: dict[str, Any] = {"format": "nimprep-split", "version": "1.0"}
    for name in ("train", "val", "test"):
        document[name] = [i for i, split in splits.items() if split == name]
    return document


def write_split_file(
    path: Path | str, splits: Mapping[str, str], *sources: Path, overwrite: bool = False
) -> None:
    """Write the splits as JSON that `splits_from_file` reads back.

    Parameters
    ----------
    *sources : Path
        Where it must not be written.
    overwrite : bool
        Replace a file that is there already; without, it is an error.

    Raises
    ------
    SplitError
        The file cannot be written, or must not be.
    """
    data = json_bytes(split_document(splits))
    write_whole(Path(path), data, *sources, overwrite=overwrite, error=SplitError)
