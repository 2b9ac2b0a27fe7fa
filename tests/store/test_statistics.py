from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.errors import StoreError
from nimprep.store.resplit import resplit
from nimprep.store.statistics import (
    ROWS,
    SUMS_SHAPE,
    channel_statistics,
    channel_sums,
    combine_sums,
)
from tests.fakes import SIZE, write_gmrp

CAMERA = (30.0, 30.0, 15.5, 11.5)

RNG = np.random.default_rng(0)


def images() -> dict[str, np.ndarray]:
    hha = RNG.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    hha[:5] = 0
    hha[6, 6] = (0, 7, 0)
    depth = RNG.integers(0, 65536, SIZE, dtype=np.uint16)
    depth[3:9] = 0
    rgb = RNG.integers(0, 256, (*SIZE, 3), dtype=np.uint8)
    rgb[0] = 0
    return {"rgb": rgb, "depth": depth, "hha": hha}


def test_sums_are_numpys_over_the_pixels_that_count() -> None:
    frame = images()
    sums = channel_sums(frame)
    counted = {
        "rgb": frame["rgb"].reshape(-1, 3),
        "depth": frame["depth"][frame["depth"] > 0].reshape(-1, 1),
        "hha": frame["hha"][frame["hha"].any(axis=2)],
    }
    for name, pixels in counted.items():
        wide = pixels.astype(object)
        for row, channel in zip(sums[ROWS[name]], wide.T, strict=True):
            assert row.tolist() == [len(channel), channel.sum(), (channel**2).sum()]


def test_statistics_are_numpys_over_all_frames_pixels_together() -> None:
    frames = [images() for _ in range(3)]
    found = combine_sums(np.stack([channel_sums(frame) for frame in frames]))
    depth = np.concatenate([f["depth"][f["depth"] > 0] for f in frames]) / 1000
    np.testing.assert_allclose(found["depth"].mean, [depth.mean()], rtol=1e-12)
    np.testing.assert_allclose(found["depth"].std, [depth.std()], rtol=1e-12)
    rgb = np.concatenate([f["rgb"].reshape(-1, 3) for f in frames])
    np.testing.assert_allclose(found["rgb"].mean, rgb.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found["rgb"].std, rgb.std(axis=0), rtol=1e-12)


def test_sums_of_many_far_frames_do_not_overflow() -> None:
    one = channel_sums({"depth": np.full((720, 1280), 65535, np.uint16)})
    found = combine_sums(np.broadcast_to(one, (4000, *SUMS_SHAPE)))
    assert found["depth"].mean == (65.535,)
    assert found["depth"].std == (0.0,)


def test_a_modality_without_pixels_is_left_out() -> None:
    sums = channel_sums({"rgb": np.ones((*SIZE, 3), np.uint8), "depth": np.zeros(SIZE, np.uint16)})
    assert set(combine_sums(sums[None])) == {"rgb"}
    assert combine_sums(np.zeros((0, *SUMS_SHAPE), np.int64)) == {}


def test_statistics_of_a_store_follow_its_split(tmp_path: Path) -> None:
    store = nimprep.convert(
        write_gmrp(tmp_path / "raw", frames=6), tmp_path / "s.zarr", camera=CAMERA
    )

    def expected(store: nimprep.Store) -> np.ndarray:
        pixels = [store[i].rgb for i in store.indices("train")]
        return np.stack(pixels).reshape(-1, 3).mean(axis=0)

    first = channel_statistics(store)["rgb"].mean
    np.testing.assert_allclose(first, expected(store), rtol=1e-12)
    resplit(store.path, seed=5)
    again = nimprep.open_store(store.path)
    assert not np.array_equal(again.indices("train"), store.indices("train"))
    np.testing.assert_allclose(channel_statistics(again)["rgb"].mean, expected(again), rtol=1e-12)


def test_padding_counts_for_nothing(tmp_path: Path) -> None:
    raw = write_gmrp(tmp_path / "raw", frames=1)
    write_gmrp(tmp_path / "other", frames=2, size=(20, 28))
    for folder in ("rgb", "depth_u16", "label", "depth_u8"):
        (tmp_path / "other" / folder / "000001.png").rename(raw / folder / "000001.png")
    store = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA)
    pixels = np.concatenate([frame.rgb.reshape(-1, 3) for frame in store])
    found = channel_statistics(store, None)["rgb"]
    np.testing.assert_allclose(found.mean, pixels.mean(axis=0), rtol=1e-12)


def test_a_split_without_frames_is_refused(tmp_path: Path) -> None:
    store = nimprep.convert(
        write_gmrp(tmp_path / "raw", frames=2), tmp_path / "s.zarr", camera=CAMERA
    )
    with pytest.raises(StoreError, match=r"expected frames in split 'val'.*nimprep split"):
        channel_statistics(store, "val")
