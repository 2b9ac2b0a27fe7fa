"""Several processes, one training: what torchrun starts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
import torch.distributed as dist

from nimprep.errors import ArrayError
from nimprep.torch.ranks import ranks


def device_from(name: str) -> torch.device:
    """Return the device of this process; "auto" is a GPU where there is one.

    Of several processes on one machine each takes its own GPU.

    Raises
    ------
    ArrayError
        There is no such device here.
    """
    local = int(os.environ.get("LOCAL_RANK", "0"))
    if name == "auto":
        if not torch.cuda.is_available():
            return torch.device("cpu")
        name = "cuda"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ArrayError(
            f"device: expected auto, cpu, cuda or a number of one, cuda:1, found {name!r}"
        ) from error
    if device.type != "cuda":
        if device.type not in ("cpu", "mps"):
            raise ArrayError(f"device: expected auto, cpu or cuda, found {name!r}")
        return device
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    index = local if device.index is None else device.index
    if index >= count:
        raise ArrayError(f"device: expected one of {count} GPUs, found {name!r}; give cpu")
    return torch.device("cuda", index)


@contextmanager
def process_group(device: torch.device) -> Iterator[None]:
    """Join the processes that torchrun started, for the context; alone where it started none."""
    asked = {"RANK", "WORLD_SIZE", "MASTER_ADDR"} <= os.environ.keys()
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if not asked or not dist.is_available() or dist.is_initialized():
        yield
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield
    finally:
        dist.destroy_process_group()


def is_first() -> bool:
    """Tell whether this is the process that writes and speaks."""
    return ranks()[0] == 0


def shared(value: Any) -> Any:
    """Return the first process's value in every one."""
    if ranks()[1] == 1:
        return value
    box = [value]
    dist.broadcast_object_list(box)
    return box[0]


def summed(tensor: torch.Tensor) -> torch.Tensor:
    """Return the sum over all processes, in every one."""
    if ranks()[1] > 1:
        dist.all_reduce(tensor)
    return tensor
