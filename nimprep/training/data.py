"""What a network is fed: a store's splits, augmented, and what two networks take beside images."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from nimprep.derive.recipe import recipe_from
from nimprep.errors import ArrayError, StoreError
from nimprep.modality import MODALITIES
from nimprep.networks import NETWORKS, Network
from nimprep.networks.beside import extra_inputs
from nimprep.networks.network import SMALLEST
from nimprep.splits import SPLIT_CODES
from nimprep.store.reader import Store
from nimprep.torch import StoreDataset
from nimprep.torch.setups import Selection, select
from nimprep.torch.stored_images import NormalsFrom
from nimprep.torch.transforms import (
    ColorJitter,
    Compose,
    RandomCrop,
    RandomHorizontalFlip,
    RandomScale,
)
from nimprep.training.options import TrainOptions

DEPTH = "depth"


class Fed(NamedTuple):
    """Hold a batch on the device.

    Attributes
    ----------
    images : tuple of (B, C, H, W)
        The network's, and what it takes beside them.
    label : (B, H, W) int64
        Places of classes, 255 = none.
    """

    images: tuple[Tensor, ...]
    label: Tensor


class Feed:
    """Open splits of a store for a network, and bring batches into the order of its arguments.

    Attributes
    ----------
    store : Store
    selection : Selection
        What each image is made of.
    normals : str
        Where normals come from, as `StoreDataset` has it.

    Raises
    ------
    StoreError
        There is none.
    ArrayError
        There is no such setup, or it does not fit the network.
    """

    def __init__(self, store: Store, options: TrainOptions) -> None:
        assert options.network is not None
        assert options.setup is not None
        self.store = store
        self._options = options
        self.selection = _selection(self.store, options.network, options.setup)
        stored = "normal" in self.store.modalities
        chosen: NormalsFrom = "cached" if stored else "nim"
        self.normals: NormalsFrom = chosen if options.normals == "auto" else options.normals
        self._depth = False

    @property
    def channels(self) -> tuple[int, ...]:
        """Channels of each image."""
        return self.selection.channels

    @property
    def classes(self) -> int:
        """How many classes there are: all of the store's."""
        return len(self.store.classes)

    def fit(self, network: Network) -> None:
        """Give depth too, where this network needs it beside its images."""
        self._depth = network.wants_depth

    def has(self, split: str) -> bool:
        """Tell whether the store has frames in a split."""
        return bool((self.store.tables.split == SPLIT_CODES[split]).any())

    def open(self, split: str, *, augmented: bool = False) -> StoreDataset:
        """Open a split; a label is its class's place, whatever its id."""
        options = self._options
        common: dict[str, Any] = {
            "transform": _augmentation(options) if augmented else None,
            "normals": self.normals,
            "normalize": options.normalize,
            "classes": {c.name: place for place, c in enumerate(self.store.classes)},
            "seed": options.seed,
        }
        place: Any = self.store.storage
        if self._depth:
            names = dict.fromkeys([*self.selection.images, DEPTH, "label"])
            return StoreDataset(place, split, modalities=tuple(names), **common)  # type: ignore[arg-type]
        fusion = len(self.selection.groups) > 1
        return StoreDataset(place, split, options.setup, fusion, **common)  # type: ignore[arg-type]

    def fed(
        self, batch: dict[str, Any], data: StoreDataset, network: Network, device: torch.device
    ) -> Fed:
        """Return a batch of a split that `open` gave, as the network takes it."""
        images, depth = self.images(batch, device)
        more = extra_inputs(network, images, self.selection, data.scaling, depth)
        return Fed((*images, *more), batch["label"].to(device, non_blocking=True))

    def images(
        self, batch: dict[str, Any], device: torch.device
    ) -> tuple[tuple[Tensor, ...], Tensor | None]:
        """Return a batch's images on the device, and the depth beside them where one is needed."""

        def moved(tensor: Tensor) -> Tensor:
            return tensor.to(device, non_blocking=True)

        if self._depth:
            images = tuple(
                torch.cat([moved(batch[name]) for name in group], dim=1)
                for group in self.selection.groups
            )
            return images, moved(batch[DEPTH])
        inputs = batch["inputs"]
        return tuple(map(moved, inputs if isinstance(inputs, tuple) else (inputs,))), None

    @property
    def recipe(self) -> dict[str, Any]:
        """How the derived modalities are made, as a checkpoint says it."""
        found = vars(recipe_from(self.store.about.modalities))
        if self.normals == "cached":
            return found
        method = {"normals": self.normals, "sign_filter": False, "noise": None}
        return {**found, **method, "lone_normals": False, "whole_cells": False}

    @property
    def normal_dtype(self) -> str | None:
        """What the normals are stored as, where they are the store's."""
        vectors = [n for n in self.selection.modalities if _values(n) == "vectors"]
        if not vectors or self.normals != "cached":
            return None
        return str(self.store.arrays[vectors[0]].modality.dtype)


def _values(name: str) -> str:
    return MODALITIES[name].values if name in MODALITIES else ""


def _selection(store: Store, network: str, setup: str | tuple[str, ...]) -> Selection:
    planes = [plane.name for plane in store.planes]
    fusion = NETWORKS[network].fusion
    whole = select(setup, planes=planes)  # type: ignore[arg-type]
    if not fusion:
        return whole
    apart = select(setup, fusion=len(whole.images) > 1, planes=planes)  # type: ignore[arg-type]
    if len(apart.groups) != 2:
        raise ArrayError(
            f"setup: expected one of two parts for {network}, which has two encoders, found "
            f"{setup!r}; rgb+d or nim-rgb+d, say"
        )
    return apart


def frame_size(store: Store) -> tuple[int, int]:
    """Return height and width of a store's frames, padding included.

    Raises
    ------
    StoreError
        It has no labels, or of one class alone; or its frames are too small for any network.
    """
    if not store.classes or "label" not in store.modalities:
        raise StoreError(
            f"{store.path}: expected labels, found none; convert a dataset with labels"
        )
    if len(store.classes) == 1:
        raise StoreError(
            f"{store.path}: expected two classes or more, found {store.classes[0].name!r} alone; "
            "there is nothing to tell apart"
        )
    height, width = (int(n) for n in next(iter(store.arrays.values())).shape[1:3])
    if min(height, width) < SMALLEST:
        raise StoreError(
            f"{store.path}: expected frames of {SMALLEST}x{SMALLEST} pixels or more, found "
            f"{width}x{height}; networks take no smaller ones"
        )
    return height, width


def without_pixels(data: StoreDataset) -> str:
    """Return the classes that no label of a split is of, by commas."""
    pixels = [*data.class_pixels().tolist(), *[0] * len(data.store.classes)]
    return ", ".join(c.name for c, n in zip(data.store.classes, pixels, strict=False) if not n)


def _augmentation(options: TrainOptions) -> Compose | None:
    """Return what happens to frames by chance, geometry before colours."""
    steps: list[Any] = []
    if options.scale is not None:
        steps.append(RandomScale(options.scale))
    if isinstance(options.crop, tuple):
        steps.append(RandomCrop(*options.crop))
    if options.flip:
        steps.append(RandomHorizontalFlip(options.flip))
    if options.color:
        part = options.color
        steps.append(ColorJitter(part, part, part, part / 6))
    return Compose(steps) if steps else None
