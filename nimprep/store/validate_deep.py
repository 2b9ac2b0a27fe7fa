"""The checks that look at every pixel of a store."""

from __future__ import annotations

import math
from contextlib import closing
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.modalities import derive, fill_frame
from nimprep.derive.recipe import DERIVED, recipe_from
from nimprep.errors import ArrayError, CameraError, StoreError
from nimprep.frame import IGNORE_LABEL, MAX_PIXELS, Frame
from nimprep.modality import Modality
from nimprep.parallel import Progress, available_cores, map_in_order, no_progress
from nimprep.store.frames import from_integers, to_integers
from nimprep.store.problems import Report, fault_of
from nimprep.store.reader import Store
from nimprep.store.statistics import channel_sums, class_pixels

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
    # What was derived was made of finer depth, which the store has no longer.
    rounded = any(array.modality.rounded for array in store.arrays.values())

    def check(index: int) -> list[str]:
        found = _frame_problems(store, index, recompute=index % step == 0 and not rounded)
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
        what = "frames not recomputed, depth being rounded" if rounded else "frames recomputed"
        report.count(what, len(range(0, len(store), step)))


def _frame_problems(store: Store, index: int, *, recompute: bool) -> list[str]:
    images: dict[str, npt.NDArray[Any]] = {}
    problems = []
    for name, array in store.arrays.items():
        try:
            images[name] = array.read(index)
        except StoreError as error:
            problems.append(f"{name}: {fault_of(error)}")
    if problems:
        return problems
    height, width = store.camera(index).shape
    for name, image in images.items():
        fill = store.arrays[name].spec.fill
        if (image[height:] != fill).any() or (image[:, width:] != fill).any():
            problems.append(f"{name}: expected padding of {fill}, found other values")
        images[name] = np.ascontiguousarray(image[:height, :width])
    if not np.array_equal(channel_sums(images, store.planes), store.tables.channel_sums[index]):
        problems.append("channel_sums: expected the images' sums, found others")
    pixels = store.tables.class_pixels
    counted = class_pixels(images.get("label"), store.about.class_ids)
    if pixels is not None and not np.array_equal(counted, pixels[index]):
        problems.append("class_pixels: expected the label's counts, found others")
    problems += _image_problems(store, index, images)
    if recompute and "depth" in images:
        problems += _recomputed_problems(store, index, images)
    return problems


def _image_problems(store: Store, index: int, images: dict[str, npt.NDArray[Any]]) -> list[str]:
    """Check each image by what its modality's record says."""
    recipe = recipe_from(store.about.modalities)
    filled = recipe.fill != "none" and not recipe.store_filled
    problems = []
    for name, image in images.items():
        modality = store.arrays[name].modality
        if modality.values == "classes":
            problems += _class_problems(store, name, image)
        if modality.values == "vectors":
            problems += _vector_problems(modality, image)
        if modality.derived is not None and "depth" in images:
            # A frame without depth shows no direction.
            if modality.derived.gravity and images["depth"].any():
                problems += _gravity_problems(modality, store.tables.gravity[index])
            depth = images["depth"] > 0
            if modality.derived.covers == "depth beside depth" and not recipe.lone_normals:
                depth = _beside(depth)
            problems += _cover_problems(modality, image, depth, filled=filled)
    return problems


def _beside(depth: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return where depth has depth above, below, left or right of it."""
    some = np.pad(depth, 1)
    above, below = some[:-2, 1:-1], some[2:, 1:-1]
    beside: npt.NDArray[np.bool_] = above | below | some[1:-1, :-2] | some[1:-1, 2:]
    return depth & beside


def _class_problems(store: Store, name: str, image: npt.NDArray[np.uint8]) -> list[str]:
    known = [*(c.id for c in store.classes), IGNORE_LABEL]
    values = np.flatnonzero(np.bincount(image.reshape(-1), minlength=256))
    unknown = [int(v) for v in values if v not in known]
    return [f"{name}: expected {known}, found {unknown}"] if unknown else []


def _vector_problems(modality: Modality, image: npt.NDArray[Any]) -> list[str]:
    square = np.einsum("hwc,hwc->hw", image, image, dtype=np.float64)
    # Rounding moves each component by half a step at most, so the length by sqrt(3) / 2.
    off = np.abs(np.sqrt(square) - modality.steps) > np.sqrt(3) / 2 + 1e-6
    wrong = int((off & (square > 0)).sum())
    return [f"{modality.name}: expected unit vectors, found {wrong} others"] if wrong else []


def _gravity_problems(modality: Modality, gravity: npt.NDArray[np.float64]) -> list[str]:
    # Squares of the largest numbers there are would be infinite.
    if (np.abs(gravity) < 2).all() and np.isclose(np.linalg.norm(gravity), 1):
        return []
    beside = modality.long_name
    return [f"gravity: expected a unit vector beside {beside}, found {gravity.tolist()}"]


def _cover_problems(
    modality: Modality, image: npt.NDArray[Any], depth: npt.NDArray[np.bool_], *, filled: bool
) -> list[str]:
    """Check that there is some where depth is and, as far as the record says so, nowhere else."""
    derived = modality.derived
    covers = "depth" if derived is None else derived.covers
    some = image != modality.fill
    some = some.any(axis=2) if modality.channels else some
    # What is made of filled depth is there in its holes too.
    only = covers != "at least depth"
    wrong = int(((depth != some) if only and not filled else (depth & ~some)).sum())
    if wrong == 0 or (covers == "depth or nothing" and not some.any()):
        return []
    where = "depth is beside depth" if covers == "depth beside depth" else "depth is"
    expected = f"a value exactly where {where}" if only else f"a value where {where}"
    found = f"{wrong} pixels {'not so' if only else 'without'}"
    return [f"{modality.name}: expected {expected}, found {found}"]


def _recomputed_problems(
    store: Store, index: int, images: dict[str, npt.NDArray[Any]]
) -> list[str]:
    """Make the derived modalities again from depth and compare; one step of rounding may differ."""
    recipe = recipe_from(store.about.modalities)
    frame = Frame(
        id=store.ids[index],
        camera=store.camera(index),
        rgb=images.get("rgb"),
        depth_m=from_integers(store.arrays["depth"].modality, images["depth"]),
        baseline_m=float(store.tables.baseline[index]),
        cam_to_road=store.cam_to_road(index),
        gravity=store.given_gravity(index),
    )
    missing = None
    made = {name: store.arrays[name].modality.derived for name in images}
    wanted = [name for name, derived in made.items() if derived is not None]
    if recipe.store_filled:
        wanted = [name for name, derived in made.items() if derived and not derived.masked]
    elif recipe.fill == "colorization" and frame.rgb is None:
        return []
    else:
        frame, missing = fill_frame(frame, recipe)
    try:
        derived = derive(frame, missing, wanted, recipe)
    except (ArrayError, CameraError) as error:
        return [f"recomputation: {error}"]
    problems = []
    for name, again in derived.images.items():
        again = to_integers(store.arrays[name].modality, again)
        apart = np.abs(again.astype(np.int32) - images[name]) > 1
        apart = apart.any(axis=2) if apart.ndim == 3 else apart
        if apart.any():
            method = store.about.modalities[name]["method"]
            problems.append(
                f"{name}: expected what {method!r} makes of the depth, "
                f"found {int(apart.sum())} pixels apart"
            )
    estimated = images["depth"].any() and not np.isnan(derived.gravity).any()
    if estimated and not np.allclose(derived.gravity, store.tables.gravity[index]):
        problems.append(f"gravity: expected {derived.gravity}, found {store.tables.gravity[index]}")
    return problems
