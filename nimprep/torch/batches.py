"""A batch's tensors, and one frame decoded straight into its place in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from nimprep.torch.collation import Batch, new_tensor
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import Selection, channels_of
from nimprep.torch.stored_images import StoredImages
from nimprep.torch.views import VIEWS


@dataclass(frozen=True, eq=False)
class BatchMaker:
    """Make batches of a store's frames, without a transform.

    Attributes
    ----------
    images : StoredImages
    selection : Selection
    scaling : Scaling
    dtype : {"float32", "stored"}
        As `StoreDataset` takes it.
    """

    images: StoredImages
    selection: Selection
    scaling: Scaling
    dtype: str

    def allocate(self, count: int, *, pinned: bool = False) -> Batch:
        """Return a batch of so many frames whose tensors are yet to be filled."""
        height, width = self.images.size
        batch = Batch()

        def new(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return new_tensor((count, *shape), dtype, pinned=pinned)

        if self.dtype == "stored":
            for name in self.selection.images:
                batch[name] = self._new_stored(name, new)
        elif self.selection.inputs:
            tensors = [new(channels, height, width) for channels in self.selection.channels]
            batch["inputs"] = tensors[0] if len(tensors) == 1 else tuple(tensors)
        else:
            for name in self.selection.images:
                batch[name] = new(channels_of(name), height, width)
        if self.selection.label:
            label = torch.uint8 if self.dtype == "stored" else torch.int64
            batch["label"] = new(height, width, dtype=label)
        batch["id"] = [""] * count
        batch["intrinsics"] = new(3, 3)
        if self.images.store.about.has_gravity:
            batch["gravity"] = new(3)
        batch["size"] = new(2, dtype=torch.int64)
        return batch

    def _new_stored(self, name: str, new: Any) -> Tensor:
        modality = self.images.modality(name)
        dtype: torch.dtype = getattr(torch, modality.dtype)
        height, width = self.images.size
        if not modality.channels:
            return new(1, height, width, dtype=dtype)  # type: ignore[no-any-return]
        # In memory the channels stay last, as stored; PyTorch's channels_last format.
        image: Tensor = new(*modality.image_shape(height, width), dtype=dtype)
        return image.permute(0, 3, 1, 2)

    def fill(self, batch: Batch, position: int, index: int) -> None:
        """Decode a frame, by its index in the store, into a place of a batch.

        Safe to call from several threads, each with a place of its own.

        Raises
        ------
        StoreError
            A chunk is damaged or gone.
        """
        images = self.images
        if self.dtype == "stored":
            for name in self.selection.images:
                place = batch[name][position]
                flat = place[0] if channels_of(name) == 1 else place.permute(1, 2, 0)
                images.stored(name, index, flat.numpy())
            if self.selection.label:
                images.stored("label", index, batch["label"][position].numpy())
        else:
            for name, place in self._places(batch, position):
                images.scaled(name, index, self.scaling, place)
            if self.selection.label:
                images.label(index, batch["label"][position])
        tables = images.store.tables
        batch["id"][position] = images.store.ids[index]
        batch["intrinsics"][position] = torch.from_numpy(tables.intrinsics[index])
        if "gravity" in batch:
            batch["gravity"][position] = torch.from_numpy(tables.gravity[index])
        batch["size"][position] = torch.from_numpy(tables.image_size[index])

    def _places(self, batch: Batch, position: int) -> list[tuple[str, Tensor]]:
        """Return each modality's part of the tensors of one frame."""
        if not self.selection.inputs:
            return [(name, batch[name][position]) for name in self.selection.images]
        inputs = batch["inputs"]
        tensors = inputs if isinstance(inputs, tuple) else (inputs,)
        places: list[tuple[str, Tensor]] = []
        for group, tensor in zip(self.selection.inputs, tensors, strict=True):
            parts = torch.split(tensor[position], [channels_of(name) for name in group])
            places += zip(group, parts, strict=True)
        return places


def joined(group: tuple[str, ...], raw: Mapping[str, Tensor], scaling: Scaling) -> Tensor:
    """Return one tensor of several modalities, or views of them, one below the other and scaled.

    Parameters
    ----------
    group : tuple of str
    raw : mapping of str to (C, H, W) tensor
        The modalities as transforms take them.
    scaling : Scaling
    """
    channels = [channels_of(name) for name in group]
    first = VIEWS[group[0]].of if group[0] in VIEWS else group[0]
    size = raw[first].shape[-2:]
    out = torch.empty((sum(channels), *size), dtype=torch.float32)
    for name, part in zip(group, torch.split(out, channels), strict=True):
        if name in VIEWS:
            of = VIEWS[name].of
            values = torch.empty_like(raw[of], dtype=torch.float32)
            scaling.cut_alone().apply(of, raw[of], values)
            VIEWS[name].write(values, scaling.apply, part)
        else:
            scaling.apply(name, raw[name], part)
    return out
