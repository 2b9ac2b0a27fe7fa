"""`--normals auto`: one method for a store, by the noise of some of its frames."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep import Camera, estimate_normals
from nimprep.cli import main
from nimprep.conversion import run
from nimprep.conversion.normals_choice import SAMPLE
from nimprep.errors import ArrayError, DecodeError
from nimprep.schema import schema_problems
from nimprep.store.info import info_text, store_info
from nimprep.store.validate import validate_store
from nimprep.synthetic import render_frame
from tests.derive.test_normals import plane_depth, unit
from tests.fakes import contents, write_gmrp, write_png

SIZE = (60, 80)
CAMERA = Camera(fx=70.0, fy=70.0, cx=39.5, cy=29.5, width=80, height=60)
OPTIONS = {"camera": (70.0, 70.0, 39.5, 29.5), "modalities": ("rgb", "depth", "normal")}
PLANE = 6.5 * plane_depth(unit((0.1, -0.3, -1)), 1.0, CAMERA)


def write(root: Path, noisy: str) -> Path:
    """Write one frame for each letter: a noisy plane where it is n, else one as exact as can be."""
    write_gmrp(root, frames=len(noisy), size=SIZE)
    rng = np.random.default_rng(4)
    for number, kind in enumerate(noisy):
        noise = rng.normal(0, 2e-3, SIZE)
        depth = 1 / (1 / PLANE + noise) if kind == "n" else np.full(SIZE, 3.0)
        raw = np.round(depth * 1000).astype(np.uint16)
        write_png(root / "depth_u16" / f"{number:06d}.png", raw)
    return root


def convert(root: Path, out: Path, **options: object):
    return nimprep.convert(root, out, normals="auto", **OPTIONS, **options)


@pytest.mark.parametrize(
    ("frames", "method"),
    [("n", "nim-edge"), ("c", "nim"), ("ccc", "nim"), ("cnn", "nim-edge"), ("ccn", "nim")],
)
def test_the_noise_of_most_frames_chooses_one_method_for_all(
    tmp_path: Path, frames: str, method: str
) -> None:
    store = convert(write(tmp_path / "gmrp", frames), tmp_path / "s.zarr")
    assert store.attributes["modalities"]["normal"]["method"] == method
    chosen = store.attributes["normals_chosen"]
    assert chosen["method"] == method
    assert [frame["id"] for frame in chosen["frames"]] == list(store.ids)
    assert [frame["turns_deg"] > 0.5 for frame in chosen["frames"]] == [k == "n" for k in frames]
    for frame in store:
        assert frame.depth_m is not None
        exact = estimate_normals(frame.depth_m, frame.camera, method)
        assert np.abs(exact - frame.normal).max() < 0.01
    report = validate_store(store.path, deep=True)
    assert report.problems == []


def test_what_is_measured_is_the_noise_that_is_there(tmp_path: Path) -> None:
    store = convert(write(tmp_path / "gmrp", "n"), tmp_path / "s.zarr")
    (frame,) = store.attributes["normals_chosen"]["frames"]
    depth = store[0].depth_m
    assert depth is not None
    expected = 2e-3 * np.median(depth)
    assert frame["relative"] == pytest.approx(expected, rel=0.2)
    turned = np.degrees(np.arctan(frame["relative"] * CAMERA.fx))
    assert frame["turns_deg"] == pytest.approx(turned)


def test_info_tells_what_was_chosen_and_by_what(tmp_path: Path) -> None:
    path = convert(write(tmp_path / "gmrp", "nn"), tmp_path / "s.zarr").path
    info = store_info(path)
    assert info["normals_chosen"]["method"] == "nim-edge"
    assert schema_problems(info, "info") == []
    assert "normals  nim-edge, chosen by noise of 0.0" in info_text(info)
    assert "(median of 2 frames, first '000000')" in info_text(info)
    path = convert(write(tmp_path / "clean", "c"), tmp_path / "c.zarr").path
    assert "normals  nim, chosen by no noise (median of 1 frame," in info_text(store_info(path))
    plain = nimprep.convert(tmp_path / "clean", tmp_path / "p.zarr", **OPTIONS)
    assert store_info(plain)["normals_chosen"] is None
    assert "normals_chosen" not in plain.attributes


def test_a_sample_of_many_frames_tells_and_any_number_of_workers_the_same(tmp_path: Path) -> None:
    root = write(tmp_path / "gmrp", "n" * (2 * SAMPLE + 3))
    one = convert(root, tmp_path / "one.zarr", workers=1)
    ids = [frame["id"] for frame in one.attributes["normals_chosen"]["frames"]]
    assert len(ids) == SAMPLE
    assert (ids[0], ids[-1]) == (one.ids[0], one.ids[-1])
    convert(root, tmp_path / "three.zarr", workers=3)
    assert contents(tmp_path / "one.zarr") == contents(tmp_path / "three.zarr")


def test_bad_frames_of_the_sample_choose_nothing(tmp_path: Path) -> None:
    root = write(tmp_path / "gmrp", "nnc")
    (root / "depth_u16" / "000001.png").write_bytes(b"")
    store = convert(root, tmp_path / "s.zarr", on_error="skip")
    assert [f["id"] for f in store.attributes["normals_chosen"]["frames"]] == ["000000", "000002"]
    assert [frame["id"] for frame in store.attributes["skipped"]] == ["000001"]
    with pytest.raises(DecodeError, match=r"depth_u16/000001\.png: "):
        convert(root, tmp_path / "t.zarr")


def test_a_run_that_goes_on_keeps_the_choice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write(tmp_path / "gmrp", "nnnn")
    convert(root, tmp_path / "whole.zarr", shard_length=1)
    path = root / "rgb" / "000002.png"
    whole = path.read_bytes()
    path.write_bytes(whole[:40])
    with pytest.raises(DecodeError, match=r"rgb/000002\.png"):
        convert(root, tmp_path / "s.zarr", shard_length=1)
    path.write_bytes(whole)

    def never(*_: object) -> None:
        raise AssertionError("the choice is made again")

    monkeypatch.setattr(run, "choose_normals", never)
    store = convert(root, tmp_path / "s.zarr", shard_length=1)
    expected = nimprep.open_store(tmp_path / "whole.zarr").attributes
    assert store.attributes["normals_chosen"] == expected["normals_chosen"]
    assert store[3].normal is not None


def test_frames_that_join_a_store_get_its_method_whatever_their_noise(tmp_path: Path) -> None:
    path = convert(write(tmp_path / "gmrp", "nn"), tmp_path / "s.zarr").path
    before = nimprep.open_store(path).attributes["normals_chosen"]
    more = write(tmp_path / "more", "ccccc")
    for folder in ("rgb", "depth_u16", "depth_u8", "label"):
        for name in ("000000.png", "000001.png"):
            (more / folder / name).unlink()
    store = nimprep.append_frames(more, path, camera=OPTIONS["camera"]).store
    assert len(store) == 5
    assert store.attributes["modalities"]["normal"]["method"] == "nim-edge"
    assert store.attributes["normals_chosen"] == before
    assert validate_store(path, deep=True).problems == []


def test_stores_that_are_merged_tell_all_frames_that_chose(tmp_path: Path) -> None:
    root = write(tmp_path / "gmrp", "nn")
    convert(root, tmp_path / "a.zarr")
    shutil.copytree(tmp_path / "a.zarr", tmp_path / "b.zarr")
    plain = nimprep.convert(root, tmp_path / "c.zarr", normals="nim-edge", **OPTIONS).path
    merged = nimprep.merge_stores(
        [plain, tmp_path / "a.zarr", tmp_path / "b.zarr"],
        tmp_path / "m.zarr",
        prefixes=["x/", "y/", "z/"],
    )
    ids = [frame["id"] for frame in merged.attributes["normals_chosen"]["frames"]]
    assert ids == ["y/000000", "y/000001", "z/000000", "z/000001"]
    assert validate_store(merged.path, deep=True).problems == []


def test_where_no_normals_are_stored_nothing_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = write(tmp_path / "gmrp", "n")
    monkeypatch.setattr(run, "choose_normals", None)
    options = {**OPTIONS, "modalities": ("rgb", "depth")}
    store = nimprep.convert(root, tmp_path / "s.zarr", normals="auto", **options)
    assert "normals_chosen" not in store.attributes


def test_auto_takes_neither_a_sign_filter_nor_a_noise() -> None:
    with pytest.raises(ArrayError, match=r"^sign_filter: expected False with 'auto'"):
        nimprep.ConvertOptions(normals="auto", sign_filter=True)
    with pytest.raises(ArrayError, match=r"^noise: expected None with 'auto', found 0.1"):
        nimprep.ConvertOptions(normals="auto", noise=0.1)


@pytest.mark.parametrize("kind", ["n", "c"])
def test_one_image_is_given_the_method_that_its_noise_asks_for(tmp_path: Path, kind: str) -> None:
    raw = cv2.imread(str(write(tmp_path / "gmrp", kind) / "depth_u16" / "000000.png"), -1)
    depth = raw / np.float32(1000)
    expected = estimate_normals(depth, CAMERA, "nim-edge" if kind == "n" else "nim")
    assert np.array_equal(estimate_normals(depth, CAMERA, "auto"), expected)


def chosen(depth: np.ndarray, camera: Camera) -> str:
    found = estimate_normals(depth, camera, "auto")
    same = [
        m for m in ("nim", "nim-edge") if np.array_equal(found, estimate_normals(depth, camera, m))
    ]
    (method,) = same
    return method


def test_a_clean_street_gets_the_paper_s_method_and_a_noisy_one_the_other() -> None:
    camera = Camera.from_fov(69.4, 320, 240)
    frame = render_frame(7, 1, camera)
    assert chosen(frame.depth_exact_m, camera) == "nim"
    assert chosen(frame.depth_m, camera) == "nim-edge"


@pytest.mark.parametrize("name", ["android", "demo"])
def test_clean_scenes_get_the_paper_s_method(reference_data: Path, name: str) -> None:
    folder = reference_data / "normals_3f2n" / name
    depth = np.fromfile(folder / "depth.bin", np.float32).reshape(480, 640)
    fx, fy, cx, cy, _ = map(float, (folder / "params.txt").read_text().split())
    depth[depth == 1] = 0
    assert chosen(depth, Camera(fx, fy, cx - 1, cy - 1, 640, 480)) == "nim"


def test_the_command_chooses_on_a_real_frame(reference_data: Path, tmp_path: Path) -> None:
    arguments = ["convert", reference_data / "gmrp", tmp_path / "s.zarr", "--normals", "auto"]
    done = CliRunner().invoke(main, [*map(str, arguments), "--modalities", "rgb,depth,normal"])
    assert done.exit_code == 0, done.output
    info = CliRunner().invoke(main, ["info", "--json", str(tmp_path / "s.zarr")])
    found = json.loads(info.stdout)
    assert found["modalities"]["normal"]["method"] == "nim-edge"
    assert found["normals_chosen"]["frames"][0]["relative"] > 0.005
