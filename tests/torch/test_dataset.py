import pickle
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, DistributedSampler

import nimprep
from nimprep.errors import ArrayError, StoreError
from nimprep.frame import MODALITIES, PLANES
from nimprep.store.statistics import channel_statistics
from nimprep.torch import StoreDataset, StoreLoader, collate
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import CHANNELS, SETUPS, Setup
from nimprep.torch.views import VIEWS
from tests.fakes import SIZE
from tests.torch import vision
from tests.torch.stores import FRAMES, make_mixed_store, make_store

SCALES = {"depth": 10, "disparity": 64, "transformed_disparity": 16, "elevation": 2}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_mixed_store(tmp_path_factory.mktemp("mixed"))


def jitter(sample: dict[str, object]) -> dict[str, object]:
    """Add one random number to the colours."""
    noise = torch.rand((), generator=sample["generator"])
    return {**sample, "rgb": sample["rgb"].to(torch.float32) + noise}


def draw(sample: dict[str, object]) -> dict[str, object]:
    """Put one random number in the colours' place."""
    number = torch.rand((), generator=sample["generator"], dtype=torch.float64)
    return {
        **sample,
        "rgb": torch.zeros_like(sample["rgb"], dtype=torch.float32) + 2 + 200 * number,
    }


def expected(frame: nimprep.Frame, name: str) -> np.ndarray:
    """Return what a network takes of a frame, by the documented constants."""
    if name in VIEWS:
        return expected_view(frame.depth_m[None], name)
    if name in PLANES:
        image = frame.depth_m if name == "depth" else getattr(frame, name)
        return np.nan_to_num(image[None], nan=0) / SCALES[name]
    image = np.moveaxis(getattr(frame, name), 2, 0)
    return image if name == "normal" else image / 255


def expected_view(depth_m: np.ndarray, name: str) -> np.ndarray:
    known = depth_m > 0
    if name == "depth3":
        return np.concatenate([depth_m / 10] * 3)
    if name == "mask":
        return known
    assert name == "depth-minmax"
    low, high = depth_m[known].min(), depth_m[known].max()
    return np.where(known, (depth_m - low) / (high - low), 0)


@pytest.mark.parametrize("setup", SETUPS)
def test_inputs_are_the_stores_images_one_below_the_other(path: Path, setup: str) -> None:
    dataset = StoreDataset(path, split=None, setup=setup)
    store = nimprep.open_store(path)
    for i in (0, 7):
        sample = dataset[i]
        planes = np.concatenate([expected(store[i], name) for name in SETUPS[setup]])
        assert sample["inputs"].dtype == torch.float32
        np.testing.assert_allclose(sample["inputs"].numpy(), planes, atol=2e-7)
        assert sample["label"].dtype == torch.int64
        assert np.array_equal(sample["label"].numpy(), store[i].label)
        assert sample["id"] == store.ids[i]
        np.testing.assert_allclose(sample["intrinsics"].numpy(), store[i].camera.matrix, rtol=1e-6)
        assert sample["size"].tolist() == list(SIZE)
        assert set(sample) == {"inputs", "label", "id", "intrinsics", "size"}


@pytest.mark.parametrize("setup", ["rgb+d", "rgb+hha", "nim-rgb+d"])
def test_fusion_gives_the_same_numbers_as_a_pair(path: Path, setup: str) -> None:
    whole = StoreDataset(path, split=None, setup=setup)[3]["inputs"]
    pair = StoreDataset(path, split=None, setup=setup, fusion=True)[3]["inputs"]
    assert isinstance(pair, tuple)
    assert [len(part) for part in pair] == [CHANNELS[name] for name in SETUPS[setup]]
    assert torch.equal(torch.cat(pair), whole)


def test_ones_own_mix_has_a_float_tensor_per_name(path: Path) -> None:
    names = MODALITIES
    sample = StoreDataset(path, split=None, modalities=names, normalize="none")[2]
    frame = nimprep.open_store(path)[2]
    assert set(sample) == {*names, "id", "intrinsics", "size"}
    for name in ("disparity", "transformed_disparity", "elevation"):
        image = np.nan_to_num(getattr(frame, name), nan=0)
        assert np.array_equal(sample[name][0].numpy(), image)
        assert np.ptp(image) > 0.1
    assert torch.equal(sample["depth"][0], torch.from_numpy(frame.depth_m))
    assert np.array_equal(sample["rgb"].numpy(), np.moveaxis(frame.rgb, 2, 0))
    assert np.array_equal(sample["hha"].numpy(), np.moveaxis(frame.hha, 2, 0))
    np.testing.assert_allclose(sample["normal"].numpy(), expected(frame, "normal"), atol=2e-7)
    assert "label" not in StoreDataset(path, split=None, modalities=("rgb",))[0]


def test_a_split_has_its_own_frames(path: Path) -> None:
    store = nimprep.open_store(path)
    found = {s: StoreDataset(path, split=s, setup="rgb").ids for s in ("train", "val", "test")}
    for split, ids in found.items():
        assert ids == tuple(i for i in store.ids if store.splits[i] == split)
    assert sum(map(len, found.values())) == FRAMES == len(StoreDataset(path, None, "rgb"))


def test_int16_normals_give_what_they_are(tmp_path: Path) -> None:
    path = make_store(tmp_path, normal_dtype="int16")
    sample = StoreDataset(path, split=None, setup="nim-depth")[0]
    frame = nimprep.open_store(path)[0]
    np.testing.assert_allclose(sample["inputs"].numpy(), expected(frame, "normal"), atol=2e-7)


def test_normals_can_be_computed_as_a_frame_is_read(tmp_path: Path) -> None:
    path = make_store(tmp_path, modalities=("rgb", "depth"))
    frame = nimprep.open_store(path)[1]
    normal = nimprep.estimate_normals(frame.depth_m, frame.camera)
    sample = StoreDataset(path, split=None, setup="nim-rgb+d", normals="nim")[1]
    assert np.array_equal(sample["inputs"][3:].numpy(), np.moveaxis(normal, 2, 0))
    assert (sample["label"] == 255).all(), "a store without labels gives ignore"
    stored = StoreDataset(path, split=None, setup="nim-depth", normals="nim", dtype="stored")[1]
    assert stored["normal"].dtype == torch.int8


def test_a_missing_modality_is_named_with_what_to_do(tmp_path: Path) -> None:
    path = make_store(tmp_path, modalities=("rgb", "depth"))
    with pytest.raises(StoreError, match=r"expected hha, found only rgb, depth; .*--modalities"):
        StoreDataset(path, split=None, setup="rgb+hha")
    with pytest.raises(StoreError, match=r"expected normal, .*normals='nim'"):
        StoreDataset(path, split=None, setup="nim-depth")
    with pytest.raises(StoreError, match=r"expected label, .*dataset with labels"):
        StoreDataset(path, split=None, modalities=("rgb", "label"))
    rgb = make_store(tmp_path, modalities=("rgb",))
    with pytest.raises(StoreError, match=r"expected depth, found only rgb"):
        StoreDataset(rgb, split=None, setup="nim-depth", normals="nim")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "training"}, "expected a split of .*'training'"),
        ({"split": "none"}, "expected frames in split 'none', found 6 in train, 2 in val"),
        ({"normals": "sobel"}, "normals: expected one of cached, nim.*'sobel'"),
        ({"normalize": "mean"}, "normalize: expected one of constants, train, imagenet, none"),
        ({"dtype": "float16"}, "dtype: expected 'float32' or 'stored'"),
        ({"dtype": "stored", "transform": jitter}, "dtype: expected 'float32' with a transform"),
    ],
)
def test_an_option_that_is_none_is_refused(path: Path, options: dict, message: str) -> None:
    with pytest.raises((StoreError, ArrayError), match=message):
        StoreDataset(path, setup="rgb", **options)


def test_no_store_is_an_error_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="found nothing"):
        StoreDataset(tmp_path / "none.zarr", setup="rgb")


def test_padding_is_ignore_and_the_size_is_the_frames_own(mixed: Path) -> None:
    dataset = StoreDataset(mixed, split=None, setup="nim-rgb+d", normals="nim")
    sample = dataset[3]
    assert sample["size"].tolist() == [20, 28]
    assert sample["inputs"].shape == (6, *SIZE)
    assert (sample["label"][20:] == 255).all()
    assert (sample["label"][:, 28:] == 255).all()
    assert (sample["label"][:20, :28] != 255).all()
    frame = nimprep.open_store(mixed)[3]
    normal = nimprep.estimate_normals(frame.depth_m, frame.camera)
    assert np.array_equal(sample["inputs"][3:, :20, :28].numpy(), np.moveaxis(normal, 2, 0))
    assert not sample["inputs"][:, 20:].any()


def test_normalising_by_the_train_split_gives_mean_0_and_spread_1(path: Path) -> None:
    names = ("rgb", "depth", "hha")
    dataset = StoreDataset(path, modalities=names, normalize="train")
    raw = StoreDataset(path, modalities=names, normalize="none")
    for name in names:
        values = torch.stack([sample[name] for sample in dataset])
        there = torch.stack([sample[name] for sample in raw])
        if name != "rgb":
            none = (there == 0).all(dim=1, keepdim=True).expand_as(there)
            assert none.any() == (name == "depth") or none.any()
            assert (values[none] == 0).all(), "none stays 0"
            values = values[~none].reshape(1, -1) if name == "depth" else values
        if name != "hha":
            dims = [d for d in range(values.ndim) if d != 1] if name == "rgb" else [1]
            std, mean = torch.std_mean(values, dim=dims, correction=0)
            torch.testing.assert_close(mean, torch.zeros_like(mean), atol=1e-5, rtol=0)
            torch.testing.assert_close(std, torch.ones_like(std), atol=1e-5, rtol=0)
    found = channel_statistics(dataset.store)["hha"]
    some = raw[0]["hha"].any(dim=0)
    want = (raw[0]["hha"] - torch.tensor(found.mean)[:, None, None]) / torch.tensor(found.std)[
        :, None, None
    ]
    torch.testing.assert_close(dataset[0]["hha"][:, some], want[:, some].float(), atol=1e-5, rtol=0)


def test_disparities_and_elevation_are_divided_by_their_constants_in_any_case(path: Path) -> None:
    names = ("disparity", "transformed_disparity", "elevation")
    plain, train = (
        StoreDataset(path, modalities=("depth", *names), normalize=by)[0]
        for by in ("constants", "train")
    )
    assert not torch.equal(plain["depth"], train["depth"])
    for name in names:
        assert torch.equal(plain[name], train[name])
        assert plain[name].isfinite().all()


def test_val_is_normalised_by_the_train_split(path: Path) -> None:
    train, val = (StoreDataset(path, s, "rgb", normalize="train") for s in ("train", "val"))
    assert train.scaling == val.scaling


def test_a_scaling_of_ones_own_is_taken(path: Path) -> None:
    own = Scaling({"depth": (2.0,)}, {"depth": (1.0,)})
    found = StoreDataset(path, None, "depth", normalize=own)[0]["inputs"]
    depth = torch.from_numpy(nimprep.open_store(path)[0].depth_m)[None]
    torch.testing.assert_close(found, torch.where(depth > 0, depth * 2 + 1, 0))
    with pytest.raises(ArrayError, match="a number per channel"):
        Scaling({"rgb": (1.0,)}, {})


@pytest.mark.parametrize("normalize", ["constants", "train", "none"])
@pytest.mark.parametrize("normals", ["cached", "nim"])
def test_a_transform_that_changes_nothing_changes_no_bit(
    path: Path, normalize: str, normals: str
) -> None:
    names = MODALITIES
    options = {"modalities": names, "normalize": normalize, "normals": normals}
    plain = StoreDataset(path, **options)[1]
    same = StoreDataset(path, transform=lambda sample: sample, **options)[1]
    assert plain.keys() == same.keys()
    for name in (*names, "intrinsics", "size"):
        assert torch.equal(plain[name], same[name]), name
        assert plain[name].dtype == same[name].dtype


def test_a_transform_gets_what_is_promised_and_may_change_sizes(path: Path) -> None:
    seen = {}

    def half(sample: dict) -> dict:
        seen.update(sample)
        cut = {n: sample[n][..., ::2, ::2] for n in ("rgb", "depth", "label")}
        return {**sample, **cut, "size": (12, 16)}

    sample = StoreDataset(path, None, "rgb+d", transform=half)[0]
    assert set(seen) == {"rgb", "depth", "label", "intrinsics", "id", "size", "generator"}
    assert (seen["rgb"].dtype, seen["rgb"].shape) == (torch.uint8, (3, *SIZE))
    assert (seen["depth"].dtype, seen["depth"].shape) == (torch.float32, (1, *SIZE))
    assert (seen["label"].dtype, seen["label"].shape) == (torch.int64, SIZE)
    assert (seen["intrinsics"].dtype, seen["size"]) == (torch.float64, SIZE)
    assert sample["inputs"].shape == (4, 12, 16)
    assert sample["size"].tolist() == [12, 16]


def test_images_of_several_sizes_make_no_sample_and_no_batch(path: Path) -> None:
    def only_rgb(sample: dict) -> dict:
        return {**sample, "rgb": sample["rgb"][:, 1:]}

    with pytest.raises(ArrayError, match=r"frame '000000': expected images of one size"):
        StoreDataset(path, None, "rgb+d", transform=only_rgb)[0]

    def by_id(sample: dict) -> dict:
        rows = int(sample["id"])
        return {**sample, **{n: sample[n][..., rows:, :] for n in ("rgb", "label")}}

    with pytest.raises(ArrayError, match=r"one size in a batch.*crop or resize"):
        StoreDataset(path, None, "rgb", transform=by_id).__getitems__([0, 1])


@pytest.mark.parametrize("transform", [None, jitter])
@pytest.mark.parametrize("fusion", [False, True])
def test_a_batch_is_its_samples_stacked(path: Path, transform: object, fusion: bool) -> None:
    dataset = StoreDataset(path, None, "rgb+d", fusion, transform)
    dataset.set_epoch(0)
    order = [4, -1, 0]
    batch = dataset.__getitems__(order)
    stacked = collate([dataset[i] for i in order])
    assert batch.keys() == stacked.keys() == dataset[0].keys()
    assert batch["id"] == stacked["id"] == [dataset.ids[i] for i in order]
    for name in ("inputs", "label", "intrinsics", "size"):
        pair = zip(
            *(b[name] if fusion and name == "inputs" else (b[name],) for b in (batch, stacked)),
            strict=True,
        )
        for a, b in pair:
            assert torch.equal(a, b)
            assert len(a) == 3


def test_an_index_beyond_the_split_is_an_index_error(path: Path) -> None:
    dataset = StoreDataset(path, "val", "rgb")
    assert torch.equal(dataset[-1]["inputs"], dataset[len(dataset) - 1]["inputs"])
    for index in (len(dataset), -len(dataset) - 1):
        with pytest.raises(IndexError):
            dataset[index]


def numbers(loader: DataLoader) -> dict[str, float]:
    """Return a number per frame that its random colours decide."""
    return {
        frame_id: float(image.sum())
        for batch in loader
        for frame_id, image in zip(batch["id"], batch["inputs"].double(), strict=True)
    }


@pytest.mark.parametrize(
    "options",
    [
        {"num_workers": 1, "multiprocessing_context": "fork", "persistent_workers": True},
        {"num_workers": 2, "multiprocessing_context": "fork", "collate_fn": collate},
        {"num_workers": 2, "multiprocessing_context": "spawn", "persistent_workers": True},
    ],
    ids=["fork", "collate", "spawn"],
)
def test_a_sample_is_the_same_on_any_number_of_workers(path: Path, options: dict) -> None:
    dataset = StoreDataset(path, None, "rgb+d", transform=jitter, seed=3)
    here = DataLoader(dataset, batch_size=4, shuffle=True)
    there = DataLoader(dataset, batch_size=3, **options)
    epochs = []
    for epoch in range(2):
        dataset.set_epoch(epoch)
        epochs.append(numbers(here))
        assert epochs[-1] == numbers(there)
        assert len(epochs[-1]) == FRAMES
    assert epochs[0] != epochs[1]
    assert epochs[0] != numbers(DataLoader(StoreDataset(path, None, "rgb+d", transform=jitter)))


WORKERS: dict[str, dict[str, object]] = {
    "none": {},
    "fork": {"num_workers": 2, "multiprocessing_context": "fork"},
    "fork, kept": {
        "num_workers": 2,
        "multiprocessing_context": "fork",
        "persistent_workers": True,
    },
    "spawn, kept": {
        "num_workers": 1,
        "multiprocessing_context": "spawn",
        "persistent_workers": True,
    },
}


@pytest.mark.parametrize("options", WORKERS.values(), ids=WORKERS)
def test_every_pass_of_a_plain_loop_draws_anew(path: Path, options: dict) -> None:
    loader = DataLoader(StoreDataset(path, None, "rgb", transform=draw), batch_size=4, **options)
    passes = [numbers(loader) for _ in range(3)]
    assert len({value for found in passes for value in found.values()}) == 3 * FRAMES


@pytest.mark.parametrize("options", [{}, WORKERS["fork"]], ids=["none", "fork"])
def test_a_run_is_seeded_by_torch(path: Path, options: dict) -> None:
    runs = []
    for seed in (5, 5, 6):
        torch.manual_seed(seed)
        dataset = StoreDataset(path, None, "rgb", transform=draw)
        loader = DataLoader(dataset, batch_size=4, **options)
        runs.append([numbers(loader), numbers(loader)])
    assert runs[0] == runs[1]
    assert not {*runs[0][0].values()} & {*runs[2][0].values()}


def test_an_epoch_that_was_said_can_be_taken_back(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=draw)
    assert dataset.epoch is None
    drawn = []
    for epoch in (1, 1, None, None):
        dataset.set_epoch(epoch)
        assert dataset.epoch == epoch
        drawn.append(float(dataset[0]["inputs"][0, 0, 0]))
    assert drawn[0] == drawn[1]
    assert len(set(drawn)) == 3


@pytest.mark.filterwarnings("ignore")  # of Lightning itself
def test_lightning_draws_anew_in_every_epoch(path: Path, tmp_path: Path) -> None:
    vision.transforms()  # which Lightning imports, too
    import lightning.pytorch as lightning

    class Module(lightning.LightningModule):
        def __init__(self) -> None:
            super().__init__()
            self.weight = torch.nn.Parameter(torch.zeros(()))
            self.seen: list[list[float]] = []

        def on_train_epoch_start(self) -> None:
            self.seen.append([])

        def training_step(self, batch: dict, _: int) -> torch.Tensor:
            self.seen[-1] += batch["inputs"][:, 0, 0, 0].tolist()
            return self.weight * batch["inputs"].mean()

        def configure_optimizers(self) -> torch.optim.Optimizer:
            return torch.optim.SGD(self.parameters(), 0.1)

    module = Module()
    loader = DataLoader(StoreDataset(path, None, "rgb", transform=draw), batch_size=4)
    lightning.Trainer(
        max_epochs=3,
        accelerator="cpu",
        logger=False,
        enable_checkpointing=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        default_root_dir=tmp_path,
    ).fit(module, loader)
    assert [len(seen) for seen in module.seen] == [FRAMES] * 3
    assert len({value for seen in module.seen for value in seen}) == 3 * FRAMES


@pytest.mark.parametrize("dtype", ["float32", "stored"])
def test_a_worker_hands_over_what_the_process_itself_reads(path: Path, dtype: str) -> None:
    names = MODALITIES
    dataset = StoreDataset(path, None, modalities=names, dtype=dtype)
    here, there = (list(DataLoader(dataset, batch_size=4, num_workers=n)) for n in (0, 1))
    assert len(here) == len(there) == 3
    for a, b in zip(here, there, strict=True):
        assert type(a) is dict
        assert a["id"] == b["id"]
        assert all(torch.equal(a[name], b[name]) for name in names)


def test_processes_of_a_distributed_run_share_the_frames(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb")
    ids = []
    for rank in range(2):
        sampler = DistributedSampler(dataset, num_replicas=2, rank=rank, shuffle=True)
        ids += [i for batch in DataLoader(dataset, 2, sampler=sampler) for i in batch["id"]]
    assert sorted(ids) == sorted(dataset.ids)


def test_a_dataset_pickles_with_its_epoch(path: Path) -> None:
    dataset = StoreDataset(path, None, "rgb", transform=jitter)
    dataset.set_epoch(4)
    again = pickle.loads(pickle.dumps(dataset))
    assert again.epoch == 4
    assert torch.equal(again[2]["inputs"], dataset[2]["inputs"])


def test_a_flipped_bit_is_an_error_in_the_loop(tmp_path: Path) -> None:
    path = make_store(tmp_path)
    shard = next(p for p in (path / "rgb" / "c").rglob("*") if p.is_file())
    data = bytearray(shard.read_bytes())
    data[100] ^= 1
    shard.write_bytes(data)
    with pytest.raises(StoreError, match="wrong checksum"):
        list(DataLoader(StoreDataset(path, None, "rgb"), batch_size=2))


def test_classes_can_be_merged_by_name(path: Path) -> None:
    plain = StoreDataset(path, None, "rgb")
    for dtype in ("float32", "stored"):
        merged = StoreDataset(
            path,
            None,
            modalities=("rgb", "label"),
            classes={"drivable area": 1, "road anomaly": 255, "*": 7},
            dtype=dtype,
        )
        loader = StoreLoader(merged, 4)
        labels = torch.cat([batch["label"] for batch in loader]).long()
        own = torch.stack([sample["label"] for sample in plain])
        table = torch.full((256,), 255)
        table[:2] = torch.tensor([7, 1])
        assert {0, 1, 2} <= set(own.unique().tolist())
        assert torch.equal(labels, table[own])
        assert torch.equal(merged[3]["label"].long(), table[own[3]])


@pytest.mark.parametrize(
    ("classes", "said"),
    [
        ({"road": 1, "*": 0}, "expected some of background, drivable area.*found 'road'"),
        ({"background": 0}, "found none for drivable area, road anomaly"),
        ({"background": 300, "*": 0}, "expected 0 to 255, found 300 for 'background'"),
        ({"background": True, "*": 0}, "expected 0 to 255, found True"),
        ({"*": -1}, "expected 0 to 255, found -1"),
    ],
)
def test_merged_classes_are_those_of_the_store(path: Path, classes: dict, said: str) -> None:
    with pytest.raises(ArrayError, match=f"^classes: .*{said}"):
        StoreDataset(path, None, "rgb", classes=classes)


def test_imagenets_statistics_scale_rgb_alone(path: Path) -> None:
    plain = StoreDataset(path, None, "rgb+d")[0]["inputs"].double()
    scaled = StoreDataset(path, None, "rgb+d", normalize="imagenet")[0]["inputs"].double()
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    expected = (plain[:3] - mean[:, None, None]) / std[:, None, None]
    torch.testing.assert_close(scaled[:3], expected, atol=1e-5, rtol=0)
    assert torch.equal(scaled[3], plain[3])


def test_its_repr_says_what_is_in_it(path: Path) -> None:
    assert repr(StoreDataset(path, None, "nim-rgb+d")) == (
        f"<StoreDataset {path}: 10 frames of all splits, rgb+normal (6, H, W), label, 32x24>"
    )
    pair = repr(StoreDataset(path, "val", "rgb+hha", fusion=True))
    assert "frames of val, rgb (3, H, W) and hha (3, H, W), label" in pair
    assert "depth (1, H, W), 32x24>" in repr(StoreDataset(path, modalities=("depth",)))


def test_the_names_a_type_checker_knows_are_the_setups() -> None:
    assert get_args(Setup) == tuple(SETUPS)


@pytest.mark.parametrize("name", VIEWS)
def test_views_are_alike_by_name_after_a_transform_and_in_a_loader(path: Path, name: str) -> None:
    plain = StoreDataset(path, None, modalities=("rgb", name), normalize="train")
    moved = StoreDataset(path, None, modalities=("rgb", name), normalize="train", transform=dict)
    batches = list(StoreLoader(plain, 4))
    found = torch.cat([batch[name] for batch in batches])
    for i in (0, 9):
        assert torch.equal(plain[i][name], found[i])
        torch.testing.assert_close(moved[i][name], found[i], atol=2e-7, rtol=0)
    assert found.shape == (FRAMES, VIEWS[name].channels, *SIZE)


def test_depth_at_the_mean_is_there_in_its_mask(path: Path) -> None:
    dataset = StoreDataset(path, None, "depth+mask", normalize=Scaling({"depth": (0.0,)}, {}))
    depth, mask = dataset[0]["inputs"]
    assert not depth.any()
    assert torch.equal(mask, torch.from_numpy(dataset.store[0].depth_m > 0).float())


def test_an_image_without_depth_has_no_nearest() -> None:
    out = torch.full((1, 2, 3), torch.nan)
    VIEWS["depth-minmax"].write(torch.zeros(1, 2, 3), Scaling.none().apply, out)
    assert not out.any()


@pytest.mark.parametrize("name", VIEWS)
def test_what_is_made_of_depth_is_not_stored(path: Path, name: str) -> None:
    with pytest.raises(ArrayError, match=f"^dtype: expected 'float32' with {name}"):
        StoreDataset(path, None, modalities=(name,), dtype="stored")
    with pytest.raises(ArrayError, match=f"^dtype: expected 'float32' with {name}"):
        StoreLoader(StoreDataset(path, None, modalities=(name,)), dtype="stored")
