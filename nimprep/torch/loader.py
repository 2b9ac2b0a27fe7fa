"""Batches decoded by threads of this process, without the copies between processes."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from nimprep.errors import ArrayError
from nimprep.parallel import available_cores, in_order, threads_for
from nimprep.torch.collation import Batch, collate
from nimprep.torch.dataset import StoreDataset
from nimprep.torch.ranks import part_of, ranks
from nimprep.torch.setups import check_dtype


class _Pending:
    """Hold a batch in the works: its tensors, or None with a transform, and its frames' tasks."""

    def __init__(self, batch: Batch | None, tasks: list[Future[Any]], pinned: bool) -> None:
        self.batch = batch
        self._tasks = tasks
        self._pinned = pinned

    def cancel(self) -> None:
        """Drop the frames that have not begun."""
        for task in self._tasks:
            task.cancel()

    def result(self) -> dict[str, Any]:
        """Wait for every frame; an error in one of them is raised here."""
        results = [task.result() for task in self._tasks]
        if self.batch is not None:
            return dict(self.batch)
        batch = collate(results)
        return {name: _pinned(value) for name, value in batch.items()} if self._pinned else batch


def _pinned(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(_pinned(part) for part in value)
    return value.pin_memory() if isinstance(value, Tensor) else value


def _as(dataset: StoreDataset, dtype: Literal["float32", "stored"]) -> StoreDataset:
    """Return the dataset with another dtype; the given one stays as it is."""
    check_dtype(dtype, dataset.selection, dataset.transform)
    changed = copy.copy(dataset)
    changed.dtype = dtype
    return changed


class StoreLoader:
    """Iterate over a dataset in batches, as `torch.utils.data.DataLoader` does.

    Threads decompress straight into the batch's tensors and convert on the way, with the GIL
    released; no sample passes between processes. Every iteration is one epoch; epochs count up by
    themselves, unless `set_epoch` says which comes next. The order depends on (seed, epoch) alone,
    samples on (the dataset's seed, epoch, index), neither on the number of threads.

    Where `torch.distributed` is initialised and no sampler is given, each process gets its own part
    of every epoch, as `DistributedSampler` would deal them: all parts of one length, for which some
    samples come twice where they do not divide evenly (a warning says how many). For scores of a
    whole split in each process, turn that off with ``distributed=False``.

    A batch stays valid for as long as it is held. Its memory is used again once it is not.

    Parameters
    ----------
    dataset : StoreDataset
    batch_size : int
    shuffle : bool
    num_threads : int, optional
        None = the cores this process may use; from a URL at least 16, which mostly wait.
    prefetch : int
        Batches in the works ahead of the one handed out.
    drop_last : bool
        Leave out the last batch where it is not full.
    seed : int
        Of the order.
    generator : torch.Generator, optional
        Draws the seed once, in place of `seed`.
    sampler : iterable of int, optional
        Gives the order, in place of `shuffle`; its `set_epoch` is called where it has one
        (`DistributedSampler`).
    pin_memory : bool, optional
        None = where there is a GPU.
    reuse_buffers : bool
        Fill a batch's tensors anew as soon as the next is asked for: saves what allocating costs,
        and a batch kept for longer changes.
    dtype : {"float32", "stored"}, optional
        In place of the dataset's.
    distributed : bool
        Whether the processes of a distributed run share the frames; a sampler decides that itself.

    Raises
    ------
    TypeError
        The dataset is no `StoreDataset`: the path of a store makes one.
    ArrayError
        A number is not positive, or `shuffle` and `sampler` are both given.
    """

    def __init__(
        self,
        dataset: StoreDataset,
        batch_size: int = 1,
        shuffle: bool = False,
        num_threads: int | None = None,
        prefetch: int = 2,
        *,
        drop_last: bool = False,
        seed: int = 0,
        generator: torch.Generator | None = None,
        sampler: Iterable[int] | None = None,
        pin_memory: bool | None = None,
        reuse_buffers: bool = False,
        dtype: Literal["float32", "stored"] | None = None,
        distributed: bool = True,
    ) -> None:
        if not isinstance(dataset, StoreDataset):
            raise TypeError(
                f"dataset: expected a StoreDataset, found {type(dataset).__name__}; make one with "
                "StoreDataset(store, ...), or give another dataset to torch's DataLoader"
            )
        threads = num_threads
        if threads is None:
            threads = max(available_cores(), dataset.store.storage.parallel)
        for name, number in (
            ("batch_size", batch_size),
            ("num_threads", threads),
            ("prefetch", prefetch),
        ):
            if isinstance(number, bool) or not isinstance(number, int) or number < 1:
                raise ArrayError(f"{name}: expected an integer >= 1, found {number!r}")
        if shuffle and sampler is not None:
            raise ArrayError("shuffle: expected False with a sampler, found True")
        if generator is not None:
            seed = int(torch.randint(2**63 - 1, (), generator=generator))
        self.dataset = dataset if dtype is None else _as(dataset, dtype)
        self.batch_size = batch_size
        self.num_threads = threads
        self.prefetch = prefetch
        self.drop_last = drop_last
        self.pin_memory = torch.cuda.is_available() if pin_memory is None else pin_memory
        self.reuse_buffers = reuse_buffers
        self._shuffle = shuffle
        self._sampler = sampler
        self._distributed = distributed and sampler is None
        self._seed = seed
        self._epoch = 0
        self._start = 0
        self._begun = False
        self._said = False

    def __len__(self) -> int:
        total = self._samples()
        return total // self.batch_size if self.drop_last else -(-total // self.batch_size)

    def _samples(self) -> int:
        if self._sampler is not None:
            return len(self._sampler)  # type: ignore[arg-type]
        return -(-len(self.dataset) // self._ranks()[1])

    def _ranks(self) -> tuple[int, int]:
        return ranks() if self._distributed else (0, 1)

    def _own(self, order: list[int]) -> list[int]:
        """Return this process's part of an epoch's order, and say once what comes twice."""
        rank, count = self._ranks()
        part = part_of(order, rank, count)
        twice = len(part) * count - len(order)
        if twice and rank == 0 and not self._said:
            self._said = True
            warnings.warn(
                f"{len(order)} samples over {count} processes: {twice} come twice in an epoch, so "
                f"that each has {len(part)}; distributed=False gives every process all of them",
                stacklevel=4,
            )
        return part

    def set_epoch(self, epoch: int) -> None:
        """Say which epoch the next iteration is; it starts at its beginning."""
        self._epoch, self._start, self._begun = epoch, 0, False

    def state_dict(self) -> dict[str, int]:
        """Return where the iteration stands: the epoch, batches handed out of it, the seed."""
        return {"epoch": self._epoch, "batch": self._start, "seed": self._seed}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Let the next iteration go on where the state was taken."""
        self._epoch, self._start, self._seed = state["epoch"], state["batch"], state["seed"]
        self._begun = False

    def __iter__(self) -> Iterator[dict[str, Any]]:
        if self._begun:
            self.set_epoch(self._epoch + 1)
        self._begun = True
        batches = self._batches()[self._start :]
        return self._run(batches, self._epoch)

    def _batches(self) -> list[list[int]]:
        """Return the indices of each of the epoch's batches."""
        if self._sampler is not None:
            if hasattr(self._sampler, "set_epoch"):
                self._sampler.set_epoch(self._epoch)
            order = [int(index) for index in self._sampler]
        elif self._shuffle:
            random = np.random.default_rng((self._seed, self._epoch))
            order = random.permutation(len(self.dataset)).tolist()
        else:
            order = list(range(len(self.dataset)))
        if self._sampler is None:
            order = self._own(order)
        size = self.batch_size
        batches = [order[i : i + size] for i in range(0, len(order), size)]
        if self.drop_last and batches and len(batches[-1]) < size:
            batches.pop()
        return batches

    def _run(self, batches: list[list[int]], epoch: int) -> Iterator[dict[str, Any]]:
        spare: list[Batch] = []

        def submit(indices: list[int]) -> _Pending:
            return self._submit(pool, indices, epoch, spare)

        # Left by an error and by leaving the loop too; waits for the frames in the works.
        with threads_for(self.num_threads, "nimprep-loader") as pool:
            for pending in in_order(submit, batches, self.prefetch + 1, "StoreLoader"):
                batch = pending.result()
                self._start += 1
                yield batch
                if self.reuse_buffers and pending.batch is not None:
                    spare.append(pending.batch)
        self._epoch, self._start, self._begun = epoch + 1, 0, False

    def _submit(
        self, pool: ThreadPoolExecutor, items: list[int], epoch: int, spare: list[Batch]
    ) -> _Pending:
        dataset = self.dataset
        if dataset.transform is not None:
            samples = [pool.submit(dataset.sample, item, epoch) for item in items]
            return _Pending(None, samples, self.pin_memory)
        if spare and len(spare[0]["id"]) == len(items):
            batch = spare.pop(0)
        else:
            # Threads fill it, in which no inference mode holds that its user may be in.
            with torch.inference_mode(False):
                batch = dataset.allocate(len(items), pinned=self.pin_memory)
        filled = [
            pool.submit(dataset.fill, batch, position, item) for position, item in enumerate(items)
        ]
        return _Pending(batch, filled, self.pin_memory)
