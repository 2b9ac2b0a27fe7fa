"""What a trained network is given of a frame: the images of its setup, made as in its training."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nimprep.depth_unit import MILLIMETRE
from nimprep.derive.modalities import derive, fill_frame
from nimprep.derive.recipe import Recipe
from nimprep.errors import ArrayError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, given_for
from nimprep.networks.checkpoint import Checkpoint
from nimprep.networks.nim_options import scaling_rows
from nimprep.store.frames import depth_to_integers, from_integers, to_integers
from nimprep.torch.batches import joined
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import Selection

DEPTH = "depth"

Images = Mapping[str, npt.NDArray[Any]]
"""Images by modality, as a `Frame` has them."""


@dataclass(frozen=True)
class Basis:
    """Hold a frame as its dataset's store would have it, and what is derived of it.

    Attributes
    ----------
    images : mapping of str to array
        What is not derived, and of that what is kept as it is.
    frame : Frame
        What others are derived from: its depth filled where the recipe says so.
    missing : (H, W) bool, optional
        Where it was filled; None = nowhere.
    """

    images: Images
    frame: Frame
    missing: npt.NDArray[np.bool_] | None = None


class FrameInputs:
    """Make what a trained network takes of a frame.

    Attributes
    ----------
    selection : Selection
        What each of the network's images is made of.
    scaling : Scaling
    recipe : Recipe
        How derived modalities are made.
    normal_dtype : str, optional
        What normals are rounded to, as a store that holds them does; None = not at all.
    depth : Modality
        In the unit of the training's store.
    is_coarse : bool
        Whether that is more than a millimetre.

    Raises
    ------
    ArrayError
        The checkpoint's fields do not go together.
    """

    def __init__(self, checkpoint: Checkpoint) -> None:
        names = tuple(name for group in checkpoint.groups for name in group)
        self.selection = Selection(names, False, checkpoint.groups)
        if self.selection.channels != checkpoint.channels:
            raise ArrayError(
                f"channels: expected {self.selection.channels} of {checkpoint.groups}, found "
                f"{checkpoint.channels}; read it with the nimprep that wrote it, or a later one"
            )
        self.scaling = Scaling(checkpoint.scale, checkpoint.offset, checkpoint.cut)
        self.recipe = recipe_of(checkpoint)
        self.normal_dtype = checkpoint.normal_dtype
        unit = self.recipe.depth_unit
        unit_m = unit if isinstance(unit, float) else MILLIMETRE
        self.depth = MODALITIES[DEPTH].as_unit(unit_m)
        self.is_coarse = unit_m > MILLIMETRE

    @property
    def modalities(self) -> tuple[str, ...]:
        """The modalities that the images are made of; each once, in order."""
        return self.selection.modalities

    def computed(self, name: str) -> bool:
        """Tell whether it was made in training as frames were read, of depth as it is stored."""
        return _values(name) == "vectors" and self.normal_dtype is None

    def sources(self, kept: Collection[str] = (), *, depth: bool = False) -> set[str]:
        """Return what must be there of a frame.

        Parameters
        ----------
        kept : collection of str
            Derived modalities that are taken as they are.
        depth : bool
            Whether the network takes depth beside its images.
        """
        made = {name for name in self.modalities if name not in kept}
        needed = {*given_for(made), *(set(self.modalities) - made)}
        filled = self.recipe.fill == "colorization" and any(map(_is_derived, made))
        return needed | ({"rgb"} if filled else set()) | ({DEPTH} if depth else set())

    def as_stored(self, frame: Frame) -> Basis:
        """Return a frame as a store of the training's kind would have it.

        Depth is rounded to the store's unit, and what it cannot say is none there.
        """
        images = {n: frame.image(n) for n in (*MODALITIES, *frame.others)}
        found = {n: image for n, image in images.items() if image is not None}
        if frame.depth_m is None:
            return Basis(found, frame)
        found[DEPTH], seen = self._rounded(frame.depth_m)
        filled, missing = fill_frame(replace(frame, depth_m=seen), self.recipe)
        if self.recipe.store_filled and filled.depth_m is not None:
            found[DEPTH], seen = self._rounded(filled.depth_m)
            filled = replace(filled, depth_m=seen)
        return Basis(found, filled, missing)

    def images(self, basis: Basis, kept: Collection[str] = ()) -> dict[str, npt.NDArray[Any]]:
        """Return the setup's modalities, as a `Frame` of the training's store would have them.

        Raises
        ------
        ArrayError
            One is not there, and cannot be made.
        """
        todo = {name for name in self.modalities if _is_derived(name) and name not in kept}
        made = self._derived(basis, todo)
        found = {}
        for name in self.modalities:
            image = made.get(name) if name in todo else basis.images.get(name)
            if image is None:
                needed = ", ".join(sorted(self.sources(kept)))
                raise ArrayError(
                    f"{name}: expected it, or what it is made of, for a network that takes "
                    f"{'+'.join(self.modalities)}, found none; give {needed}"
                )
            found[name] = image
        return found

    def _derived(self, basis: Basis, todo: Collection[str]) -> dict[str, npt.NDArray[Any]]:
        computed = {name for name in todo if self.computed(name)}
        cached = {name for name in todo if name not in computed}
        made = derive(basis.frame, basis.missing, cached, self.recipe).images
        for name, image in made.items():
            record = MODALITIES[name].as_dtype(self.normal_dtype or "")
            made[name] = from_integers(record, to_integers(record, image))
        if computed and DEPTH in basis.images:
            stored = replace(basis.frame, depth_m=basis.images[DEPTH])
            recipe = replace(self.recipe, fill="none", store_filled=False)
            made |= derive(stored, None, computed, recipe).images
        return made

    def tensors(self, images: Images) -> list[Tensor]:
        """Return each of the network's images, (C, H, W) float32, scaled as in training."""
        raw = {name: _tensor(image) for name, image in images.items()}
        return [joined(group, raw, self.scaling) for group in self.selection.groups]

    def depth_beside(self, depth_m: npt.NDArray[np.float32]) -> Tensor:
        """Return depth that is given beside the images, (1, H, W), scaled as in training."""
        scale, offset = scaling_rows(DEPTH, self.scaling)
        cut = {name: ends for name, ends in self.scaling.cut.items() if name == DEPTH}
        own = Scaling({DEPTH: tuple(scale)}, {DEPTH: tuple(offset)}, cut)
        return joined((DEPTH,), {DEPTH: _tensor(depth_m)}, own)

    def _rounded(
        self, depth_m: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return depth as it is stored, and as others are derived from it."""
        stored, _ = depth_to_integers(self.depth, depth_m)
        rounded = from_integers(self.depth, stored)
        if not self.is_coarse:
            return rounded, rounded
        # Coarser units would spoil normals: convert derives from depth as it was read.
        return rounded, np.where(stored > 0, depth_m, np.float32(0))


def recipe_of(checkpoint: Checkpoint) -> Recipe:
    """Return how a checkpoint's derived modalities were made.

    Raises
    ------
    ArrayError
        It is nothing that this version knows.
    """
    known = {field.name for field in fields(Recipe)}
    if unknown := sorted(checkpoint.recipe.keys() - known):
        raise ArrayError(
            f"recipe: expected some of {', '.join(sorted(known))}, found {unknown[0]!r}; read it "
            "with the nimprep that wrote it, or a later one"
        )
    # Checkpoints that say nothing of cells are of a time when nim-edge took whole ones.
    whole = checkpoint.recipe.get("normals") == "nim-edge"
    return Recipe(**{"whole_cells": whole, **checkpoint.recipe})


def _is_derived(name: str) -> bool:
    return name in MODALITIES and MODALITIES[name].derived is not None


def _values(name: str) -> str:
    return MODALITIES[name].values if name in MODALITIES else ""


def _tensor(image: npt.NDArray[Any]) -> Tensor:
    tensor = torch.from_numpy(np.ascontiguousarray(image))
    return tensor.permute(2, 0, 1) if tensor.ndim == 3 else tensor[None]
