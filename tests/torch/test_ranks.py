"""Two processes of one training run, and how they share an epoch."""

import json
import sys
from pathlib import Path

import pytest
import torch
from torch.utils.data import DistributedSampler

import nimprep
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.ranks import part_of
from tests.fakes import write_gmrp
from tests.processes import PATIENCE_S, Processes, same_code
from tests.torch.stores import CAMERA, FRAMES, make_store

RANK = """
import json, sys, warnings
import torch.distributed as dist
from torch.utils.data import DistributedSampler
from nimprep.torch import StoreDataset, StoreLoader

path, rank, meeting = sys.argv[1], int(sys.argv[2]), sys.argv[3]
dataset = StoreDataset(path, None, "rgb")
early = StoreLoader(dataset, 2, shuffle=True)
dist.init_process_group("gloo", init_method=f"file://{meeting}", rank=rank, world_size=2)
ids = lambda batches: [i for batch in batches for i in batch["id"]]
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    loader = StoreLoader(dataset, 2, shuffle=True)
    found = {"length": len(loader), "epochs": [ids(loader), ids(loader)]}
    found["made before"] = ids(early)
    uneven = StoreLoader(StoreDataset(sys.argv[4], None, "rgb"), 2)
    found["uneven"] = [ids(uneven), ids(uneven)]
    found["said"] = [str(w.message) for w in caught if "twice" in str(w.message)]
found["plain order"] = ids(StoreLoader(dataset, 2))
found["theirs"] = ids(StoreLoader(dataset, 2, sampler=DistributedSampler(dataset, shuffle=False)))
found["whole"] = ids(StoreLoader(dataset, 2, distributed=False))
batches = iter(loader)
first = next(batches)["id"]
again = StoreLoader(dataset, 2, shuffle=True)
again.load_state_dict(loader.state_dict())
found["resumed"] = [first + ids(batches), first + ids(again)]
dist.barrier()
dist.destroy_process_group()
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def uneven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("uneven")
    return nimprep.convert(write_gmrp(root / "raw", frames=5), root / "s.zarr", camera=CAMERA).path


@pytest.fixture(scope="module")
def found(path: Path, uneven: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, dict]:
    """Return what each of two processes got."""
    meeting = tmp_path_factory.mktemp("meeting") / "place"
    with Processes() as processes:
        started = [
            processes.start(
                [sys.executable, "-c", RANK, path, rank, meeting, uneven],
                stdout=-1,
                stderr=-1,
                text=True,
                env=same_code(),
            )
            for rank in range(2)
        ]
        said = [process.communicate(timeout=PATIENCE_S) for process in started]
    assert [process.returncode for process in started] == [0, 0], said
    a, b = (json.loads(out) for out, _ in said)
    return a, b


def test_an_epoch_is_shared_and_each_is_shuffled_anew(path: Path, found: tuple) -> None:
    every = sorted(StoreDataset(path, None, "rgb").ids)
    for epoch in range(2):
        assert sorted(found[0]["epochs"][epoch] + found[1]["epochs"][epoch]) == every
    assert found[0]["epochs"][0] != found[0]["epochs"][1]
    assert [f["length"] for f in found] == [3, 3]


def test_a_loader_made_before_the_processes_met_shares_too(path: Path, found: tuple) -> None:
    assert [f["made before"] for f in found] == [f["epochs"][0] for f in found]


def test_parts_are_those_of_a_distributed_sampler(found: tuple) -> None:
    assert [f["plain order"] for f in found] == [f["theirs"] for f in found]


def test_what_does_not_divide_is_filled_up_and_said_once(uneven: Path, found: tuple) -> None:
    ids = StoreDataset(uneven, None, "rgb").ids
    for epoch in range(2):
        assert found[0]["uneven"][epoch] == list(ids[::2])
        assert found[1]["uneven"][epoch] == [*ids[1::2], ids[0]]
    (said,) = found[0]["said"]
    assert f"{len(ids)} samples over 2 processes: 1 come twice" in said
    assert "distributed=False" in said
    assert found[1]["said"] == []


def test_it_can_be_turned_off(path: Path, found: tuple) -> None:
    assert [f["whole"] for f in found] == [list(StoreDataset(path, None, "rgb").ids)] * 2


def test_each_process_goes_on_in_the_middle_of_an_epoch(found: tuple) -> None:
    for of_one in found:
        assert of_one["resumed"][0] == of_one["resumed"][1]
        assert len(of_one["resumed"][0]) == FRAMES // 2


@pytest.mark.parametrize("length", [0, 1, 2, 7, 12])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_every_part_is_the_samplers(length: int, count: int) -> None:
    order = torch.randperm(length).tolist()
    for rank in range(count):
        sampler = DistributedSampler(range(length), count, rank, shuffle=False)
        expected = [order[i] for i in sampler] if length else []
        assert part_of(order, rank, count) == expected


def test_without_a_distributed_run_nothing_is_left_out(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    assert [i for batch in StoreLoader(dataset, 3) for i in batch["id"]] == list(dataset.ids)
