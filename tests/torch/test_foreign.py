"""Transforms of torchvision and albumentations: every plane moves alike, or they are refused."""

from __future__ import annotations

import functools
import importlib
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import albumentations as A  # noqa: N812
import pytest
import torch
from torch.utils.data import DataLoader

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.transforms import (
    IMAGES,
    Albumentations,
    Compose,
    RandomHorizontalFlip,
    Torchvision,
    crop,
    flip,
    resize,
)
from nimprep.torch.transforms.composition import adapted
from tests.torch import vision
from tests.torch.stores import make_mixed_store, make_store

v2 = vision.transforms()
Mask = importlib.import_module("torchvision.tv_tensors").Mask

HEIGHT, WIDTH = 24, 32
NAN = float("nan")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_mixed_store(tmp_path_factory.mktemp("mixed"))


def sample(*names: str) -> dict[str, Any]:
    """Return noise in every plane, or in these."""
    byte = {"dtype": torch.uint8}
    shape = (HEIGHT, WIDTH)
    planes = {
        "rgb": torch.randint(0, 256, (3, *shape), **byte),
        "depth": 1 + 9 * torch.rand(1, *shape),
        "normal": torch.nn.functional.normalize(torch.randn(3, *shape), dim=0),
        "hha": torch.randint(0, 256, (3, *shape), **byte),
        "disparity": 60 * torch.rand(1, *shape),
        "transformed_disparity": torch.randn(1, *shape),
        "elevation": torch.randn(1, *shape),
        "label": torch.randint(0, 3, shape),
    }
    k = [[30.0, 0, 15.25], [0, 31, 11.5], [0, 0, 1]]
    return {
        **{n: p for n, p in planes.items() if not names or n in names},
        "intrinsics": torch.tensor(k, dtype=torch.float64),
        "size": shape,
        "id": "x",
        "generator": torch.Generator().manual_seed(3),
    }


def check_same(found: dict[str, Any], expected: dict[str, Any]) -> None:
    assert found["size"] == expected["size"]
    for name in (*IMAGES, "intrinsics"):
        torch.testing.assert_close(found[name], expected[name], rtol=1e-12, atol=0, equal_nan=True)


@pytest.mark.parametrize(
    "transform",
    [v2.RandomHorizontalFlip(1.0), A.HorizontalFlip(p=1.0), A.Compose([A.HorizontalFlip(p=1.0)])],
    ids=["torchvision", "albumentations", "composed"],
)
def test_a_flip_is_ours(transform: Any) -> None:
    before = sample()
    check_same(adapted(transform)(before), flip(before))


@pytest.mark.parametrize(
    "transform",
    [v2.CenterCrop((10, 12)), A.CenterCrop(10, 12)],
    ids=["torchvision", "albumentations"],
)
def test_a_crop_is_ours(transform: Any) -> None:
    before = sample()
    check_same(adapted(transform)(before), crop(before, 7, 10, 10, 12))


@pytest.mark.parametrize(
    "transform",
    [v2.RandomVerticalFlip(1.0), A.VerticalFlip(p=1.0)],
    ids=["torchvision", "albumentations"],
)
def test_upside_down_normals_are_turned_over_with_the_image(transform: Any) -> None:
    before = sample()
    after = adapted(transform)(before)
    signs = torch.tensor([1, -1, 1])[:, None, None]
    assert torch.equal(after["normal"], before["normal"].flip(1) * signs)
    assert torch.equal(after["label"], before["label"].flip(0))
    assert after["intrinsics"][1].tolist() == [0, 31, HEIGHT - 1 - 11.5]


@pytest.mark.parametrize("size", [(48, 64), (12, 16), (40, 27), (17, 90)])
@pytest.mark.parametrize("library", ["torchvision", "albumentations"])
def test_a_resized_samples_camera_is_that_of_the_whole_image(
    library: str, size: tuple[int, int]
) -> None:
    before = sample()
    transform = v2.Resize(size) if library == "torchvision" else A.Resize(*size)
    after = adapted(transform)(before)
    expected = resize(before, *size)
    torch.testing.assert_close(after["intrinsics"], expected["intrinsics"], rtol=1e-9, atol=1e-9)
    assert after["size"] == size
    # From one pixel, whichever of the nearest: disparity counts pixels of the width.
    pairs = dict(
        zip(before["depth"].flatten().tolist(), before["disparity"].flatten().tolist(), strict=True)
    )
    found = zip(
        after["depth"].flatten().tolist(), after["disparity"].flatten().tolist(), strict=True
    )
    for depth, disparity in found:
        assert disparity == pytest.approx(pairs[depth] * size[1] / WIDTH, rel=1e-5)


def test_a_window_that_is_resized_has_the_windows_camera() -> None:
    before = sample()
    after = Torchvision(v2.RandomResizedCrop((48, 64), scale=(0.3, 0.6)))(before)
    k, old = after["intrinsics"], before["intrinsics"]
    width, height = 64 * old[0, 0] / k[0, 0], 48 * old[1, 1] / k[1, 1]
    assert width == pytest.approx(round(width.item()))
    assert height == pytest.approx(round(height.item()))
    left = old[0, 2] - (k[0, 2] + 0.5) * width / 64 + 0.5
    assert left == pytest.approx(round(left.item()), abs=1e-9)


@pytest.mark.parametrize(
    "transform",
    [
        v2.Pad(4, fill={torch.Tensor: 0, "others": 9}),
        v2.Pad(4),
        A.Pad(4, fill_mask=2),
        A.PadIfNeeded(32, 40, fill=3),
    ],
    ids=["pad 9", "pad", "mask", "if needed"],
)
def test_what_is_filled_in_is_ignored_and_has_no_depth(transform: Any) -> None:
    before = sample()
    after = adapted(transform)(before)
    assert after["size"] == (32, 40)
    inside = torch.zeros(32, 40, dtype=torch.bool)
    inside[4:28, 4:36] = True
    for name in IMAGES[1:]:
        torch.testing.assert_close(
            after[name][..., 4:28, 4:36], before[name], rtol=0, atol=0, equal_nan=True
        )
        beyond = after[name][..., ~inside].float()
        absent = torch.full_like(beyond, MODALITIES[name].absent)
        torch.testing.assert_close(beyond, absent, rtol=0, atol=0, equal_nan=True)
    assert after["intrinsics"][:2, 2].tolist() == [15.25 + 4, 11.5 + 4]


@pytest.mark.parametrize(
    "transform",
    [
        v2.ColorJitter(0.5, 0.5),
        v2.RandomGrayscale(1.0),
        v2.GaussianBlur(5),
        A.RandomBrightnessContrast(p=1.0),
        A.ToGray(p=1.0),
        A.CoarseDropout(p=1.0),
    ],
    ids=lambda t: type(t).__name__,
)
def test_colours_are_changed_in_rgb_alone(transform: Any) -> None:
    before = sample()
    after = adapted(transform)(before)
    assert not torch.equal(after["rgb"], before["rgb"])
    check_same({**after, "rgb": before["rgb"]}, before)


ROTATIONS = [v2.RandomRotation((20, 20)), A.Rotate((20, 20), p=1.0)]


@pytest.mark.parametrize("transform", ROTATIONS, ids=["torchvision", "albumentations"])
def test_turned_depth_has_a_camera_that_is_turned(transform: Any) -> None:
    before = sample("rgb", "depth", "label")
    rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
    before["depth"] = (1 + rows * WIDTH + columns)[None].float()
    after = adapted(transform)(before)
    v, u = torch.nonzero(after["depth"][0], as_tuple=True)
    place = after["depth"][0, v, u].long() - 1
    rays = torch.linalg.inv(after["intrinsics"]) @ torch.stack([u, v, torch.ones_like(u)]).double()
    old = torch.stack([place % WIDTH, place // WIDTH, torch.ones_like(u)]).double()
    distance = (before["intrinsics"] @ rays - old).norm(dim=0)
    assert distance.max() < 1
    assert (after["label"][after["depth"][0] == 0] == 255).all()


@pytest.mark.parametrize("names", [("rgb", "normal"), ("hha",), ("depth", "disparity")])
@pytest.mark.parametrize("transform", ROTATIONS, ids=["torchvision", "albumentations"])
def test_turning_what_does_not_follow_is_refused_by_name(transform: Any, names: tuple) -> None:
    with pytest.raises(ArrayError, match=f"^{'Random' * (transform is ROTATIONS[0])}Rot.* a turn"):
        adapted(transform)(sample(*names, "label"))


@pytest.mark.parametrize(
    "transform", [v2.RandomPerspective(0.6, 1.0), A.ElasticTransform(300, 10, p=1.0)]
)
def test_warping_depth_is_refused_and_colours_and_labels_have_no_camera(transform: Any) -> None:
    with pytest.raises(ArrayError, match="with depth, found a warp"):
        adapted(transform)(sample("rgb", "depth", "label"))
    after = adapted(transform)(sample("rgb", "label"))
    assert after["intrinsics"].isnan().all()


def test_every_child_of_a_composition_is_named() -> None:
    composed = v2.Compose([v2.ColorJitter(0.1), v2.RandomApply([v2.RandomRotation((9, 9))], 1.0)])
    with pytest.raises(ArrayError, match=r"^ColorJitter, RandomRotation: "):
        adapted(composed)(sample())


def test_torchvisions_first_version_is_refused() -> None:
    from torchvision import transforms

    for transform in (transforms.ColorJitter(0.1), transforms.Compose([])):
        with pytest.raises(ArrayError, match=r"expected a transform of torchvision\S+v2"):
            adapted(transform)


def test_albumentations_that_cannot_be_seeded_are_refused() -> None:
    with pytest.raises(ArrayError, match="expected albumentations 2 or newer"):
        Albumentations(lambda **planes: planes)(sample())


OWN: dict[str, Any] = {
    "a function": lambda sample: v2.RandomHorizontalFlip(1.0)(sample),
    "several": lambda sample: v2.Compose([v2.ColorJitter(0.1)])(sample),
    "a method": v2.RandomRotation(9).forward,
    "partly": functools.partial(v2.RandomHorizontalFlip(1.0)),
}


@pytest.mark.parametrize("transform", OWN.values(), ids=OWN)
@pytest.mark.parametrize("among_ours", [False, True])
def test_torchvisions_called_with_a_sample_is_refused(
    path: Path, transform: Any, among_ours: bool
) -> None:
    given = Compose([RandomHorizontalFlip(), transform]) if among_ours else transform
    dataset = StoreDataset(path, None, "nim-rgb+d", transform=given)
    with pytest.raises(ArrayError, match=r"^frame '000001': expected .* Torchvision\(it\)\(sample"):
        dataset[1]


def test_ones_own_function_calls_torchvisions_by_its_adapter(path: Path) -> None:
    turned = Torchvision(v2.RandomHorizontalFlip(1.0))
    dataset = StoreDataset(path, None, "nim-rgb+d", transform=lambda sample: turned(sample))
    expected = StoreDataset(path, None, "nim-rgb+d", transform=flip)[1]
    for name in ("inputs", "label", "intrinsics"):
        assert torch.equal(dataset[1][name], expected[name])
    same = StoreDataset(path, None, "nim-rgb+d", transform=lambda sample: sample)
    assert torch.equal(same[1]["inputs"], StoreDataset(path, None, "nim-rgb+d")[1]["inputs"])


def test_modules_in_a_row_are_a_composition() -> None:
    before = sample()
    row = torch.nn.Sequential(v2.RandomHorizontalFlip(1.0), v2.CenterCrop((10, 12)))
    check_same(adapted(row)(before), crop(flip(before), 7, 10, 10, 12))


def test_a_list_is_told_what_makes_one_of_it(path: Path) -> None:
    with pytest.raises(ArrayError, match=r"found list; several make one by Compose"):
        StoreDataset(path, None, "rgb", transform=[RandomHorizontalFlip()])  # type: ignore[arg-type]


MIXED: dict[str, tuple[Any, str]] = {
    "between pixels": (A.Resize(20, 20, mask_interpolation=1), "^Resize: .* nearest pixel"),
    "whole metres": (v2.ToDtype({Mask: torch.int64, "others": None}), "^ToDtype: .*depth to stay"),
    "no tensors": (v2.ToPILImage(), "^ToPILImage: expected tensors back"),
}


@pytest.mark.parametrize(("transform", "said"), MIXED.values(), ids=MIXED)
def test_numbers_that_were_mixed_or_cut_off_are_refused(transform: Any, said: str) -> None:
    with pytest.raises(ArrayError, match=said):
        adapted(transform)(sample("rgb", "depth", "label"))


PIPELINES = [
    v2.Compose([v2.RandomCrop((16, 20)), v2.RandomHorizontalFlip(), v2.ColorJitter(0.3)]),
    A.Compose([A.RandomCrop(16, 20), A.HorizontalFlip(), A.RandomBrightnessContrast()]),
]


@pytest.mark.parametrize("pipeline", PIPELINES, ids=["torchvision", "albumentations"])
def test_planes_of_a_store_move_together_and_anew_in_every_pass(path: Path, pipeline: Any) -> None:
    names = ("rgb", "depth", "normal", "label")
    dataset = StoreDataset(path, None, modalities=names, transform=pipeline)
    plain = StoreDataset(path, None, modalities=names)
    drawn = set()
    for _ in range(2):
        for batch in DataLoader(dataset, batch_size=5):
            for position, frame_id in enumerate(batch["id"]):
                found = {name: batch[name][position] for name in (*names, "intrinsics")}
                whole = plain[plain.ids.index(frame_id)]
                drawn.add((frame_id, *place_of(found, whole)))
    assert len(drawn) > len(dataset) + 4


def place_of(found: dict[str, Any], whole: dict[str, Any]) -> tuple[int, int, bool]:
    """Return which window of a frame all of a sample's planes are, and whether it is mirrored."""
    k, old = found["intrinsics"], whole["intrinsics"]
    for mirrored in (False, True):
        left = round((old[0, 2] - (19 - k[0, 2] if mirrored else k[0, 2])).item())
        top = round((old[1, 2] - k[1, 2]).item())
        window = {n: whole[n][..., top : top + 16, left : left + 20] for n in whole if n in IMAGES}
        if mirrored:
            window = {n: plane.flip(-1) for n, plane in window.items()}
            window["normal"] = window["normal"] * torch.tensor([-1, 1, 1])[:, None, None]
        if all(torch.equal(window[n], found[n]) for n in ("depth", "normal", "label")):
            return top, left, mirrored
    raise AssertionError("no window of the frame")


@pytest.mark.parametrize("pipeline", PIPELINES, ids=["torchvision", "albumentations"])
def test_an_epoch_gives_the_same_in_any_order_and_on_any_threads(path: Path, pipeline: Any) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=pipeline, seed=4)
    dataset.set_epoch(2)
    expected = [dataset[i]["inputs"] for i in range(len(dataset))]
    with ThreadPoolExecutor(3) as pool:
        again = list(pool.map(lambda i: dataset[i]["inputs"], range(len(dataset) - 1, -1, -1)))
    assert all(torch.equal(a, b) for a, b in zip(expected, reversed(again), strict=True))
    copy = pickle.loads(pickle.dumps(dataset))
    loader = StoreLoader(copy, 5, num_threads=2)
    loader.set_epoch(2)
    batches = torch.cat([batch["inputs"] for batch in loader])
    assert torch.equal(batches, torch.stack(expected))


def test_what_torch_draws_elsewhere_is_not_disturbed() -> None:
    given = sample()
    before = torch.get_rng_state()
    adapted(PIPELINES[0])(given)
    assert torch.equal(before, torch.get_rng_state())


def test_it_stands_among_ours(path: Path) -> None:
    ours = Compose([RandomHorizontalFlip(), v2.Resize((12, 16)), A.Resize(6, 8)])
    dataset = StoreDataset(path, None, "nim-rgb+d", transform=ours)
    assert dataset[0]["inputs"].shape == (6, 6, 8)
    assert dataset[0]["label"].shape == (6, 8)


def test_frames_of_several_sizes_stay_padded_to_one(mixed: Path) -> None:
    dataset = StoreDataset(mixed, None, "nim-depth", transform=v2.RandomHorizontalFlip(1.0))
    plain = StoreDataset(mixed, None, "nim-depth", transform=flip)
    for found, expected in zip(DataLoader(dataset), DataLoader(plain), strict=True):
        for name in ("inputs", "label", "size", "intrinsics"):
            assert torch.equal(found[name], expected[name])


WRONG: dict[str, tuple[Any, str]] = {
    "no dict": (lambda s: s["rgb"], "expected a dict from the transform, found Tensor"),
    "a key gone": (lambda s: {k: v for k, v in s.items() if k != "label"}, "expected label from"),
    "its id gone": (lambda s: {k: v for k, v in s.items() if k != "id"}, "expected id from"),
    "scaled colours": (lambda s: {**s, "rgb": s["rgb"] / 255}, "expected rgb from 0 to 255"),
    "normalised": (lambda s: {**s, "rgb": s["rgb"] / 255 - 0.5}, "expected rgb from 0 to 255"),
    "torchvision's": (v2.ToDtype(torch.float32, scale=True), "expected rgb from 0 to 255"),
    "albumentations'": (A.Normalize(), "expected rgb from 0 to 255"),
    "label between": (lambda s: {**s, "label": s["label"] * 0.5}, "whole numbers in label"),
    "label beyond": (lambda s: {**s, "label": s["label"] + 255}, "label from 0 to 255"),
    "another size": (lambda s: {**s, "rgb": s["rgb"][:, 1:]}, "images of one size"),
    "label's size": (lambda s: {**s, "label": s["label"][1:]}, "images of one size"),
    "other axes": (lambda s: {**s, "rgb": s["rgb"].permute(1, 2, 0)}, r"rgb \(3, 'H', 'W'\)"),
    "no number": (lambda s: {**s, "depth": s["depth"] * NAN}, "finite depth .*NaN; 0 stands for"),
    "no end": (lambda s: {**s, "depth": s["depth"] / 0}, "finite depth from .*infinity"),
    "an array": (lambda s: {**s, "depth": s["depth"].numpy()}, "expected tensors"),
}


@pytest.mark.parametrize(("transform", "said"), WRONG.values(), ids=WRONG)
def test_what_a_transform_returns_is_checked(path: Path, transform: Any, said: str) -> None:
    dataset = StoreDataset(path, None, "rgb+d", transform=transform)
    with pytest.raises(ArrayError, match=f"^frame '000001': .*{said}"):
        dataset[1]


def test_nan_that_stands_for_none_is_taken_and_infinity_is_not(path: Path) -> None:
    def holes(number: float) -> StoreDataset:
        return StoreDataset(
            path,
            modalities=("elevation",),
            transform=lambda s: {**s, "elevation": s["elevation"] * 0 + number},
        )

    assert not holes(NAN)[0]["elevation"].any()
    with pytest.raises(ArrayError, match=r"finite elevation .*infinity; NaN stands for none"):
        holes(float("inf"))[0]


def test_scaled_colours_are_taken_where_nothing_scales_them_again(path: Path) -> None:
    dataset = StoreDataset(
        path, None, "rgb", transform=v2.ToDtype(torch.float32, scale=True), normalize="none"
    )
    plain = StoreDataset(path, None, "rgb")
    torch.testing.assert_close(dataset[0]["inputs"], plain[0]["inputs"])


def test_dark_colours_are_no_scaled_ones(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=lambda s: {**s, "rgb": s["rgb"] * 0.0})
    assert not dataset[0]["inputs"].any()
