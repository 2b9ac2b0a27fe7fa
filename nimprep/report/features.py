"""Single numbers that tell classes apart: of what a frame holds, and of what its depth can give."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pkgutil import resolve_name
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.methods import ELEVATION_ROADS, FIXED_METHODS, GROUNDS
from nimprep.derive.recipe import Given, Made, Recipe
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality

Values = npt.NDArray[np.float32]

CHOICES: dict[str, tuple[str, ...]] = {
    "normals": FIXED_METHODS,
    "hha_ground": GROUNDS,
    "elevation_road": ELEVATION_ROADS,
}
"""Options of a recipe whose every choice is looked at, where a modality depends on it."""


@dataclass(frozen=True)
class Source:
    """Say where an image comes from that features are taken of.

    Attributes
    ----------
    modality : Modality
    recipe : Recipe, optional
        How it is made; None = it is there already.
    title : str
        The modality's.
    choices : str
        Those that it depends on, as they were or are made.
    added : str
        What `--modalities` has to name besides what is there; "" = nothing.
    options : str
        Further options with which `convert` stores it.
    """

    modality: Modality
    recipe: Recipe | None
    title: str
    choices: str = ""
    added: str = ""
    options: str = ""

    @property
    def label(self) -> str:
        """The title, and the choices in parentheses."""
        return f"{self.title} ({self.choices})" if self.choices else self.title


def sources(
    there: Mapping[str, Modality], base: Recipe, *, calibrated: bool = True
) -> list[Source]:
    """Return what is there, and what can be made of it: other modalities, and other choices.

    Parameters
    ----------
    there : mapping of str to Modality
        What frames hold; classes are passed over.
    base : Recipe
        How what is there was made. What is made here is made so too, but for the choices that are
        looked at, and of the depth as it is: no holes are filled.
    calibrated : bool
        Whether a frame has `cam_to_road`. Without, elevation is the same whichever road is asked
        for, and nothing is said of one that is calibrated.
    """
    plain = replace(base, fill="none", store_filled=False, sign_filter=False, noise=None)
    found = []
    for name, modality in {**there, **MODALITIES}.items():
        modality = there.get(name, modality)
        if modality.values == "classes":
            continue
        title = modality.title or name.replace("_", " ").capitalize()
        fields = _fields(modality, plain, calibrated) if modality.derived else []
        if name in there:
            found.append(Source(modality, None, title, _chosen(base, fields)))
        if modality.derived is None or not set(modality.derived.made_from) <= set(there):
            continue
        for recipe in _variants(plain, fields):
            kept = {field: getattr(recipe, field) for field in fields}
            if name in there and all(getattr(base, f) == value for f, value in kept.items()):
                continue
            words = [f"--{field.replace('_', '-')} {value}" for field, value in kept.items()]
            added = "" if name in there else name.replace("_", "-")
            chosen = _chosen(recipe, fields)
            found.append(Source(modality, recipe, title, chosen, added, " ".join(words)))
    return found


def _fields(modality: Modality, recipe: Recipe, calibrated: bool) -> list[str]:
    """Return the choices that a modality depends on."""
    return [
        field
        for field, choices in CHOICES.items()
        if (calibrated or field != "elevation_road")
        and len({_described(modality, _changed(recipe, field, c)) for c in choices}) > 1
    ]


def _described(modality: Modality, recipe: Recipe) -> str:
    return json.dumps(recipe.describe(modality.name), sort_keys=True)


def _changed(recipe: Recipe, field: str, choice: str) -> Recipe:
    changed: dict[str, Any] = {field: choice}
    return replace(recipe, **changed)


def _variants(recipe: Recipe, fields: list[str]) -> list[Recipe]:
    found = [recipe]
    for field in fields:
        found = [_changed(one, field, choice) for one in found for choice in CHOICES[field]]
    return found


def _chosen(recipe: Recipe, fields: list[str]) -> str:
    return ", ".join(str(getattr(recipe, field)) for field in fields)


def image_of(source: Source, frame: Frame) -> npt.NDArray[Any] | None:
    """Return a frame's image, as a `Frame` has it; None = it has none, as where no road is."""
    if source.recipe is None:
        return frame.image(source.modality.name)
    if frame.depth_m is None or source.modality.derived is None:
        return None
    make = resolve_name(source.modality.derived.make)
    made: Made = make(Given(frame, frame.depth_m, None, source.recipe))
    return made.image


def numbers_of(
    modality: Modality, pixels: npt.NDArray[Any], road: npt.NDArray[np.bool_]
) -> dict[str, Values]:
    """Return single numbers of an image's pixels, by what they are called; NaN = none.

    Parameters
    ----------
    pixels : (N,) or (N, 3) array
        As a `Frame` has them.
    road : (N,) bool
        Those of the road: vectors count by their angle to the road's own direction, the median of
        its vectors' components.

    Returns
    -------
    dict of str to (N,) float32
        Of colours the mean of the three; of levels each channel; of vectors an angle, degrees; of
        others the number itself, called "", and of those that are 0 on the road their size.
    """
    values = pixels.astype(np.float32)
    match modality.values:
        case "colors":
            return {"brightness": values.mean(axis=1)}
        case "levels":
            values[(pixels == 0).all(axis=1)] = np.nan
            return dict(zip(modality.channels, values.T, strict=True))
        case "vectors":
            return {"angle to the road's median": _angles(values, road)}
    if np.isnan(modality.absent):
        # Of numbers only those that can be negative have NaN: what lies above and below a road.
        size = {"size without sign": np.abs(values)} if modality.values == "numbers" else {}
        return {"": values, **size}
    return {"": np.where((values == modality.absent) & modality.has_none, np.nan, values)}


def _angles(vectors: Values, road: npt.NDArray[np.bool_]) -> Values:
    known = vectors.any(axis=1)
    angles = np.full(len(vectors), np.nan, np.float32)
    if not (road & known).any():
        return angles
    direction = np.median(vectors[road & known], axis=0)
    length = float(np.linalg.norm(direction))
    if length == 0:
        return angles
    cosine = vectors[known] @ (direction / length)
    angles[known] = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return angles
