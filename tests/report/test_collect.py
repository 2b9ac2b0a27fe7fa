"""Statistics of small stores, counted by hand and by a slow twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nimprep
from nimprep.report import collect as module
from nimprep.report.charts import make_charts
from nimprep.report.collect import (
    DIRECTION_BINS,
    DIRECTION_REACH,
    Sums,
    collect,
)
from nimprep.report.depth_charts import depth_quantiles
from nimprep.report.hashes import NEAR, difference_hash, nearest
from nimprep.store.reader import Store
from nimprep.store.statistics import byte_histogram

from .stores import HEIGHT, WIDTH, Folder, gmrp_store, mixed_store, photograph


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return nimprep.open_store(gmrp_store(tmp_path_factory.mktemp("gmrp"), frames=20))


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return nimprep.open_store(mixed_store(tmp_path_factory.mktemp("mixed")))


def test_holes_and_classes_are_those_that_the_fake_frames_have(store: Store) -> None:
    facts = collect(store)
    # Three rows of four pixels, and the saturated one, which the layout reads as none.
    assert (facts.valid == HEIGHT * WIDTH - 13).all()
    assert facts.hole_share == pytest.approx(13 / (HEIGHT * WIDTH))
    assert facts.classes.tolist() == [[12 * 32, 12 * 32 - 16, 16]] * 20
    assert not facts.ignored.any()
    assert not facts.undeclared.any()
    holes = np.zeros((HEIGHT, WIDTH), int)
    holes[:3, 5:9] = holes[-1, -1] = 20
    assert np.array_equal(facts.sums.holes, holes)
    assert (facts.sums.seen == 20).all()


def test_sums_are_those_of_a_plain_loop_over_all_frames(mixed: Store) -> None:
    facts = collect(mixed)
    assert facts.step == 1
    depth, hha = np.zeros(65536, int), np.zeros((3, 256), int)
    seen, normals = np.zeros((HEIGHT, WIDTH), int), 0
    for i in range(len(mixed)):
        height, width = mixed.tables.image_size[i]
        seen[:height, :width] += 1
        images = {n: mixed.arrays[n].read(i)[:height, :width] for n in mixed.modalities}
        for value in images["depth"].ravel():
            depth[value] += 1
        for pixel in images["hha"].reshape(-1, 3):
            for channel in range(3):
                hha[channel, pixel[channel]] += pixel.any()
        normals += int(images["normal"].any(axis=2).sum())
    assert np.array_equal(facts.sums.depth.sum(axis=0), depth)
    assert np.array_equal(facts.sums.hha, hha)
    assert np.array_equal(facts.sums.seen, seen)
    assert facts.sums.directions.sum() + facts.sums.directions_outside == normals
    assert facts.pixels.tolist() == [768, 768, 560, 560]


def test_depth_is_counted_by_split(store: Store) -> None:
    rows = collect(store).sums.depth.sum(axis=1)
    counts = [len(store.indices(name)) for name in ("train", "val", "test")]
    assert rows.tolist() == [n * HEIGHT * WIDTH for n in (*counts, 0)]


def test_any_number_of_threads_gives_the_same(store: Store) -> None:
    one, three = collect(store, num_threads=1), collect(store, num_threads=3)
    for name in ("depth", "holes", "seen", "directions", "hha"):
        assert np.array_equal(getattr(one.sums, name), getattr(three.sums, name))
    assert np.array_equal(one.hashes, three.hashes)


def test_progress_is_told_of_each_frame(store: Store) -> None:
    calls = []
    collect(store, lambda step, frames: lambda: calls.append((step, frames)))
    assert calls == [("looking", 20)] * 20


def test_large_images_are_sampled_for_distributions_only(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = collect(store)
    monkeypatch.setattr(module, "SAMPLED_PIXELS", HEIGHT * WIDTH // 4)
    sampled = collect(store)
    assert sampled.step == 2
    assert np.array_equal(sampled.valid, whole.valid)
    assert np.array_equal(sampled.classes, whole.classes)
    assert np.array_equal(sampled.sums.holes, whole.sums.holes[::2, ::2])
    assert sampled.sums.depth.sum() == 20 * HEIGHT * WIDTH // 4


def direction_cell(*normal: float) -> tuple[int, int]:
    part = Sums.zeros((1, 1))
    module._count_directions(np.array([[normal]], np.float32), part)
    ((row, column),) = np.argwhere(part.directions)
    return int(row), int(column)


def test_normals_lie_where_the_equal_area_projection_puts_them() -> None:
    middle = DIRECTION_BINS // 2
    per_unit = DIRECTION_BINS / (2 * DIRECTION_REACH)
    assert direction_cell(0, 0, -1) == (middle, middle)
    assert direction_cell(0, -1, 0) == (middle - round(per_unit), middle)
    assert direction_cell(3, 0, 0) == (middle, middle + round(per_unit))
    # 60 degrees off the axis, to the left: sqrt(1 - cos 60°).
    left = round(np.sqrt(0.5) * per_unit)
    assert direction_cell(-np.sqrt(3) / 2, 0, -0.5) == (middle, middle - left)


def test_an_even_spread_of_normals_fills_cells_evenly() -> None:
    vectors = np.random.default_rng(0).normal(size=(1, 400_000, 3))
    vectors[..., 2] = -np.abs(vectors[..., 2])
    part = Sums.zeros((1, 1))
    module._count_directions(vectors, part)
    middle, reach = DIRECTION_BINS // 2, int(0.6 * DIRECTION_BINS / (2 * DIRECTION_REACH))
    inner = part.directions[middle - reach : middle + reach, middle - reach : middle + reach]
    cell = (2 * DIRECTION_REACH / DIRECTION_BINS) ** 2
    assert inner.mean() == pytest.approx(400_000 * cell / np.pi, rel=0.02)
    assert inner.std() < 2 * np.sqrt(inner.mean())


def test_bytes_are_counted_exactly() -> None:
    image = np.random.default_rng(0).integers(0, 256, (50, 70), dtype=np.uint8)[:, :33]
    assert np.array_equal(byte_histogram(image), np.bincount(image.ravel(), minlength=256))


def test_quantiles_are_those_of_the_depths_there_are(tmp_path: Path) -> None:
    folder = Folder(tmp_path / "raw")
    depth = np.repeat(np.array([0, 1000, 2000, 3000], np.uint16), HEIGHT * WIDTH // 4)
    folder.add("train", depth_mm=depth.reshape(HEIGHT, WIDTH))
    facts = collect(nimprep.open_store(folder.store()))
    assert depth_quantiles(facts, (0.1, 0.5, 0.99)) == [1.0, 2.0, 3.0]
    assert facts.farthest.tolist() == [3000]
    assert facts.at_farthest.tolist() == [HEIGHT * WIDTH // 4]


def test_charts_say_in_words_what_they_show(store: Store) -> None:
    charts = make_charts(store, collect(store))
    assert set(charts) == {
        "chart-classes",
        "chart-depth",
        "chart-holes",
        "chart-hole-map",
        "chart-directions",
        "chart-height",
        "chart-angle",
    }
    assert "train: background 50.0" in charts["chart-classes"].gist
    assert "1.7 to 1.7 %, median 1.7 %" in charts["chart-holes"].gist
    # Twelve of the first eight rows' 256 pixels, none of the middle's, one of the last's.
    assert "upper third 4.7 %, middle third 0.0 %, lower third 0.4 %" in (
        charts["chart-hole-map"].gist
    )


def test_a_store_of_colour_alone_has_no_chart(tmp_path: Path) -> None:
    store = nimprep.open_store(gmrp_store(tmp_path, 2, modalities=("rgb",), labels=False))
    assert make_charts(store, collect(store)) == {}


def distance(a: np.ndarray, b: np.ndarray) -> int:
    return int(nearest(difference_hash(a)[None], difference_hash(b)[None])[1][0])


def test_a_hash_hardly_changes_with_brightness_noise_and_size() -> None:
    import cv2

    picture = cv2.resize(photograph(1), (640, 480), interpolation=cv2.INTER_CUBIC)
    noise = np.random.default_rng(0).normal(0, 4, picture.shape)
    assert distance(picture, (picture * 0.7).astype(np.uint8)) <= NEAR
    assert distance(picture, np.clip(picture + noise, 0, 255).astype(np.uint8)) <= NEAR
    assert distance(picture, cv2.resize(picture, (320, 240))) <= NEAR
    assert distance(picture, np.roll(picture, 4, axis=1)) <= NEAR


def test_hashes_of_other_pictures_are_far() -> None:
    near = [distance(photograph(i), photograph(j)) for i in range(8) for j in range(i)]
    assert min(near) > 2 * NEAR


def test_the_nearest_hash_is_that_of_a_plain_search() -> None:
    rng = np.random.default_rng(0)
    queries, others = (rng.integers(0, 2**64, (n, 4), dtype=np.uint64) for n in (700, 90))
    index, bits = nearest(queries, others)
    for i in range(0, 700, 7):
        plain = [
            sum((int(a) ^ int(b)).bit_count() for a, b in zip(queries[i], o, strict=True))
            for o in others
        ]
        assert bits[i] == min(plain)
        assert index[i] == plain.index(min(plain))
