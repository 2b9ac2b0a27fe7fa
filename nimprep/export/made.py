"""A frame's images for export: the store's, and those it lacks but whose depth gives them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.derive.modalities import Recipe, derive, fill_frame, recipe_from
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, given_for
from nimprep.store.frames import to_integers
from nimprep.store.reader import Store


def can_be_made(store: Store, name: str) -> bool:
    """Return whether a store has a modality, or what it is made from."""
    if name in store.modalities:
        return True
    derived = MODALITIES[name].derived if name in MODALITIES else None
    return derived is not None and set(derived.made_from) <= set(store.modalities)


class Images:
    """Give the images of a store's frames, those that it lacks made by its own recipe.

    Parameters
    ----------
    store : Store
    names : sequence of str
        The modalities that are asked for; each must be one that `can_be_made`.
    """

    def __init__(self, store: Store, names: Sequence[str]) -> None:
        self._store = store
        self._made = [name for name in names if name not in store.modalities]
        self._sources = given_for(self._made) & set(store.modalities)
        # What the store has not is not in its recipe either: there convert's defaults hold.
        recipe = recipe_from(store.attributes["modalities"])
        self._recipe = replace(recipe, hha_ground=Recipe().hha_ground)

    def of(self, index: int) -> FrameImages:
        """Return those of a frame."""
        frame = self._store[index]
        made = self._derived(frame) if self._made else {}
        return FrameImages(self._store, index, frame, made)

    def _derived(self, frame: Frame) -> dict[str, npt.NDArray[Any]]:
        plain = Frame(
            id=frame.id,
            camera=frame.camera,
            rgb=frame.rgb,
            depth_m=frame.depth_m,
            baseline_m=frame.baseline_m,
            cam_to_road=frame.cam_to_road,
            # A store does not say of which frames the dataset had none: then they are blank.
            absent=frozenset(name for name in self._sources if not frame[name].any()),
        )
        filled, missing = fill_frame(plain, self._recipe)
        return derive(filled, missing, self._made, self._recipe).images


class FrameImages:
    """Give the images of one frame, each at the frame's own size."""

    def __init__(
        self, store: Store, index: int, frame: Frame, made: dict[str, npt.NDArray[Any]]
    ) -> None:
        self._store, self._index, self._frame, self._made = store, index, frame, made

    def image(self, name: str) -> npt.NDArray[Any]:
        """Return an image as a `Frame` has it."""
        return self._made[name] if name in self._made else self._frame[name]

    def integers(self, name: str) -> npt.NDArray[Any]:
        """Return an image as a store holds it."""
        if name in self._made:
            return to_integers(MODALITIES[name], self._made[name])
        height, width = self._frame.camera.shape
        return np.ascontiguousarray(self._store.arrays[name].read(self._index)[:height, :width])
