"""A frame's derived modalities, each made by the function that its record names."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from pkgutil import resolve_name
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.recipe import DERIVED as DERIVED
from nimprep.derive.recipe import FILLS as FILLS
from nimprep.derive.recipe import Given, Made
from nimprep.derive.recipe import Recipe as Recipe
from nimprep.derive.recipe import recipe_from as recipe_from
from nimprep.frame import Frame
from nimprep.modality import MODALITIES


@dataclass(frozen=True)
class Derived:
    """Hold what was derived from one frame's depth.

    Attributes
    ----------
    images : dict of modality to array
        As a `Frame` has them.
    gravity : (3,) float64
        Direction in the camera frame, as given or as HHA was made with; NaN without either.
    signs : dict of str to float
        What is to be said of the making: see `nimprep.derive.recipe.Made`.
    """

    images: dict[str, npt.NDArray[Any]]
    gravity: npt.NDArray[np.float64]
    signs: dict[str, float] = field(default_factory=dict)


def fill_frame(frame: Frame, recipe: Recipe) -> tuple[Frame, npt.NDArray[np.bool_] | None]:
    """Return the frame with its holes filled by the recipe, and the mask of what was filled.

    The mask is None where the recipe fills nothing.
    """
    if recipe.fill == "none" or frame.depth_m is None or "depth" in frame.absent:
        return frame, None
    from nimprep.derive.completion import fill_depth

    filled, mask = fill_depth(frame.depth_m, recipe.fill, frame.rgb, num_threads=1)
    return replace(frame, depth_m=filled), mask


def derive(
    frame: Frame,
    missing: npt.NDArray[np.bool_] | None,
    modalities: Collection[str],
    recipe: Recipe,
) -> Derived:
    """Make a frame's derived modalities, on the calling thread alone.

    Parameters
    ----------
    frame : Frame
        With depth_m filled already, where the recipe says so (see `fill_frame`).
    missing : (H, W) bool, optional
        Where depth_m was filled in.
    modalities : collection of str
        Those to make; names that are not derived are passed over.
    """
    images: dict[str, npt.NDArray[Any]] = {}
    gravity = np.full(3, np.nan) if frame.gravity is None else frame.gravity
    signs: dict[str, float] = {}
    if frame.depth_m is None:
        return Derived(images, gravity)
    given = Given(frame, frame.depth_m, missing, recipe)
    for modality in MODALITIES.values():
        if modality.derived is None or modality.name not in modalities:
            continue
        if frame.absent.intersection(modality.derived.made_from):
            images[modality.name] = modality.blank(frame.camera.shape)
            continue
        made: Made = resolve_name(modality.derived.make)(given)
        image = made.image
        images[modality.name] = modality.blank(frame.camera.shape) if image is None else image
        gravity = gravity if made.gravity is None else made.gravity
        signs |= made.signs or {}
    return Derived(images, gravity, signs)
