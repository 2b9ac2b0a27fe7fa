"""Frames of unlike size: what the largest costs all others is said before anything is done."""

import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import nimprep
from nimprep.conversion.merge import merge_stores
from nimprep.conversion.plan import warn_of_padding
from tests.conversion.test_append import write_frames
from tests.fakes import write_gmrp

CAMERA = (30.0, 31.0, 15.0, 11.0)
SAID = r"every frame is padded to the largest, 128x96 pixels \(of 1 of 7 frames, first '000006'\)"
FIGURES = "holds 0.1 million pixels for 0.0, and converting and reading take about 5 times"


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Return six frames of 32x24 and one of 128x96."""
    root = write_gmrp(tmp_path / "gmrp", 6)
    large = write_frames(tmp_path / "large", range(6, 7), (96, 128))
    for folder in ("rgb", "depth_u16", "label"):
        shutil.copy(large / folder / "000006.png", root / folder)
    return root


def test_one_large_frame_among_small_ones_is_said_before_any_is_converted(
    mixed: Path, tmp_path: Path
) -> None:
    steps = []

    def progress(step: str, frames: int) -> Callable[[], None]:
        steps.append((step, [str(w.message) for w in caught]))
        return lambda: None

    with pytest.warns(UserWarning, match=SAID) as caught:
        nimprep.convert(mixed, tmp_path / "s.zarr", camera=CAMERA, progress=progress)
    assert [FIGURES in str(w.message) for w in caught] == [True]
    assert all(FIGURES in said[0] for _, said in steps)
    assert steps
    assert "while most are 32x24" in str(caught[0].message)


def test_merging_says_it_too(tmp_path: Path) -> None:
    small, large = (
        write_gmrp(tmp_path / "a", 6),
        write_frames(tmp_path / "b", range(6, 7), (96, 128)),
    )
    stores = [
        nimprep.convert(source, tmp_path / f"{source.name}.zarr", camera=CAMERA).path
        for source in (small, large)
    ]
    with pytest.warns(UserWarning, match=SAID):
        merge_stores(stores, tmp_path / "both.zarr")


@pytest.mark.parametrize(
    "shapes",
    [
        {(375, 1242): ["a", "b"], (376, 1241): ["c"], (370, 1226): ["d"]},
        {(480, 640): ["a"]},
        {(480, 640): ["a"], (720, 1280): ["b", "c", "d"]},
    ],
)
def test_frames_of_nearly_one_size_are_not_spoken_of(
    shapes: dict[tuple[int, int], list[str]],
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_padding(shapes, "here")
