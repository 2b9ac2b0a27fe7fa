"""What looks wrong in a store, from its statistics: each kind of doubt with the frames it is of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from nimprep.doubts.findings import TITLES as FOUND
from nimprep.doubts.judge import TITLES
from nimprep.report.collect import Collected
from nimprep.report.hashes import BITS, NEAR, nearest
from nimprep.report.pictures import BACKGROUND
from nimprep.splits import SPLIT_CODES, SPLIT_NAMES, are_categories
from nimprep.store.depth_loss import loss_text
from nimprep.store.reader import Store
from nimprep.store.statistics import ROWS

FEW_VALID = 0.5
"""A frame has few valid pixels below this share of what the store's median frame has."""

SPARSE = 0.02
"""And, whatever the others have, below this share of its pixels."""

SATURATED = 0.01
"""Depth is saturated where so many of a frame's valid pixels have the store's greatest depth."""

MUCH_LOST = 0.001
"""The share of the depth that may lie beyond what the store's unit can say."""

FLAT = 2.0
"""A colour image whose standard deviation, 0 to 255, is below this shows nothing."""


@dataclass(frozen=True)
class Finding:
    """Say one thing that looks wrong.

    Attributes
    ----------
    kind : str
        Stable name.
    severity : {"problem", "look"}
        What spoils results, or what may be as it should be and deserves a look.
    title : str
        In a few words.
    text : str
        What was found and by which measure.
    frames : tuple of int
        Numbers of the frames concerned, ascending; empty = the whole store.
    pairs : tuple of (int, int)
        Frames that belong together, where it is about pairs.
    """

    kind: str
    severity: str
    title: str
    text: str
    frames: tuple[int, ...] = ()
    pairs: tuple[tuple[int, int], ...] = field(default=())


def find(store: Store, facts: Collected) -> list[Finding]:
    """Return everything that looks wrong, problems first."""
    found = [
        *_doubted(store),
        *_left_out(store),
        *_shared_scenes(store),
        *_duplicates(store, facts),
        *_depth(store, facts),
        *_labels(store, facts),
        *_flat(store),
    ]
    return sorted(found, key=lambda f: f.severity != "problem")


def checks(store: Store) -> list[str]:
    """Return what `find` looks for in this store, in words."""
    named = ["signs of a wrong reading, of noise and of saturation", "frames left out"]
    named += [] if _of_categories(store) else ["train and test frames of one scene"]
    if "rgb" in store.modalities:
        named += ["near-duplicates across splits", "flat colour images"]
    if "depth" in store.modalities:
        named += ["frames with few valid pixels", "saturated or lost depth"]
    if "label" in store.modalities:
        named += ["frames and splits without a class", "labels of no class"]
    return named


def _of_categories(store: Store) -> bool:
    return are_categories(store.about.dataset, str(store.about.split["rule"]))


def _numbers(mask: npt.NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.flatnonzero(mask))


def counted(number: int, what: str = "frame") -> str:
    """Return "1 frame", "2 frames"."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def _doubted(store: Store) -> Iterator[Finding]:
    """Yield what was doubted when the frames were converted, and what was found in them."""
    about = store.about
    said = [(d, f"doubt-{d['kind']}", "Perhaps read wrongly") for d in about.doubts]
    said += [(d, f"found-{d['kind']}", "Less than it seems") for d in about.findings]
    for doubt, kind, title in said:
        named = frozenset(doubt["frames"])
        yield Finding(
            kind,
            "problem",
            (TITLES | FOUND).get(doubt["kind"], title),
            f"{counted(doubt['count'])}: {doubt['text']}.",
            tuple(n for n, i in enumerate(store.ids) if i in named),
        )


def _left_out(store: Store) -> Iterator[Finding]:
    """Yield what the conversion left out because it was bad."""
    skipped = store.about.skipped
    if skipped:
        named = "; ".join(f"{entry['id']} ({entry['reason']})" for entry in skipped[:5])
        more = f"; and {len(skipped) - 5} more" if len(skipped) > 5 else ""
        yield Finding(
            "left-out",
            "look",
            "Frames left out",
            f"{counted(len(skipped))} of the source not converted: {named}{more}.",
        )


def _shared_scenes(store: Store) -> Iterator[Finding]:
    """Yield scenes in train and in val or test; less of a doubt where the authors split so."""
    if _of_categories(store):
        return
    of_scene: dict[str, set[int]] = {}
    for group, code in zip(store.tables.group, store.tables.split, strict=True):
        if group:
            of_scene.setdefault(group, set()).add(int(code))
    train = SPLIT_CODES["train"]
    for name, severity in (("test", "problem"), ("val", "look")):
        if name in store.about.fixed_splits:
            severity = "look"
        shared = {g for g, codes in of_scene.items() if {train, SPLIT_CODES[name]} <= codes}
        if shared:
            mask = np.array([g in shared for g in store.tables.group])
            listed = ", ".join(sorted(shared)[:5]) + (" …" if len(shared) > 5 else "")
            yield Finding(
                f"shared-scene-{name}",
                severity,
                f"Train and {name} share scenes",
                f"{len(shared)} of {counted(len(of_scene), 'scene')} have frames in train and in "
                f"{name}: {listed}. Scores on {name} may then tell of memory; "
                "nimprep split --split-by group keeps scenes together.",
                _numbers(mask),
            )


def _duplicates(store: Store, facts: Collected) -> Iterator[Finding]:
    """Yield frames of val and test whose picture is nearly one of train, and test one of val."""
    if "rgb" not in store.modalities:
        return
    seen = facts.hashes.any(axis=1)
    for one, other in (("test", "train"), ("val", "train"), ("test", "val")):
        queries, others = (
            np.flatnonzero((store.tables.split == SPLIT_CODES[name]) & seen)
            for name in (one, other)
        )
        if not queries.size or not others.size:
            continue
        index, distance = nearest(facts.hashes[queries], facts.hashes[others])
        near = distance <= NEAR
        pairs = sorted(
            (int(q), int(o)) for q, o in zip(queries[near], others[index[near]], strict=True)
        )
        if pairs:
            yield Finding(
                f"near-duplicate-{one}-{other}",
                "problem" if other == "train" and one == "test" else "look",
                f"Near-duplicates in {one} and {other}",
                f"{counted(len(pairs))} of {one} looks nearly like one of {other} "
                f"(perceptual hashes that differ in at most {NEAR} of {BITS} bits)."
                if len(pairs) == 1
                else f"{counted(len(pairs))} of {one} look nearly like one of {other} "
                f"(perceptual hashes that differ in at most {NEAR} of {BITS} bits).",
                tuple(sorted({i for pair in pairs for i in pair})),
                tuple(pairs),
            )


def _depth(store: Store, facts: Collected) -> Iterator[Finding]:
    if "depth" not in store.modalities:
        return
    share = facts.valid / facts.pixels
    limit = max(SPARSE, FEW_VALID * float(np.median(share)))
    few = share < limit
    if few.any():
        yield Finding(
            "few-valid",
            "problem",
            "Few pixels with depth",
            f"{counted(int(few.sum()))} with depth in less than {limit:.1%} of the pixels "
            f"(the median frame has {float(np.median(share)):.1%}).",
            _numbers(few),
        )
    yield from _depth_lost(store)
    greatest = int(facts.farthest.max())
    at_end = facts.farthest == greatest
    # One pixel is the farthest of any frame, however few there are.
    saturated = at_end & (facts.at_farthest >= np.maximum(SATURATED * facts.valid, 2))
    if greatest and saturated.any():
        yield Finding(
            "saturated",
            "look",
            "Depth saturated",
            f"{counted(int(saturated.sum()))} with at least {SATURATED:.0%} of the depth at "
            f"exactly {facts.depth.number_of(greatest):g} m, the greatest of the store: a "
            "sensor's limit, perhaps, rather than a distance.",
            _numbers(saturated),
        )


def _depth_lost(store: Store) -> Iterator[Finding]:
    """Yield what the store's unit of depth could not say."""
    lost = store.about.depth_lost
    if lost is not None:
        severity = "problem" if lost["share"] >= MUCH_LOST else "look"
        text = loss_text(lost)
        yield Finding("depth-lost", severity, "Depth lost", f"{text[0].upper()}{text[1:]}.")


def _labels(store: Store, facts: Collected) -> Iterator[Finding]:
    if "label" not in store.modalities:
        return
    yield from _unlabelled(store, facts)
    labelled = facts.classes.sum(axis=1) > 0
    for column, entry in enumerate(store.classes):
        has = facts.classes[:, column] > 0
        for name, code in SPLIT_CODES.items():
            members = (store.tables.split == code) & labelled
            if members.any() and not has[members].any():
                yield Finding(
                    f"class-{entry.id}-not-in-{name}",
                    "problem",
                    f"No {entry.name} in {name}",
                    f"No pixel of the {counted(int(members.sum()), 'labelled frame')} "
                    f"of {name} is labelled {entry.name}.",
                    _numbers(members),
                )
        lacking = labelled & ~has
        if entry.id != BACKGROUND and lacking.any() and has.any():
            yield Finding(
                f"without-class-{entry.id}",
                "look",
                f"Frames without {entry.name}",
                f"{counted(int(lacking.sum()))} of {counted(int(labelled.sum()), 'labelled frame')}"
                f" without a pixel labelled {entry.name}.",
                _numbers(lacking),
            )
    if facts.undeclared.any():
        yield Finding(
            "undeclared-class",
            "problem",
            "Labels of no class",
            f"{counted(int((facts.undeclared > 0).sum()))} with "
            f"{counted(int(facts.undeclared.sum()), 'pixel')} of an id that no class has.",
            _numbers(facts.undeclared > 0),
        )


def _unlabelled(store: Store, facts: Collected) -> Iterator[Finding]:
    """Yield frames in which every pixel is ignored; a benchmark's test split may well be so."""
    empty = (facts.classes.sum(axis=1) + facts.undeclared) == 0
    if not empty.any():
        return
    codes = Counter(int(c) for c in store.tables.split[empty])
    where = ", ".join(f"{n} in {SPLIT_NAMES.get(code, 'none')}" for code, n in codes.items())
    only_test = set(codes) == {SPLIT_CODES["test"]}
    yield Finding(
        "unlabelled",
        "look" if only_test else "problem",
        "Frames without any label",
        f"{counted(int(empty.sum()))} in which every pixel is ignored: {where}.",
        _numbers(empty),
    )


def _flat(store: Store) -> Iterator[Finding]:
    """Yield frames whose colour image is one flat colour, from the stored sums."""
    if "rgb" not in store.modalities:
        return
    sums = store.tables.channel_sums[:, ROWS["rgb"]].astype(np.float64)
    number, total, squares = np.moveaxis(sums, 2, 0)
    number = np.maximum(number, 1)
    deviation = np.sqrt(np.maximum(squares / number - (total / number) ** 2, 0)).max(axis=1)
    flat = deviation < FLAT
    if flat.any():
        yield Finding(
            "flat",
            "problem",
            "Colour images that show nothing",
            f"{counted(int(flat.sum()))} of one flat colour (standard deviation below {FLAT:g} "
            "of 255).",
            _numbers(flat),
        )
