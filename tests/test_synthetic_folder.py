"""Synthetic frames as a folder in GMRP's raw layout."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from nimprep import Camera
from nimprep.errors import LayoutError, NimprepError
from nimprep.synthetic import render_frame, write_synthetic

SIZE = (48, 64)


def contents(folder: Path) -> dict[str, bytes]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def test_a_folder_holds_gmrps_layout_and_nothing_else(tmp_path):
    out = write_synthetic(tmp_path / "raw", frames=2, size=SIZE)
    assert out == tmp_path / "raw"
    folders = ("depth_u16", "label", "rgb")
    expected = {f"{folder}/{name}.png" for folder in folders for name in ("000000", "000001")}
    assert set(contents(out)) == {"camera.json", *expected}
    assert list(tmp_path.iterdir()) == [out]


def test_the_images_are_those_of_the_rendered_frames(tmp_path):
    out = write_synthetic(tmp_path / "raw", frames=2, seed=9, size=SIZE, normals=True)
    camera = Camera(**json.loads((out / "camera.json").read_text()))
    assert camera == Camera.from_fov(69.4, 64, 48)
    frame = render_frame(9, 1, camera)
    rgb, depth, label = (
        cv2.imread(str(out / kind / "000001.png"), cv2.IMREAD_UNCHANGED)
        for kind in ("rgb", "depth_u16", "label")
    )
    assert depth.dtype == np.uint16
    assert label.dtype == np.uint8
    np.testing.assert_array_equal(rgb[..., ::-1], frame.rgb)
    np.testing.assert_array_equal(depth / np.float32(1000), frame.depth_m)
    np.testing.assert_array_equal(label, frame.label)
    normal, exact = (np.load(out / kind / "000001.npy") for kind in ("normal", "depth_exact"))
    np.testing.assert_array_equal(normal, frame.normal)
    np.testing.assert_array_equal(exact, frame.depth_exact_m)
    assert normal.dtype == exact.dtype == np.float32


def test_without_noise_depth_is_exact_to_the_millimetre(tmp_path):
    out = write_synthetic(tmp_path / "raw", frames=1, size=SIZE, normals=True, noise=False)
    raw = cv2.imread(str(out / "depth_u16" / "000000.png"), cv2.IMREAD_UNCHANGED)
    exact = np.load(out / "depth_exact" / "000000.npy")
    assert (raw > 0).mean() > 0.4
    np.testing.assert_allclose(raw / 1000, exact, atol=0.0005001)


def test_labels_are_left_out_on_request(tmp_path):
    out = write_synthetic(tmp_path / "raw", frames=1, size=SIZE, labels=False)
    assert sorted(path.name for path in out.iterdir()) == ["camera.json", "depth_u16", "rgb"]


def test_the_same_call_gives_the_same_bytes_and_a_longer_series_begins_alike(tmp_path):
    first, again, longer, other = (
        contents(write_synthetic(tmp_path / name, frames=n, seed=seed, size=SIZE, normals=True))
        for name, n, seed in (("a", 2, 1), ("b", 2, 1), ("c", 4, 1), ("d", 2, 2))
    )
    assert first == again
    assert first.items() <= longer.items()
    assert all(other[name] != first[name] for name in first if name != "camera.json")


def test_an_empty_folder_is_filled(tmp_path):
    assert (write_synthetic(tmp_path, frames=1, size=SIZE) / "rgb" / "000000.png").is_file()


def test_progress_counts_every_frame(tmp_path):
    counts: list[int] = []
    write_synthetic(tmp_path / "raw", frames=5, size=SIZE, progress=counts.append)
    assert counts == [1] * 5


def test_a_folder_with_something_in_it_is_refused_and_kept(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(LayoutError, match=r"expected a new or empty folder, found 'notes.txt'"):
        write_synthetic(tmp_path, frames=1, size=SIZE)
    assert contents(tmp_path) == {"notes.txt": b"mine"}


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "raw").write_text("mine")
    with pytest.raises(LayoutError, match="expected a new or empty folder, found a file"):
        write_synthetic(tmp_path / "raw", frames=1, size=SIZE)


def test_a_folder_that_cannot_be_made_is_one_line_with_its_reason(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(NimprepError, match="expected to write it, found Not a directory") as caught:
        write_synthetic(tmp_path / "file" / "raw", frames=1, size=SIZE)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"frames": 0}, "synthetic frames: expected a whole number >= 1, found 0"),
        ({"frames": 1, "seed": -1}, "synthetic seed: expected a whole number >= 0, found -1"),
        ({"frames": 1, "size": (15, 64)}, "synthetic height: expected a whole number >= 16, fou"),
        ({"frames": 1, "size": (48, 0)}, "synthetic width: expected a whole number >= 16, found"),
    ],
)
def test_numbers_out_of_range_are_refused_before_anything_is_written(tmp_path, arguments, message):
    with pytest.raises(NimprepError, match=message):
        write_synthetic(tmp_path / "raw", **arguments)
    assert not (tmp_path / "raw").exists()


@pytest.mark.parametrize("existing", [False, True])
def test_a_run_cut_short_leaves_nothing_behind(tmp_path, existing):
    out = tmp_path / "raw"
    if existing:
        out.mkdir()

    def stop(_: int) -> None:
        assert not (out / "rgb").exists()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_synthetic(out, frames=8, size=SIZE, progress=stop)
    assert list(tmp_path.rglob("*")) == ([out] if existing else [])
