"""What each process of a distributed run takes of an epoch."""

from __future__ import annotations

import torch.distributed


def ranks() -> tuple[int, int]:
    """Return this process's rank and how many there are: 0 of 1 where no run is distributed."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        return torch.distributed.get_rank(), torch.distributed.get_world_size()
    return 0, 1


def part_of(order: list[int], rank: int, count: int) -> list[int]:
    """Return a process's part of an epoch's order; all parts are of one length.

    As `torch.utils.data.DistributedSampler` deals them: every `count`-th, and where they do not
    come out even, the first ones again at the end.
    """
    if not order:
        return []
    total = -(-len(order) // count) * count
    return [order[i % len(order)] for i in range(rank, total, count)]
