"""Numbers of tensors are cut to a range that is said, whichever way they are read."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import nimprep
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.torch import Normalize, Scaling, StoreDataset, StoreLoader
from nimprep.torch.transforms import Compose, RandomCrop, RandomHorizontalFlip, Resize
from tests.torch.stores import make_store

NARROW = ("elevation", "transformed_disparity", "depth", "disparity")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_store(tmp_path_factory.mktemp("store"))


def narrow(path: Path, name: str) -> tuple[float, float]:
    """Return a range that a frame's numbers leave at both ends."""
    image = nimprep.open_store(path)[0].image(name)
    low, high = np.percentile(image[np.nan_to_num(image) != 0], [20, 80])
    return round(float(low), 3), round(float(high), 3)


def expected(frame: nimprep.Frame, name: str, ends: tuple[float, float]) -> np.ndarray:
    image = frame.image(name)
    none = np.isnan(image) if np.isnan(MODALITIES[name].absent) else image == 0
    return np.where(none, 0, np.clip(image, *ends) / MODALITIES[name].divisor)


@pytest.mark.parametrize("name", NARROW)
def test_a_range_of_ones_own_is_cut_to_before_scaling_and_none_stays_0(
    path: Path, name: str
) -> None:
    ends = narrow(path, name)
    options: dict[str, Any] = {"modalities": (name,), "cut": {name: ends}}
    data = StoreDataset(path, None, **options)
    moved = StoreDataset(path, None, transform=dict, **options)
    stored = StoreDataset(path, None, dtype="stored", **options)
    [batch] = StoreLoader(data, 10)
    [raw] = StoreLoader(stored, 10)
    finished = Normalize(stored)(raw)
    for i in range(10):
        want = expected(data.store[i], name, ends)
        np.testing.assert_allclose(data[i][name][0].numpy(), want, atol=2e-7)
        for found in (moved[i][name], batch[name][i], finished[name][i]):
            torch.testing.assert_close(found, data[i][name], atol=2e-7, rtol=1e-6)


def test_what_a_record_says_is_cut_by_default_and_nothing_else(path: Path) -> None:
    said = {name: m.cut for name, m in MODALITIES.items() if m.cut is not None}
    assert said == {"elevation": (-4, 4), "transformed_disparity": (-32, 32)}
    for normalize in (None, "constants", "imagenet", "train"):
        data = StoreDataset(path, None, ("rgb", "elevation"), normalize=normalize)
        assert data.scaling.cut == said
        assert repr(data).endswith("32x24; elevation cut to -4 to 4 m>")
    assert StoreDataset(path, None, "elevation", normalize="none").scaling.cut == {}
    high = np.full((24, 32), 7.5, np.float32)
    high[0] = np.nan
    high[1] = -7.5

    def raised(sample: dict[str, Any]) -> dict[str, Any]:
        return {**sample, "elevation": torch.from_numpy(high)[None]}

    found = StoreDataset(path, None, "elevation", transform=raised)[0]["inputs"][0]
    assert (found[0] == 0).all()
    assert (found[1] == -2).all()
    assert (found[2:] == 2).all()
    uncut = StoreDataset(path, None, "elevation", transform=raised, cut={"elevation": None})
    assert (uncut[0]["inputs"][0, 2:] == 3.75).all()


def test_a_view_is_made_of_what_was_cut(path: Path) -> None:
    names = ("depth", "depth3", "depth-minmax", "mask")
    data = StoreDataset(path, None, modalities=names, cut={"depth": (1.5, 2.0)})
    moved = StoreDataset(path, None, modalities=names, cut={"depth": (1.5, 2.0)}, transform=dict)
    depth = data.store[0].depth_m
    known, cut = depth > 0, np.clip(depth, 1.5, 2.0)
    for sample in (data[0], moved[0]):
        want = np.where(known, cut / 10, 0)
        np.testing.assert_allclose(sample["depth3"].numpy(), np.stack([want] * 3), atol=2e-7)
        assert np.array_equal(sample["mask"][0].numpy(), known)
        minmax = np.where(known, (cut - cut[known].min()) / np.ptp(cut[known]), 0)
        np.testing.assert_allclose(sample["depth-minmax"][0].numpy(), minmax, atol=1e-6)


def test_flipped_cropped_and_resized_frames_are_cut_alike_and_padding_is_0(path: Path) -> None:
    steps = Compose([RandomHorizontalFlip(1.0), Resize(48, 64), RandomCrop(60, 60)])
    cut = {"elevation": (-0.25, 0.5)}
    names = ("elevation", "disparity", "depth")
    plain = StoreDataset(path, None, modalities=names, transform=steps, normalize="none")
    scaled = StoreDataset(path, None, modalities=names, transform=steps, cut=cut)
    plain.set_epoch(0)
    scaled.set_epoch(0)
    for i in range(3):
        raw, sample = plain[i], scaled[i]
        rows = int(sample["size"][0])
        assert rows == 48
        assert not sample["elevation"][:, rows:].any()
        want = raw["elevation"].clamp(*cut["elevation"]) / 2
        there = raw["elevation"] != 0
        torch.testing.assert_close(sample["elevation"][there], want[there])
        torch.testing.assert_close(sample["disparity"], raw["disparity"] / 64)


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        ({"rgb": (0, 1)}, "one number per pixel .*elevation.*, planes.*found 'rgb'"),
        ({"normal": (0, 1)}, "expected some of rgb, elevation, which the setup has"),
        ({"elevation": (2, 1)}, "the lower first"),
        ({"elevation": (0, float("nan"))}, "finite numbers"),
        ({"elevation": 2}, r"two numbers for elevation, found 2; give \(low, high\)"),
        ({"elevation": ("a", "b")}, "two numbers for elevation"),
    ],
)
def test_what_is_no_range_is_refused(path: Path, cut: Any, message: str) -> None:
    with pytest.raises(ArrayError, match=message):
        StoreDataset(path, None, ("rgb", "elevation"), cut=cut)


def test_a_scaling_says_its_own_range(path: Path) -> None:
    own = Scaling({"elevation": (1.0,)}, {}, {"elevation": (0.0, 0.25)})
    found = StoreDataset(path, None, "elevation", normalize=own)
    assert found.scaling == own
    assert float(found[0]["inputs"].max()) == 0.25
    wrong = Scaling({}, {}, {"elevatoin": (0.0, 1.0)})
    with pytest.raises(ArrayError, match="found 'elevatoin'"):
        StoreDataset(path, None, "elevation", normalize=wrong)
