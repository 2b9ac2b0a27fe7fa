"""Which method makes a store's normals, where that is to follow from the noise of its depth."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from nimprep.conversion.encode import frame_to_derive_from
from nimprep.conversion.options import ConvertOptions
from nimprep.depth import checked_depth
from nimprep.derive.recipe import Recipe
from nimprep.errors import NimprepError
from nimprep.parallel import Progress, available_cores, map_in_order
from nimprep.readers.base import Reader
from nimprep.store.frames import depth_to_integers
from nimprep.store.writer import StoreLayout

SAMPLE = 16
"""Noise is measured on at most as many frames, spread over the data set."""


def asks_for_choice(layout: StoreLayout, options: ConvertOptions) -> bool:
    """Return whether there is something to choose for: a store with derived vectors."""
    vectors = (layout.modality(name).values == "vectors" for name in layout.modalities)
    return options.normals == "auto" and any(vectors)


def with_choice(recipe: Recipe, chosen: Mapping[str, Any] | None) -> Recipe:
    """Return the recipe with the method that was chosen; where none was needed, the default."""
    if recipe.normals != "auto":
        return recipe
    return replace(recipe, normals="nim" if chosen is None else chosen["method"])


def choose_normals(
    reader: Reader, layout: StoreLayout, options: ConvertOptions, start: Progress
) -> dict[str, Any]:
    """Choose the method of a store's normals by the noise of some of its frames.

    It is measured on the depth that normals are made of: as the store will hold it, and filled.
    Which frames these are, and so the choice, depends on the reader's frames alone. Bad ones are
    left out here: encoding them says what is wrong.

    Returns
    -------
    dict
        The attribute `normals_chosen` of the store.
    """
    from nimprep.derive.method_choice import MeasuredNoise, measure_noise, method_for

    places = np.unique(np.linspace(0, len(reader.ids) - 1, SAMPLE).round().astype(int))
    ids, recipe = [reader.ids[place] for place in places], options.recipe
    wanted = {"depth"} | ({"rgb"} if recipe.fill == "colorization" else set())
    done = start("measuring noise", len(ids))

    def measure(frame_id: str) -> MeasuredNoise | None:
        try:
            frame = reader.read(frame_id, wanted)
            if frame.depth_m is None or "depth" in frame.absent:
                return None
            unit = layout.modality("depth")
            stored, _ = depth_to_integers(unit, frame.depth_m)
            frame, _ = frame_to_derive_from(frame, unit, stored, recipe)
            return measure_noise(checked_depth(frame.depth_m, frame.camera), frame.camera)
        except NimprepError:
            return None
        finally:
            done()

    with closing(map_in_order(measure, ids, options.workers or available_cores())) as found:
        measured = {i: noise for i, noise in zip(ids, found, strict=True) if noise is not None}
    return {
        "method": method_for([*measured.values()]),
        "frames": [
            {"id": i, "relative": noise.relative, "turns_deg": noise.turns_deg}
            for i, noise in measured.items()
        ],
    }
