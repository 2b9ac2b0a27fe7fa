"""Samples and batches, and how the one becomes the other under any DataLoader."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import get_worker_info
from torch.utils.data._utils.collate import default_collate_fn_map

from nimprep.errors import ArrayError
from nimprep.store.buffers import empty


class Sample(dict[str, Any]):
    """One frame's tensors by name; a dict that DataLoader's own collation knows how to batch."""


class Batch(dict[str, Any]):
    """Several frames' tensors by name, as `StoreDataset.__getitems__` returns them.

    DataLoader hands this to its `collate_fn`, and the default one looks at element 0 to see what
    it has: that is a `Sample`, for which `collate` is registered, and that leaves a batch alone.
    """

    def __missing__(self, key: object) -> Sample:
        if key != 0:
            raise KeyError(key)
        return Sample()


def collate(batch: Batch | Sequence[dict[str, Any]], **_: Any) -> dict[str, Any]:
    """Make one batch of samples; a batch already made is returned as it is.

    Returns
    -------
    dict
        The samples' names; tensors stacked, pairs of tensors kept as pairs, ids as a list.

    Raises
    ------
    ArrayError
        The samples' images differ in size.
    """
    if isinstance(batch, Batch):
        return dict(batch)
    return {name: _stacked(name, [sample[name] for sample in batch]) for name in batch[0]}


def _stacked(name: str, values: list[Any]) -> Any:
    first = values[0]
    if isinstance(first, tuple):
        return tuple(_stacked(name, list(part)) for part in zip(*values, strict=True))
    if not isinstance(first, Tensor):
        return values
    shapes = {tuple(value.shape) for value in values}
    if len(shapes) > 1:
        raise ArrayError(
            f"{name}: expected images of one size in a batch, found {sorted(shapes)}; "
            "let the transform crop or resize"
        )
    out = new_tensor((len(values), *first.shape), first.dtype)
    return torch.stack(values, out=out)


_NUMPY: dict[torch.dtype, str] = {
    torch.float32: "float32",
    torch.float64: "float64",
    torch.int64: "int64",
    torch.uint16: "uint16",
    torch.int16: "int16",
    torch.uint8: "uint8",
    torch.int8: "int8",
}


def new_tensor(shape: tuple[int, ...], dtype: torch.dtype, *, pinned: bool = False) -> Tensor:
    """Return an uninitialised tensor where it costs least to fill and to hand on.

    In a DataLoader's worker in shared memory, so that it need not be copied there; pinned, from
    PyTorch's own cache; else from memory that was used before (`nimprep.store.buffers`).
    """
    if pinned:
        return torch.empty(shape, dtype=dtype, pin_memory=True)
    if dtype not in _NUMPY:
        return torch.empty(shape, dtype=dtype)
    if get_worker_info() is None:
        return torch.from_numpy(empty(shape, _NUMPY[dtype]))
    count = 1
    for size in shape:
        count *= size
    storage = torch.UntypedStorage._new_shared(count * dtype.itemsize)  # type: ignore[no-untyped-call]
    return torch.empty(0, dtype=dtype).set_(storage).resize_(shape)


default_collate_fn_map[Sample] = collate
