"""The checks that look at every pixel of a store."""

from __future__ import annotations

import math
from contextlib import closing
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.modalities import derive, fill_frame
from nimprep.derive.recipe import DERIVED, recipe_from
from nimprep.errors import NimprepError
from nimprep.frame import IGNORE_LABEL, MAX_PIXELS, ON_REQUEST, Frame
from nimprep.modality import MODALITIES
from nimprep.parallel import Progress, available_cores, map_in_order, no_progress
from nimprep.store.frames import depth_from_millimetres, to_integers
from nimprep.store.reader import Store
from nimprep.store.statistics import channel_sums

if TYPE_CHECKING:
    from nimprep.store.validate import Report

SAMPLE = 16
"""Derived modalities are made again on at most as many frames, spread over the store."""


def check_pixels(
    store: Store,
    report: Report,
    progress: Progress | None,
) -> None:
    """Decode every chunk and check what it holds."""
    done = (progress or no_progress)("checking", len(store))
    step = -(-len(store) // SAMPLE)

    def check(number: int) -> list[str]:
        found = _frame_problems(store, number, recompute=number % step == 0)
        done()
        return found

    pixels = max(math.prod(array.shape[1:3]) for array in store.arrays.values())
    # The largest frames there can be take gigabytes each: no more of them than one at a time.
    threads = min(available_cores(), max(1, MAX_PIXELS // pixels))
    with closing(map_in_order(check, range(len(store)), threads)) as found:
        for number, problems in enumerate(found):
            for problem in problems:
                report.add(f"frame {number} ({store.ids[number]!r}): {problem}")
            if report.full:
                return
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
    if not np.array_equal(channel_sums(images), store.tables.channel_sums[number]):
        problems.append("channel_sums: expected the images' sums, found others")
    if "label" in images:
        problems += _label_problems(store, images["label"])
    if "hha" in images and "depth" in images:
        problems += _hha_problems(store, number, images)
    if "normal" in images:
        recipe = recipe_from(store.attributes["modalities"])
        filled = recipe.fill != "none" and not recipe.store_filled
        problems += _normal_problems(images["normal"], images.get("depth"), filled=filled)
    problems += _plane_problems(store, images)
    if recompute and "depth" in images:
        problems += _recomputed_problems(store, number, images)
    return problems


def _label_problems(store: Store, label: npt.NDArray[np.uint8]) -> list[str]:
    known = [*(c.id for c in store.classes), IGNORE_LABEL]
    values = np.flatnonzero(np.bincount(label.reshape(-1), minlength=256))
    unknown = [int(v) for v in values if v not in known]
    return [f"label: expected {known}, found {unknown}"] if unknown else []


def _hha_problems(store: Store, number: int, images: dict[str, npt.NDArray[Any]]) -> list[str]:
    gravity = store.tables.gravity[number]
    # Squares of the largest numbers there are would be infinite.
    if not (np.abs(gravity) < 2).all() or not np.isclose(np.linalg.norm(gravity), 1):
        return [f"gravity: expected a unit vector beside HHA, found {gravity.tolist()}"]
    some = images["hha"].any(axis=2)
    # HHA of filled depth is there in its holes too.
    wrong = int(((images["depth"] > 0) & ~some).sum())
    return [f"hha: expected a value where depth is, found {wrong} pixels without"] if wrong else []


def _normal_problems(
    normal: npt.NDArray[Any], depth: npt.NDArray[np.uint16] | None, *, filled: bool
) -> list[str]:
    problems = []
    square = np.einsum("hwc,hwc->hw", normal, normal, dtype=np.float64)
    some = square > 0
    scale = MODALITIES["normal"].as_dtype(str(normal.dtype)).steps
    # Rounding moves each component by half a step at most, so the length by sqrt(3) / 2.
    off = np.abs(np.sqrt(square) - scale) > np.sqrt(3) / 2 + 1e-6
    if (off & some).any():
        problems.append(f"normal: expected unit vectors, found {int((off & some).sum())} others")
    if depth is not None:
        # Normals of filled depth are there in its holes too.
        wrong = (depth > 0) & ~some if filled else (depth > 0) != some
        if wrong.any():
            problems.append(
                f"normal: expected one exactly where depth is, found {int(wrong.sum())} pixels "
                "not so"
            )
    return problems


def _plane_problems(store: Store, images: dict[str, npt.NDArray[Any]]) -> list[str]:
    """Check that disparity and what is made of it are where depth is, or nowhere without a road."""
    if "depth" not in images:
        return []
    recipe = recipe_from(store.attributes["modalities"])
    filled = recipe.fill != "none" and not recipe.store_filled
    problems = []
    for name in ON_REQUEST:
        if name not in images:
            continue
        some, depth = images[name] != MODALITIES[name].fill, images["depth"] > 0
        wrong = depth & ~some if filled else depth != some
        if wrong.any() and (name == "disparity" or some.any()):
            problems.append(
                f"{name}: expected a value exactly where depth is, "
                f"found {int(wrong.sum())} pixels not so"
            )
    return problems


def _recomputed_problems(
    store: Store, number: int, images: dict[str, npt.NDArray[Any]]
) -> list[str]:
    """Make the derived modalities again from depth and compare; one step of rounding may differ."""
    recipe = recipe_from(store.attributes["modalities"])
    frame = Frame(
        id=store.ids[number],
        camera=store.camera(number),
        rgb=images.get("rgb"),
        depth_m=depth_from_millimetres(images["depth"]),
        baseline_m=float(store.tables.baseline[number]),
        cam_to_road=store.cam_to_road(number),
    )
    missing = None
    wanted = [name for name in images if name in DERIVED]
    if recipe.store_filled:
        # Which pixels were filled is not stored, and HHA depends on it.
        wanted = [name for name in wanted if name != "hha"]
    elif recipe.fill == "colorization" and frame.rgb is None:
        return []
    else:
        frame, missing = fill_frame(frame, recipe)
    try:
        derived = derive(frame, missing, wanted, recipe)
    except NimprepError as error:
        return [f"recomputation: {error}"]
    problems = []
    for name, again in derived.images.items():
        again = to_integers(store.arrays[name].modality, again)
        apart = np.abs(again.astype(np.int32) - images[name]) > 1
        apart = apart.any(axis=2) if apart.ndim == 3 else apart
        if apart.any():
            method = store.attributes["modalities"][name]["method"]
            problems.append(
                f"{name}: expected what {method!r} makes of the depth, "
                f"found {int(apart.sum())} pixels apart"
            )
    if "hha" in wanted and not np.allclose(derived.gravity, store.tables.gravity[number]):
        problems.append(
            f"gravity: expected {derived.gravity}, found {store.tables.gravity[number]}"
        )
    return problems
