"""A dataset's own planes as tensors: values, padding, transforms, setups and scaling."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import albumentations
import cv2
import numpy as np
import pytest
import torch

import nimprep
from nimprep.errors import ArrayError
from nimprep.plane import plane_from
from nimprep.torch import StoreDataset, StoreLoader
from nimprep.torch.normalization import Normalize
from nimprep.torch.scaling import Scaling
from nimprep.torch.transforms import Compose, RandomCrop, crop, flip, resize
from tests.thermal import PLANES, degrees, raw_confidence, raw_thermal, use_reader, write_thermal
from tests.torch import vision

pytestmark = pytest.mark.filterwarnings("ignore:.*no calibration")

NAMES = ("rgb", "thermal", "confidence", "label")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    raw = write_thermal(tmp_path_factory.mktemp("raw") / "raw")
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        path: Path = nimprep.convert(raw, tmp_path_factory.mktemp("made") / "s.zarr").path
    return path


def as_tensor(raw: Any) -> torch.Tensor:
    return torch.from_numpy(np.nan_to_num(degrees(raw)))[None]


def test_tensors_hold_the_numbers_and_0_where_there_is_none(store: Path) -> None:
    data = StoreDataset(store, None, modalities=NAMES, normalize="none")
    for number, sample in enumerate(data):
        assert torch.equal(sample["thermal"], as_tensor(raw_thermal(number)))
        assert torch.equal(sample["confidence"][0].byte(), torch.tensor(raw_confidence(number)))


def test_constants_divide_by_the_largest_number_that_there_can_be(store: Path) -> None:
    sample = StoreDataset(store, None, modalities=NAMES)[1]
    expected = as_tensor(raw_thermal(1)) * np.float32(1 / 382.2)
    assert torch.allclose(sample["thermal"], expected, rtol=1e-6, atol=0)
    assert 0 <= sample["confidence"].min() <= sample["confidence"].max() == 1


def test_the_train_splits_statistics_bring_planes_to_mean_0(store: Path) -> None:
    data = StoreDataset(store, "train", modalities=("thermal", "confidence"), normalize="train")
    raw = np.stack([raw_thermal(int(i)) for i in data.indices])
    values = torch.cat([sample["thermal"][0] for sample in data])
    known = values[torch.from_numpy(raw.reshape(values.shape).astype(np.int32)) > 0]
    assert known.mean() == pytest.approx(0, abs=1e-4)
    assert known.std(correction=0) == pytest.approx(1, rel=1e-5)
    other = torch.stack([sample["confidence"] for sample in data])
    assert other.mean() == pytest.approx(0, abs=1e-5)


def test_a_scaling_names_planes_of_the_store_alone(store: Path) -> None:
    scaling = Scaling({"thermal": (0.5,)}, {"thermal": (1.0,)})
    data = StoreDataset(store, None, modalities=("thermal",), normalize=scaling)
    raw = raw_thermal(0)
    expected = np.where(raw == 0, 0, np.nan_to_num(degrees(raw)) * np.float32(0.5) + 1)
    assert np.array_equal(data[0]["thermal"][0], expected)
    wrong = Scaling({"termal": (0.5,)}, {})
    with pytest.raises(ArrayError, match=r"expected some of rgb, .*thermal, found 'termal'"):
        StoreDataset(store, None, modalities=("thermal",), normalize=wrong)
    with pytest.raises(ArrayError, match="expected a number per channel"):
        Scaling({"thermal": (0.5, 1)}, {})


@pytest.mark.parametrize("normalize", ["constants", "train", "none"])
def test_batches_samples_loaders_and_stored_integers_agree(store: Path, normalize: Any) -> None:
    options: dict[str, Any] = {"modalities": NAMES, "normalize": normalize}
    data = StoreDataset(store, None, **options)
    [batch] = StoreLoader(data, batch_size=5)
    plain = StoreDataset(store, None, transform=lambda sample: sample, **options)
    stored = StoreDataset(store, None, dtype="stored", **options)
    [raw] = StoreLoader(stored, batch_size=5)
    assert raw["thermal"].dtype == torch.uint16
    again = Normalize(stored)(raw)
    for number in range(5):
        for name in ("thermal", "confidence"):
            assert torch.equal(batch[name][number], data[number][name])
            assert torch.equal(plain[number][name], data[number][name])
            assert torch.equal(again[name][number], data[number][name])


def test_setups_join_planes_with_others(store: Path) -> None:
    data = StoreDataset(store, None, "rgb+thermal")
    assert data[0]["inputs"].shape == (4, 24, 32)
    assert "rgb+thermal (4, H, W)" in repr(data)
    assert StoreDataset(store, None, ("rgb", "thermal")).selection == data.selection
    first, second = StoreDataset(store, None, ("rgb", "thermal"), fusion=True)[0]["inputs"]
    assert (first.shape[0], second.shape[0]) == (3, 1)
    every = StoreDataset(store, None, "rgb+d+nim-depth+thermal").selection.images
    assert every == ("rgb", "depth", "normal", "thermal")
    assert StoreDataset(store, None, "thermal").selection.images == ("thermal",)
    for wrong in ("rgb+termal", "thermal+thermal", "rgb+rgb", "+thermal", "rgb+"):
        with pytest.raises(ArrayError, match=r"expected one of rgb, .*as in 'rgb\+confidence'"):
            StoreDataset(store, None, wrong)


def test_a_dataset_with_planes_pickles(store: Path) -> None:
    data = StoreDataset(store, None, "rgb+thermal", transform=flip)
    assert torch.equal(pickle.loads(pickle.dumps(data))[2]["inputs"], data[2]["inputs"])


def test_flip_and_crop_move_planes_with_the_colours(store: Path) -> None:
    raw = StoreDataset(store, None, modalities=NAMES, transform=flip, normalize="none")[3]
    assert torch.equal(raw["thermal"], as_tensor(raw_thermal(3)).flip(-1))
    seen: dict[str, Any] = {}

    def beyond(sample: dict[str, Any]) -> dict[str, Any]:
        seen.update(crop(sample, 20, 28, 8, 8))
        return dict(seen)

    StoreDataset(store, None, modalities=NAMES, transform=beyond)[3]
    assert seen["thermal"][0, :4, :4].numpy() == pytest.approx(degrees(raw_thermal(3))[20:, 28:])
    assert seen["thermal"][0, 4:].isnan().all()
    assert (seen["confidence"][0, 4:] == 0).all()
    assert seen["confidence"].dtype == torch.uint8


def sample_of(name: str, image: torch.Tensor, **definition: Any) -> dict[str, Any]:
    plane = plane_from(name, {"dtype": "uint16", "scale": 0.01, **definition})
    return {name: image, "planes": {name: plane}}


def test_a_plane_is_resized_as_its_record_says() -> None:
    ramp = torch.arange(8, dtype=torch.float32).expand(1, 4, 8)
    nearest = resize(sample_of("a", ramp), 4, 4)["a"]
    assert nearest[0, 0].tolist() == [1, 3, 5, 7]
    linear = resize(sample_of("a", ramp, resize="linear"), 4, 4)["a"]
    # Over the area that a pixel covers; at the edges there is more of one side.
    assert torch.allclose(linear[0, 0, 1:3], torch.tensor([2.5, 4.5]))
    bytes_ = plane_from("b", {"dtype": "uint8", "resize": "linear"})
    sample = {"b": (ramp * 10).to(torch.uint8), "planes": {"b": bytes_}}
    assert resize(sample, 4, 4)["b"][0, 0, 1:3].tolist() == [25, 45]


def test_none_has_no_share_in_what_is_interpolated() -> None:
    image = torch.full((1, 6, 6), 20.0)
    image[0, :, :3] = torch.nan
    shrunk = resize(sample_of("a", image, fill=0, resize="linear"), 4, 4)["a"]
    assert shrunk[0, :, :2].isnan().all()
    assert torch.allclose(shrunk[0, :, 2:], torch.tensor(20.0))


def test_whoever_drops_the_records_is_told(store: Path) -> None:
    def drop(sample: dict[str, Any]) -> dict[str, Any]:
        return {name: value for name, value in sample.items() if name != "planes"}

    data = StoreDataset(store, None, "rgb+thermal", transform=Compose([drop, flip]))
    with pytest.raises(ArrayError, match="expected planes from the transform"):
        data[0]


def test_random_transforms_draw_once_for_all(store: Path) -> None:
    move = Compose([RandomCrop(16, 16)])
    data = StoreDataset(store, None, modalities=NAMES, transform=move, normalize="none")
    data.set_epoch(0)
    sample = data[2]
    thermal, confidence = as_tensor(raw_thermal(2))[0], torch.tensor(raw_confidence(2)).float()
    places = [
        (v, u)
        for v in range(9)
        for u in range(17)
        if torch.equal(thermal[v : v + 16, u : u + 16], sample["thermal"][0])
    ]
    [(v, u)] = places
    assert torch.equal(confidence[v : v + 16, u : u + 16], sample["confidence"][0])


@pytest.mark.parametrize("library", ["torchvision", "albumentations"])
def test_transforms_of_other_libraries_move_planes(store: Path, library: str) -> None:
    if library == "torchvision":
        move = vision.transforms().RandomHorizontalFlip(1.0)
    else:
        move = albumentations.HorizontalFlip(p=1.0)
    data = StoreDataset(store, None, modalities=NAMES, transform=move, normalize="none")
    sample = data[1]
    assert torch.equal(sample["thermal"], as_tensor(raw_thermal(1)).flip(-1))
    flipped = torch.tensor(raw_confidence(1)).flip(-1).float()
    assert torch.equal(sample["confidence"][0], flipped)


def test_frames_of_several_sizes_are_padded(tmp_path: Path) -> None:
    raw = write_thermal(tmp_path / "raw", 2)
    write_thermal(raw, 1, (20, 30))
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch)
        path = nimprep.convert(raw, tmp_path / "s.zarr").path
    sample = StoreDataset(path, None, modalities=("thermal",), normalize="none")[0]
    assert (sample["thermal"][0, 20:] == 0).all()
    moved = StoreDataset(path, None, modalities=("thermal",), transform=flip, normalize="none")[0]
    inside = as_tensor(raw_thermal(0, (20, 30)))
    assert torch.equal(moved["thermal"][:, :20, :30], inside.flip(-1))


def test_a_fourth_channel_that_is_thermal_is_just_its_values(tmp_path: Path) -> None:
    from tests.thermal import ThermalReader

    class FourChannels(ThermalReader):
        """As MFNet has it: the fourth channel of a PNG of four, 8 bits without a unit."""

        planes = (plane_from("thermal", {"dtype": "uint8", "resize": "linear"}),)

        def _file(self, name: str, frame_id: str) -> Path:
            return self.root / "thermal" / f"{frame_id}.png"

        def read(self, *args: Any) -> Any:
            frame = self._reader.read(*args)
            four = cv2.imread(str(self._file("", frame.id)), cv2.IMREAD_UNCHANGED)
            frame.others["thermal"] = np.ascontiguousarray(four[..., 3])
            return frame

    raw = write_thermal(tmp_path / "raw", 3)
    for number in range(3):
        four = np.random.default_rng(number).integers(0, 256, (24, 32, 4), dtype=np.uint8)
        cv2.imwrite(str(raw / "thermal" / f"{number:06d}.png"), four)
    with pytest.MonkeyPatch.context() as patch:
        use_reader(patch, FourChannels)
        path = nimprep.convert(raw, tmp_path / "s.zarr", modalities=("rgb", "thermal")).path
    data = StoreDataset(path, None, "rgb+thermal")
    four = np.random.default_rng(2).integers(0, 256, (24, 32, 4), dtype=np.uint8)
    assert np.array_equal((data[2]["inputs"][3] * 255).round().numpy(), four[..., 3])


def test_planes_of_the_test_are_what_the_store_has(store: Path) -> None:
    assert nimprep.open_store(store).planes == tuple(sorted(PLANES, key=lambda p: p.name))


def test_a_plane_is_cut_to_a_range_where_one_is_given(store: Path) -> None:
    celsius = StoreDataset(store, None, "thermal", normalize="none")[2]["inputs"]
    low, high = (float(q) for q in torch.quantile(celsius[celsius != 0], torch.tensor([0.2, 0.8])))
    cut = StoreDataset(store, None, "thermal", normalize="none", cut={"thermal": (low, high)})
    want = torch.where(celsius == 0, 0, celsius.clamp(low, high))
    torch.testing.assert_close(cut[2]["inputs"], want)
    assert "cut to" not in repr(StoreDataset(store, None, "thermal"))
    assert repr(cut).endswith(f"; thermal cut to {low:g} to {high:g} degC>")
