"""Cases 33 to 35, 41, 42 and 46: stores in PyTorch's hands, in the ways people use them."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, WeightedRandomSampler

import nimprep
from nimprep.torch import NIM, StoreDataset, StoreLoader
from nimprep.torch.transforms import Compose, RandomCrop, RandomHorizontalFlip
from tests.cases.cases import case_scene, nimprep_run
from tests.processes import PATIENCE_S, Processes
from tests.torch.vision import transforms as torchvision_transforms

Case = Callable[[str], Path]

FLIP_AND_CROP = Compose([RandomCrop(48, 64), RandomHorizontalFlip()])

RANK = """
import json, sys
import torch.distributed as dist
from torch.utils.data import DataLoader, DistributedSampler
from nimprep.torch import StoreDataset, StoreLoader

dataset = StoreDataset(sys.argv[1], None, "rgb")
dist.init_process_group(
    "gloo", init_method="file://" + sys.argv[3], rank=int(sys.argv[2]), world_size=2
)
sampler = DistributedSampler(dataset)
loaders = {
    "shuffled": StoreLoader(dataset, 2, shuffle=True),
    "sampler": StoreLoader(dataset, 2, sampler=sampler),
    "theirs": DataLoader(dataset, batch_size=2, sampler=sampler),
}
print(json.dumps({n: [i for batch in each for i in batch["id"]] for n, each in loaders.items()}))
dist.barrier()
dist.destroy_process_group()
"""


def stored(root: Path) -> Path:
    return nimprep.convert(root, root.parent / "s.zarr").path


def draws(batches: Iterable[dict[str, Any]]) -> dict[str, tuple[float, ...]]:
    """Return each frame's intrinsics, which a crop moves and a flip mirrors."""
    return {
        i: tuple(k.flatten().tolist())
        for batch in batches
        for i, k in zip(batch["id"], batch["intrinsics"], strict=True)
    }


@pytest.mark.parametrize(
    "loading",
    [
        {},
        {"num_workers": 2, "multiprocessing_context": "spawn"},
        {"num_workers": 2, "multiprocessing_context": "spawn", "persistent_workers": True},
        None,
    ],
)
def test_case_33_every_epoch_draws_anew(case: Case, loading: dict[str, Any] | None) -> None:
    torch.manual_seed(0)
    dataset = StoreDataset(stored(case("33-")), None, "nim-rgb+d", transform=FLIP_AND_CROP)
    loader = (
        StoreLoader(dataset, 4, shuffle=True)
        if loading is None
        else DataLoader(dataset, batch_size=4, shuffle=True, **loading)
    )
    first, second = draws(loader), draws(loader)
    assert first.keys() == second.keys() == set(dataset.store.ids)
    # Of 33 x 49 x 2 crops and flips.
    assert sum(first[i] == second[i] for i in first) <= 1


def test_case_34_each_rank_has_its_half(case: Case, tmp_path: Path) -> None:
    path = stored(case("34-"))
    with Processes() as processes:
        command = [sys.executable, "-c", RANK, path]
        ranks = [
            processes.start([*command, rank, tmp_path / "meeting"], stdout=-1) for rank in range(2)
        ]
        told = [json.loads(rank.communicate(timeout=PATIENCE_S)[0]) for rank in ranks]
    for name in ("shuffled", "sampler", "theirs"):
        ours, theirs = (found[name] for found in told)
        assert (len(ours), len(theirs)) == (6, 6)
        assert set(ours) | set(theirs) == {f"{i:06d}" for i in range(12)}


def test_case_35_pixels_per_class_give_weights(case: Case) -> None:
    path = stored(case("35-"))
    dataset = StoreDataset(path, "train", "rgb")
    ids = [i for i, split in dataset.store.splits.items() if split == "train"]
    labels = np.stack([case_scene(int(i))[2] for i in ids])
    pixels = np.array([(labels == k).sum() for k in range(3)])
    told = json.loads(nimprep_run("info", path, "--json").stdout)["label_pixels"]["train"]
    assert [told[str(k)] for k in range(3)] == pixels.tolist()
    there = np.array([labels[(labels == k).any(axis=(1, 2))].size for k in range(3)])
    share = pixels / there
    wanted = np.median(share) / share
    np.testing.assert_allclose(dataset.class_weights("median").numpy(), wanted, rtol=1e-6)
    assert wanted[2] > 10 * wanted[1]


def test_case_41_torchvision_moves_all_images_or_is_refused(case: Case) -> None:
    v2 = torchvision_transforms()
    path, names = stored(case("41-")), ("rgb", "depth", "normal", "label")
    plain = StoreDataset(path, None, modalities=names)[0]
    flipped = StoreDataset(path, None, modalities=names, transform=v2.RandomHorizontalFlip(1.0))[0]
    for name in ("rgb", "depth", "label"):
        assert torch.equal(flipped[name], plain[name].flip(-1))
    mirrored = plain["normal"].flip(-1) * torch.tensor([-1.0, 1, 1])[:, None, None]
    assert torch.equal(flipped["normal"], mirrored)
    assert flipped["intrinsics"][0, 2] == 127 - plain["intrinsics"][0, 2]
    cut = StoreDataset(path, None, modalities=names, transform=v2.RandomCrop((48, 64)))[0]
    left, top = (plain["intrinsics"] - cut["intrinsics"])[:2, 2].to(int).tolist()
    for name in names:
        assert torch.equal(cut[name], plain[name][..., top : top + 48, left : left + 64])


def test_case_42_ignored_pixels_need_ignore_index(case: Case) -> None:
    batch = next(iter(StoreLoader(StoreDataset(stored(case("42-")), None, "rgb"), 2)))
    assert (batch["label"][:, :4] == 255).all()
    assert (batch["label"][:, 4:] < 3).all()
    scores = torch.zeros(2, 3, 96, 128)
    with pytest.raises(IndexError, match="Target 255 is out of bounds"):
        torch.nn.functional.cross_entropy(scores, batch["label"])
    loss = torch.nn.functional.cross_entropy(scores, batch["label"], ignore_index=255)
    assert loss.item() == pytest.approx(np.log(3))
    readme = (Path(__file__).parents[2] / "README.md").read_text()
    assert "ignore_index=255" in readme


def test_case_46_samplers_sizes_workers_and_compilation(case: Case) -> None:
    dataset = StoreDataset(stored(case("46-")), None, "nim-rgb+d")
    only = WeightedRandomSampler([1.0] + [0.0] * 8, 6)
    assert {i for b in StoreLoader(dataset, 2, sampler=only) for i in b["id"]} == {"000000"}
    small = dataset[8]
    assert small["size"].tolist() == [80, 112]
    batch = next(iter(StoreLoader(dataset, 9)))
    assert batch["inputs"].shape[-2:] == (96, 128)
    assert (batch["label"][8, 80:] == 255).all()
    assert (batch["label"][8, :, 112:] == 255).all()
    assert np.array_equal(batch["label"][8, :80, :112], case_scene(9, 80, 112)[2])
    spawned = DataLoader(dataset, batch_size=4, num_workers=2, multiprocessing_context="spawn")
    assert [i for b in spawned for i in b["id"]] == list(dataset.store.ids)
    depth, k = torch.rand(1, 1, 24, 32) + 1, torch.tensor([[[30.0, 0, 15], [0, 30, 11], [0, 0, 1]]])
    assert torch.equal(torch.compile(NIM(), backend="eager")(depth, k), NIM()(depth, k))
