"""A store's frames as a trained network takes them, whatever store it is."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from torch import Tensor

from nimprep.derive.modalities import fill_frame
from nimprep.derive.recipe import recipe_from
from nimprep.errors import ArrayError, StoreError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, given_for
from nimprep.networks import RunModel
from nimprep.networks.frames import DEPTH, Basis
from nimprep.store.reader import Store, open_store


class Seen(NamedTuple):
    """Hold what the network gets of one frame.

    Attributes
    ----------
    images : tuple of (C, H, W) float32
        The network's, without padding.
    depth : (1, H, W) float32 or None
        What it takes beside them.
    blank : frozenset of str
        The modalities that the frame has nothing of.
    """

    images: tuple[Tensor, ...]
    depth: Tensor | None
    blank: frozenset[str]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width, pixels."""
        height, width = self.images[0].shape[1:]
        return height, width


class StoreFrames:
    """Make a network's images of a store's frames, as they were made in its training.

    What the store holds of derived modalities is taken where it was made as in training; else, and
    where it has none, they are derived from its depth.

    Attributes
    ----------
    store : Store
        Opened with what is needed alone.
    kept : frozenset of str
        Derived modalities that are the store's own.

    Raises
    ------
    StoreError
        The store lacks what the setup needs.
    """

    def __init__(self, store: Store, model: RunModel) -> None:
        self._model = model
        self._inputs = model.inputs
        self._theirs = recipe_from(store.about.modalities)
        wants_depth = model.network.wants_depth
        self.kept = frozenset(
            name for name in self._inputs.modalities if self._is_kept(store, name)
        )
        needed = self._inputs.sources(self.kept, depth=wants_depth)
        lacking = sorted(needed - {*store.modalities})
        if lacking:
            wanted = ",".join(dict.fromkeys((*store.modalities, *lacking)))
            raise StoreError(
                f"{store.path}: expected {', '.join(lacking)} for a network of "
                f"{model.checkpoint.setup!r}, found only {', '.join(store.modalities)}; convert "
                f"again with --modalities {wanted}"
            )
        self._say_fill(store)
        self.store = open_store(store.storage, needed)

    def _is_kept(self, store: Store, name: str) -> bool:
        """Tell whether the store's own is taken; say where something is made otherwise."""
        derived = MODALITIES[name].derived if name in MODALITIES else None
        if derived is None or name not in store.modalities:
            return False
        ours, theirs = self._inputs.recipe, self._theirs
        there = given_for([name]) <= {*store.modalities}
        if there and self._inputs.computed(name):
            return False
        held = store.modality(name)
        rounded = held.as_dtype(self._inputs.normal_dtype or "")
        alike = ours.describe(name) == theirs.describe(name)
        if alike and held == rounded:
            return True
        if not alike:
            made = "derived from its depth as there" if there else "taken as they are"
            wanted, found = _differences(ours.describe(name), theirs.describe(name))
            warnings.warn(
                f"{store.path}: expected {name} made as in training, with {wanted}, found "
                f"{found}; {made}",
                stacklevel=5,
            )
        return not there

    def _say_fill(self, store: Store) -> None:
        """Say where the store's depth is filled otherwise than in training."""
        ours, theirs = (
            recipe.fill if recipe.store_filled else "none"
            for recipe in (self._inputs.recipe, self._theirs)
        )
        used = DEPTH in self._inputs.sources(self.kept, depth=self._model.network.wants_depth)
        if used and ours != theirs and theirs != "none":
            warnings.warn(
                f"{store.path}: expected depth with fill {ours!r} as in training, found "
                f"{theirs!r}; taken as it is",
                stacklevel=5,
            )

    def read(self, index: int) -> Seen:
        """Return what the network gets of a frame.

        Raises
        ------
        StoreError
            A chunk is damaged or gone.
        """
        frame = self.store[index]
        found = {name: frame.image(name) for name in self.store.modalities}
        images = {name: image for name, image in found.items() if image is not None}
        try:
            basis = self._basis(frame, images)
            made = self._inputs.images(basis, self.kept)
            tensors = tuple(self._inputs.tensors(made))
        except ArrayError as error:
            raise StoreError(f"{self.store.path}: frame {frame.id!r}: {error}") from error
        beside = None
        if self._model.network.wants_depth:
            beside = self._inputs.depth_beside(basis.images[DEPTH])
        return Seen(tensors, beside, frozenset(n for n, image in made.items() if _blank(n, image)))

    def _basis(self, frame: Frame, images: dict[str, npt.NDArray[Any]]) -> Basis:
        """Return a frame as its store has it, and what is derived from."""
        plain = Frame(
            frame.id,
            frame.camera,
            rgb=images.get("rgb"),
            depth_m=images.get(DEPTH),
            baseline_m=frame.baseline_m,
            cam_to_road=frame.cam_to_road,
        )
        recipe = self._inputs.recipe
        if self._theirs.store_filled or plain.depth_m is None:
            return Basis(images, plain)
        filled, missing = fill_frame(plain, recipe)
        if recipe.store_filled and filled.depth_m is not None:
            images = {**images, DEPTH: filled.depth_m}
        return Basis(images, filled, missing)


def _blank(name: str, image: npt.NDArray[Any]) -> bool:
    """Tell whether there is nothing in an image whose numbers say where there is none."""
    values = MODALITIES[name].values if name in MODALITIES else "measures"
    if values in ("colors", "measures"):
        return False
    return not bool(np.any(np.nan_to_num(image)))


def _differences(ours: dict[str, Any], theirs: dict[str, Any]) -> tuple[str, str]:
    """Return in what two ways of making a modality differ, in words."""
    one, other = ({"method": found["method"], **found["parameters"]} for found in (ours, theirs))
    differ = [n for n in {**one, **other} if one.get(n) != other.get(n)]
    # Sentences repeat at length what a word or two have said.
    short = [n for n in differ if max(len(str(one.get(n))), len(str(other.get(n)))) < 30]
    names = short or differ
    first, second = (
        ", ".join(f"{name} {found[name]}" if name in found else f"no {name}" for name in names)
        for found in (one, other)
    )
    return first, second
