"""The float work of a batch as stored, on the device it was moved to."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from nimprep.modality import Modality
from nimprep.plane import values_of
from nimprep.torch.dataset import StoreDataset
from nimprep.torch.setups import channels_of


class Normalize(nn.Module):
    """Turn a batch of a dataset with ``dtype="stored"`` into what its float32 twin would give.

    Stored integers are a quarter of the bytes to decode into, to pin and to send to a GPU.

    Parameters
    ----------
    dataset : StoreDataset
        Whose setup and normalisation to apply; it is not kept.
    """

    def __init__(self, dataset: StoreDataset) -> None:
        super().__init__()
        self.selection = dataset.selection
        self.scaling = dataset.scaling
        self.modalities = {n: dataset.images.modality(n) for n in self.selection.modalities}

    def forward(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Return the batch with float32 inputs and int64 labels, on the device it is on.

        Parameters
        ----------
        batch : dict
            Of rgb, hha (B, 3, H, W) uint8, depth, disparity (B, 1, H, W) uint16,
            transformed_disparity, elevation (B, 1, H, W) int16, all in the steps of
            `nimprep.modality`, depth in the store's, planes (B, 1, H, W) of their dtype, normal
            (B, 3, H, W) int8 or int16, label (B, H, W) uint8, as far as the setup has them. One
            sample without B will do as well.

        Returns
        -------
        dict
            "inputs" as the setup says, or a tensor per name; "label" (B, H, W) int64; the rest
            as it was.
        """
        images = self.selection.images
        out = {name: value for name, value in batch.items() if name not in images}
        out.pop("label", None)
        tensors = tuple(self._joined(group, batch) for group in self.selection.groups)
        if not self.selection.inputs:
            out |= dict(zip(images, tensors, strict=True))
        else:
            out["inputs"] = tensors[0] if len(tensors) == 1 else tensors
        if self.selection.label:
            out["label"] = batch["label"].to(torch.int64)
        return out

    def _joined(self, group: tuple[str, ...], batch: dict[str, Tensor]) -> Tensor:
        first = batch[group[0]]
        channels = [channels_of(name) for name in group]
        shape = (*first.shape[:-3], sum(channels), *first.shape[-2:])
        out = torch.empty(shape, dtype=torch.float32, device=first.device)
        for name, part in zip(group, torch.split(out, channels, dim=-3), strict=True):
            self.scaling.apply(name, _physical(self.modalities[name], batch[name]), part)
        return out


def _physical(modality: Modality, stored: Tensor) -> Tensor:
    """Return numbers in their units and vectors of unit length; colours as they are."""
    if modality.values == "measures" and not modality.is_plain:
        # A table of all integers: exactly what a frame has, and none as NaN.
        numbers = torch.from_numpy(values_of(modality).copy()).to(stored.device)
        return numbers[stored.to(torch.int64) % len(numbers)]
    if modality.values == "numbers":
        numbers = stored.to(torch.float32) / modality.steps
        return numbers.masked_fill(stored == modality.fill, torch.nan) if modality.fill else numbers
    if modality.values != "vectors":
        return stored
    vectors = stored.to(torch.float32)
    # The integers' squares sum to 0 or to 1 at least.
    return vectors / (vectors * vectors).sum(dim=-3, keepdim=True).clamp(min=1).sqrt()
