"""The checks that look at every pixel of a store."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.modalities import DERIVED, Recipe, derive
from nimprep.errors import NimprepError
from nimprep.frame import IGNORE_LABEL, Frame
from nimprep.store.frames import depth_from_millimetres, normals_to_integers
from nimprep.store.reader import Store
from nimprep.store.spec import NORMAL_SCALES

if TYPE_CHECKING:
    from nimprep.store.validate import Report

SAMPLE = 16
"""Derived modalities are made again on at most as many frames, spread over the store."""


def check_pixels(
    store: Store,
    report: Report,
    progress: Callable[[str, int], Callable[[], None]] | None,
) -> None:
    """Decode every chunk and check what it holds."""
    done = progress("checking", len(store)) if progress else lambda: None
    step = -(-len(store) // SAMPLE)

    def check(number: int) -> list[str]:
        found = _frame_problems(store, number, recompute=number % step == 0)
        done()
        return found

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for number, problems in enumerate(pool.map(check, range(len(store)))):
            for problem in problems:
                report.add(f"frame {number} ({store.ids[number]!r}): {problem}")
    report.count("chunks", len(store) * len(store.modalities))
    if set(DERIVED) & set(store.modalities) and "depth" in store.modalities:
        report.count("frames recomputed", len(range(0, len(store), step)))


def _frame_problems(store: Store, number: int, *, recompute: bool) -> list[str]:
    images: dict[str, npt.NDArray[Any]] = {}
    problems = []
    for name, array in store.arrays.items():
        try:
            images[name] = array.read(number)
        except NimprepError as error:
            problems.append(f"{name}: {error}")
    if problems:
        return problems
    height, width = store.camera(number).shape
    for name, image in images.items():
        fill = store.arrays[name].spec.fill
        if (image[height:] != fill).any() or (image[:, width:] != fill).any():
            problems.append(f"{name}: expected padding of {fill}, found other values")
        images[name] = np.ascontiguousarray(image[:height, :width])
    if "label" in images:
        problems += _label_problems(store, images["label"])
    if "normal" in images:
        problems += _normal_problems(images["normal"], images.get("depth"))
    if recompute and not problems and "depth" in images:
        problems += _recomputed_problems(store, number, images)
    return problems


def _label_problems(store: Store, label: npt.NDArray[np.uint8]) -> list[str]:
    known = [*(c.id for c in store.classes), IGNORE_LABEL]
    values = np.flatnonzero(np.bincount(label.reshape(-1), minlength=256))
    unknown = [int(v) for v in values if v not in known]
    return [f"label: expected {known}, found {unknown}"] if unknown else []


def _normal_problems(normal: npt.NDArray[Any], depth: npt.NDArray[np.uint16] | None) -> list[str]:
    problems = []
    square = np.einsum("hwc,hwc->hw", normal, normal, dtype=np.float64)
    some = square > 0
    scale = NORMAL_SCALES[str(normal.dtype)]
    # Rounding moves each component by half a step at most, so the length by sqrt(3) / 2.
    off = np.abs(np.sqrt(square) - scale) > np.sqrt(3) / 2 + 1e-6
    if (off & some).any():
        problems.append(f"normal: expected unit vectors, found {int((off & some).sum())} others")
    if depth is not None and ((depth > 0) != some).any():
        wrong = int(((depth > 0) != some).sum())
        problems.append(f"normal: expected one exactly where depth is, found {wrong} pixels not so")
    return problems


def recipe_of(store: Store) -> Recipe:
    """Return how a store says its derived modalities were made."""
    made = store.attributes["modalities"]
    if "normal" not in made:
        return Recipe()
    normal = made["normal"]
    return Recipe(
        normals=normal["method"], sign_filter=bool(normal["parameters"].get("sign_filter", False))
    )


def _recomputed_problems(
    store: Store, number: int, images: dict[str, npt.NDArray[Any]]
) -> list[str]:
    """Make the derived modalities again from depth and compare; one step of rounding may differ."""
    depth_m = depth_from_millimetres(images["depth"])
    frame = Frame(id=store.ids[number], camera=store.camera(number), depth_m=depth_m)
    try:
        derived = derive(frame, tuple(images), recipe_of(store))
    except NimprepError as error:
        return [f"recomputation: {error}"]
    problems = []
    if "normal" in derived:
        again = normals_to_integers(derived["normal"], str(images["normal"].dtype))
        apart = np.abs(again.astype(np.int32) - images["normal"]).max(axis=2) > 1
        if apart.any():
            problems.append(
                f"normal: expected what {store.attributes['modalities']['normal']['method']!r} "
                f"makes of the depth, found {int(apart.sum())} pixels apart"
            )
    return problems
