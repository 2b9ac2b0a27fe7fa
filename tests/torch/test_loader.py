import os
import select
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader, DistributedSampler

from nimprep import open_store
from nimprep.errors import ArrayError, NimprepError, StoreError
from nimprep.torch import StoreDataset, StoreLoader
from tests.torch.stores import FRAMES, make_store


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


def jitter(sample: dict[str, object]) -> dict[str, object]:
    """Add one random number to the colours."""
    noise = torch.rand((), generator=sample["generator"])
    return {**sample, "rgb": sample["rgb"].to(torch.float32) + noise}


def ids(loader: StoreLoader) -> list[str]:
    return [frame_id for batch in loader for frame_id in batch["id"]]


def threads() -> int:
    return sum(t.name.startswith("nimprep-loader") for t in threading.enumerate())


@pytest.mark.parametrize("kind", [str, Path, open_store, lambda path: [1, 2], lambda path: None])
def test_what_is_no_dataset_is_told_what_makes_one(path: Path, kind: Callable[[Path], Any]) -> None:
    with pytest.raises(TypeError, match=r"expected a StoreDataset, found \w+; make one with Store"):
        StoreLoader(kind(path))


@pytest.mark.parametrize("transform", [None, jitter])
@pytest.mark.parametrize("fusion", [False, True])
@pytest.mark.parametrize("num_threads", [1, 3])
def test_batches_are_dataloaders(
    path: Path, transform: object, fusion: bool, num_threads: int
) -> None:
    dataset = StoreDataset(path, None, "rgb+d", fusion, transform)
    dataset.set_epoch(0)
    ours = list(StoreLoader(dataset, 4, num_threads=num_threads))
    theirs = list(DataLoader(dataset, 4))
    assert [len(batch["id"]) for batch in ours] == [4, 4, 2]
    for a, b in zip(ours, theirs, strict=True):
        assert a.keys() == b.keys()
        assert a["id"] == b["id"]
        for name in ("label", "intrinsics", "size"):
            assert torch.equal(a[name], b[name])
        parts = zip(a["inputs"], b["inputs"], strict=True)
        assert all(torch.equal(x, y) for x, y in parts)


@pytest.mark.parametrize(("drop_last", "count"), [(False, 4), (True, 3)])
def test_its_length_is_the_number_of_batches(path: Path, drop_last: bool, count: int) -> None:
    loader = StoreLoader(StoreDataset(path, None, "rgb"), 3, drop_last=drop_last)
    assert len(loader) == count == len(list(loader))


def test_the_order_depends_on_seed_and_epoch_alone(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    loader = StoreLoader(dataset, 3, shuffle=True, num_threads=2)
    first, second = ids(loader), ids(loader)
    assert sorted(first) == sorted(second) == sorted(dataset.ids)
    assert first != second
    loader.set_epoch(0)
    assert ids(loader) == first
    assert ids(StoreLoader(dataset, 5, shuffle=True, num_threads=1)) == first
    assert ids(StoreLoader(dataset, 3, shuffle=True, seed=1)) != first
    by_generator = [
        ids(StoreLoader(dataset, 3, shuffle=True, generator=torch.Generator().manual_seed(s)))
        for s in (5, 5, 6)
    ]
    assert by_generator[0] == by_generator[1] != by_generator[2]


def test_samples_are_the_same_on_any_number_of_threads(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=jitter)

    def colours(num_threads: int) -> list[dict[str, torch.Tensor]]:
        loader = StoreLoader(dataset, 3, shuffle=True, num_threads=num_threads)
        return [
            {i: x for batch in loader for i, x in zip(batch["id"], batch["inputs"], strict=True)}
            for _ in range(2)
        ]

    one, four = colours(1), colours(4)
    for a, b in zip(one, four, strict=True):
        assert a.keys() == b.keys()
        assert all(torch.equal(a[i], b[i]) for i in a)
    assert not torch.equal(one[0]["000000"], one[1]["000000"])


def test_iteration_goes_on_where_a_state_was_taken(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=jitter)
    loader = StoreLoader(dataset, 3, shuffle=True, seed=7)
    list(loader)
    iterator = iter(loader)
    next(iterator), next(iterator)
    state = loader.state_dict()
    assert state == {"epoch": 1, "batch": 2, "seed": 7}
    rest, following = list(iterator), list(loader)
    resumed = StoreLoader(dataset, 3, shuffle=True)
    resumed.load_state_dict(state)
    for expected in (rest, following):
        found = list(resumed)
        assert [b["id"] for b in found] == [b["id"] for b in expected]
        for a, b in zip(found, expected, strict=True):
            assert torch.equal(a["inputs"], b["inputs"])


def test_a_state_between_epochs_is_the_next_ones_beginning(path: Path) -> None:
    loader = StoreLoader(StoreDataset(path, None, "rgb"), 4)
    list(loader)
    assert loader.state_dict() == {"epoch": 1, "batch": 0, "seed": 0}


def test_batches_stay_as_they_are_while_they_are_held(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb+d")
    held = list(StoreLoader(dataset, 1, prefetch=1))
    for i, batch in enumerate(held):
        assert torch.equal(batch["inputs"][0], dataset[i]["inputs"])


def test_reused_buffers_are_few_and_right_when_handed_out(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb+d")
    loader = StoreLoader(dataset, 1, prefetch=2, reuse_buffers=True)
    places, held = set(), []
    for i, batch in enumerate(loader):
        assert torch.equal(batch["inputs"][0], dataset[i]["inputs"])
        assert batch["id"] == [dataset.ids[i]]
        places.add(batch["inputs"].data_ptr())
        held.append(batch)
    assert len(places) <= 4 < FRAMES == len(held)


def test_leaving_the_loop_leaves_no_thread(path: Path) -> None:
    loader = StoreLoader(StoreDataset(path, None, "rgb"), 1, num_threads=3)
    for _ in loader:
        assert threads() > 0
        break
    assert threads() == 0


def test_an_error_in_a_thread_surfaces_where_the_batch_would(tmp_path: Path) -> None:
    path = make_store(tmp_path, shard_length=1)
    shard = next(p for p in (path / "depth" / "c" / "5").rglob("*") if p.is_file())
    shard.write_bytes(shard.read_bytes()[:-9])
    batches = iter(StoreLoader(StoreDataset(path, None, "rgb+d"), 2, num_threads=2))
    assert [next(batches)["id"] for _ in range(2)] == [["000000", "000001"], ["000002", "000003"]]
    with pytest.raises(StoreError, match="depth/c/5"):
        next(batches)
    assert threads() == 0


def test_an_error_in_a_transform_surfaces_too(path: Path) -> None:
    def broken(sample: dict[str, object]) -> dict[str, object]:
        raise ZeroDivisionError("broken")

    with pytest.raises(ZeroDivisionError, match="broken"):
        list(StoreLoader(StoreDataset(path, None, "rgb", transform=broken), 2))
    assert threads() == 0


def test_a_sampler_gives_the_order(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    assert ids(StoreLoader(dataset, 2, sampler=[3, 1, 2])) == ["000003", "000001", "000002"]
    samplers = [DistributedSampler(dataset, 2, rank, shuffle=True) for rank in range(2)]
    loaders = [StoreLoader(dataset, 2, sampler=sampler) for sampler in samplers]
    assert len(loaders[0]) == 3
    epochs = [[i for loader in loaders for i in ids(loader)] for _ in range(2)]
    assert sorted(epochs[0]) == sorted(epochs[1]) == sorted(dataset.ids)
    assert epochs[0] != epochs[1]


def test_the_loader_can_ask_for_samples_as_stored(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    batch = next(iter(StoreLoader(dataset, 2, dtype="stored")))
    assert batch["rgb"].dtype == torch.uint8
    assert dataset.dtype == "float32"
    with pytest.raises(ArrayError, match="dtype: expected 'float32' with a transform"):
        StoreLoader(StoreDataset(path, None, "rgb", transform=jitter), dtype="stored")


@pytest.mark.parametrize(
    "options",
    [
        {"batch_size": 0},
        {"num_threads": 0},
        {"prefetch": 0},
        {"batch_size": 1.5},
        {"shuffle": True, "sampler": [0]},
    ],
)
def test_what_is_no_option_is_refused(path: Path, options: dict[str, object]) -> None:
    with pytest.raises(ArrayError, match=f"{next(iter(options))}: expected"):
        StoreLoader(StoreDataset(path, None, "rgb"), **options)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="only systems with fork can do this")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("taken", [0, 1])
def test_an_iterator_that_comes_to_a_process_by_a_fork_is_refused_there(
    path: Path, taken: int
) -> None:
    batches = iter(StoreLoader(StoreDataset(path, None, "rgb"), 2, num_threads=1))
    first = next(batches)
    rest = [next(batches) for _ in range(taken)]
    source, sink = os.pipe()
    child = os.fork()
    if child == 0:
        # Nothing of pytest's may run here: the answer goes through the pipe, and that is all.
        try:
            next(batches)
            said = "went on"
        except NimprepError as error:
            said = str(error)
        except BaseException as error:
            said = repr(error)
        os.write(sink, said.encode())
        os._exit(0)
    os.close(sink)
    answered = select.select([source], [], [], 60)[0]
    os.kill(child, signal.SIGKILL) if not answered else None
    said = os.read(source, 1000).decode() if answered else "hung"
    os.waitpid(child, 0)
    os.close(source)
    assert said.startswith("StoreLoader: expected its iterator in the process that began it")
    assert f"forked from there, {child}" in said
    left = [batch["id"] for batch in (first, *rest, *batches)]
    assert [i for some in left for i in some] == list(StoreDataset(path, None, "rgb").store.ids)


def test_a_loader_can_be_gone_through_in_inference_mode(path) -> None:
    data = StoreDataset(path, None, "nim-rgb+d")
    plain = [batch["inputs"] for batch in StoreLoader(data, 3)]
    with torch.inference_mode():
        found = [batch["inputs"] for batch in StoreLoader(data, 3)]
    assert len(found) == len(plain)
    assert all(torch.equal(a, b) for a, b in zip(found, plain, strict=True))
