"""A batch's tensors, and one frame decoded straight into its place in them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from nimprep.torch.collation import Batch, new_tensor
from nimprep.torch.setups import CHANNELS

if TYPE_CHECKING:
    from nimprep.torch.dataset import StoreDataset

_STORED: dict[str, torch.dtype] = {
    "uint8": torch.uint8,
    "uint16": torch.uint16,
    "int8": torch.int8,
    "int16": torch.int16,
}


def allocate(dataset: StoreDataset, count: int, *, pinned: bool = False) -> Batch:
    """Return a batch of so many frames whose tensors are yet to be filled."""
    selection, source = dataset.selection, dataset.source
    height, width = source.size
    batch = Batch()

    def new(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return new_tensor((count, *shape), dtype, pinned=pinned)

    if dataset.dtype == "stored":
        for name in selection.images:
            batch[name] = _new_stored(dataset, name, new)
    elif selection.inputs:
        tensors = [new(channels, height, width) for channels in selection.channels]
        batch["inputs"] = tensors[0] if len(tensors) == 1 else tuple(tensors)
    else:
        for name in selection.images:
            batch[name] = new(CHANNELS[name], height, width)
    if selection.label:
        label = torch.uint8 if dataset.dtype == "stored" else torch.int64
        batch["label"] = new(height, width, dtype=label)
    batch["id"] = [""] * count
    batch["intrinsics"] = new(3, 3)
    batch["size"] = new(2, dtype=torch.int64)
    return batch


def _new_stored(dataset: StoreDataset, name: str, new: Any) -> Tensor:
    array = dataset.store.arrays.get(name)
    dtype = torch.int8 if array is None else _STORED[str(array.dtype)]
    if name == "normal" and dataset.source.normals != "cached":
        dtype = torch.int8
    height, width = dataset.source.size
    if CHANNELS[name] == 1:
        return new(1, height, width, dtype=dtype)  # type: ignore[no-any-return]
    # In memory the channels stay last, as stored; PyTorch's channels_last format.
    return new(height, width, 3, dtype=dtype).permute(0, 3, 1, 2)  # type: ignore[no-any-return]


def fill(dataset: StoreDataset, batch: Batch, position: int, index: int) -> None:
    """Decode a dataset's frame into a place of a batch, without a transform.

    Safe to call from several threads, each with a place of its own.

    Raises
    ------
    StoreError
        A chunk is damaged or gone.
    """
    frame = int(dataset.indices[index])
    source, selection = dataset.source, dataset.selection
    if dataset.dtype == "stored":
        for name in selection.images:
            place = batch[name][position]
            flat = place[0] if CHANNELS[name] == 1 else place.permute(1, 2, 0)
            source.stored(name, frame, flat.numpy())
        if selection.label:
            source.stored("label", frame, batch["label"][position].numpy())
    else:
        for name, place in _places(dataset, batch, position):
            source.scaled(name, frame, dataset.scaling, place)
        if selection.label:
            source.label(frame, batch["label"][position])
    tables = dataset.store.tables
    batch["id"][position] = dataset.ids[index]
    batch["intrinsics"][position] = torch.from_numpy(tables.intrinsics[frame])
    batch["size"][position] = torch.from_numpy(tables.image_size[frame])


def _places(dataset: StoreDataset, batch: Batch, position: int) -> list[tuple[str, Tensor]]:
    """Return each modality's part of the tensors of one frame."""
    selection = dataset.selection
    if not selection.inputs:
        return [(name, batch[name][position]) for name in selection.images]
    inputs = batch["inputs"]
    tensors = inputs if isinstance(inputs, tuple) else (inputs,)
    places: list[tuple[str, Tensor]] = []
    for group, tensor in zip(selection.inputs, tensors, strict=True):
        parts = torch.split(tensor[position], [CHANNELS[name] for name in group])
        places += zip(group, parts, strict=True)
    return places
