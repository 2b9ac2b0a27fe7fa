"""Normals by the method asked for, from the command to the store and to training."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import nimprep
from nimprep.cli import main
from nimprep.conversion.options import ConvertOptions
from nimprep.derive import normals_edge
from nimprep.derive.modalities import recipe_from
from nimprep.derive.normals_edge import Smoothing
from nimprep.errors import ArrayError, StoreError
from nimprep.store.checksums import with_digest
from nimprep.store.validate import validate_store
from tests.fakes import write_gmrp, write_png

CAMERA = (30.0, 31.0, 15.0, 11.0)


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return write_gmrp(tmp_path / "gmrp", frames=3)


def convert(*arguments: object):
    named = [str(a) for a in ("convert", *arguments, "--intrinsics", "30,31,15,11", "--quiet")]
    return CliRunner().invoke(main, named)


@pytest.mark.parametrize(
    ("options", "noise"), [((), "estimated"), (("--noise", "0.002"), 0.002), (("--noise", 0), 0.0)]
)
def test_convert_makes_edge_aware_normals_and_says_how(
    raw: Path, tmp_path: Path, options: tuple[object, ...], noise: object
) -> None:
    result = convert(raw, tmp_path / "s.zarr", "--normals", "nim-edge", *options)
    assert result.exit_code == 0, result.output
    store = nimprep.open_store(tmp_path / "s.zarr")
    made = store.attributes["modalities"]["normal"]
    assert made["method"] == "nim-edge"
    expected = {"noise": noise, "cells": "quartered", "lone": "none", "fill": "none"}
    assert made["parameters"] == expected
    frame, given = store[1], None if noise == "estimated" else noise
    exact = nimprep.estimate_normals(frame.depth_m, frame.camera, "nim-edge", noise=given)
    assert np.abs(exact - frame.normal).max() < 0.01
    assert recipe_from(store.attributes["modalities"]).noise == given
    report = validate_store(store.path, deep=True)
    assert report.problems == []
    assert report.checks["frames recomputed"] == 3


def test_a_deep_validation_finds_normals_of_another_method(raw: Path, tmp_path: Path) -> None:
    nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA, normals="nim-edge")
    path = tmp_path / "s.zarr" / "zarr.json"
    root = json.loads(path.read_text().replace('"estimated"', "0.5"))
    root["attributes"]["nimprep"] = with_digest(root["attributes"]["nimprep"])
    path.write_text(json.dumps(root))
    problems = validate_store(tmp_path / "s.zarr", deep=True).problems
    assert any("normal: expected what 'nim-edge' makes of the depth" in p for p in problems)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--normals", "nim-edge", "--sign-filter"),
            "--sign-filter: expected False with 'nim-edge', found True",
        ),
        (("--noise", "0.1"), "--noise: expected None with 'nim', found 0.1; 'nim-edge' has it"),
        (("--normals", "nim-edge", "--noise", "-1"), "-1"),
        (("--normals", "sobel"), "'sobel' is not one of"),
    ],
)
def test_options_of_the_other_method_are_a_wrong_call(
    raw: Path, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    result = convert(raw, tmp_path / "s.zarr", *options)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not (tmp_path / "s.zarr").exists()


@pytest.mark.parametrize(
    "options",
    [
        {"normals": "nim-edge", "sign_filter": True},
        {"noise": 0.1},
        {"normals": "nim-edge", "noise": -1},
    ],
)
def test_options_of_the_other_method_are_refused_before_anything_is_read(
    options: dict[str, object],
) -> None:
    with pytest.raises(ArrayError, match=r"^(sign_filter|noise): expected "):
        nimprep.ConvertOptions(**options)


def test_training_takes_edge_aware_normals_of_the_stored_depth(raw: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from nimprep.torch import StoreDataset, StoreLoader

    options = {"camera": CAMERA, "modalities": ("rgb", "depth")}
    path = nimprep.convert(raw, tmp_path / "s.zarr", **options).path
    frame = nimprep.open_store(path)[1]
    expected = nimprep.estimate_normals(frame.depth_m, frame.camera, method="nim-edge")
    dataset = StoreDataset(path, split=None, setup="nim-rgb+d", normals="nim-edge")
    assert np.array_equal(dataset[1]["inputs"][3:].numpy(), np.moveaxis(expected, 2, 0))
    (batch,) = StoreLoader(dataset, batch_size=3)
    assert np.array_equal(batch["inputs"][1, 3:].numpy(), np.moveaxis(expected, 2, 0))


def lone_frames(root: Path) -> Path:
    """Write frames in whose depth every pixel of the left half is alone."""
    write_gmrp(root, frames=3)
    v, u = np.mgrid[:24, :32]
    for path in (root / "depth_u16").iterdir():
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        write_png(path, np.where((u < 16) & ((u + v) % 2 == 0), 0, raw).astype(np.uint16))
    return root


def as_earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let conversions make normals as before pixels alone had none."""
    plain = ConvertOptions.recipe.fget
    monkeypatch.setattr(
        ConvertOptions, "recipe", property(lambda self: replace(plain(self), lone_normals=True))
    )


def test_pixels_alone_have_no_normal_in_a_store_and_it_says_so(tmp_path: Path) -> None:
    root = lone_frames(tmp_path / "gmrp")
    store = nimprep.convert(root, tmp_path / "s.zarr", camera=CAMERA)
    assert store.attributes["modalities"]["normal"]["parameters"]["lone"] == "none"
    frame = store[0]
    alone = (frame.depth_m > 0) & (np.arange(32) < 15)
    assert alone.sum() > 100
    assert not frame.normal[alone].any()
    assert validate_store(store.path, deep=True).problems == []


def test_a_store_whose_pixels_alone_face_the_camera_is_valid_and_goes_on_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = lone_frames(tmp_path / "gmrp")
    with monkeypatch.context() as earlier:
        as_earlier(earlier)
        store = nimprep.convert(root, tmp_path / "s.zarr", camera=CAMERA)
    assert "lone" not in store.attributes["modalities"]["normal"]["parameters"]
    later = lone_frames(tmp_path / "more")
    for folder in ("rgb", "depth_u16", "depth_u8", "label"):
        for path in (later / folder).iterdir():
            path.rename(path.with_name(f"1{path.name}"))
    store = nimprep.append_frames(later, store.path, camera=CAMERA).store
    for number in (0, 5):
        frame = store[number]
        alone = (frame.depth_m > 0) & (np.arange(32) < 15)
        assert (frame.normal[alone] == (0, 0, -1)).all()
    assert validate_store(store.path, deep=True).problems == []
    # What is of the other kind is found, in either.
    relabel(store.path, {"lone": "none"})
    assert any("depth is beside depth" in p for p in validate_store(store.path, deep=True).problems)


def test_stores_of_which_one_has_normals_alone_are_not_merged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = lone_frames(tmp_path / "gmrp")
    nimprep.convert(root, tmp_path / "a.zarr", camera=CAMERA)
    as_earlier(monkeypatch)
    nimprep.convert(root, tmp_path / "b.zarr", camera=CAMERA)
    with pytest.raises(StoreError, match=r"expected normal .*lone.*, found .*; convert one"):
        nimprep.merge_stores(
            [tmp_path / "a.zarr", tmp_path / "b.zarr"], tmp_path / "c.zarr", prefixes=["a", "b"]
        )


def relabel(path: object, parameters: dict[str, object]) -> None:
    """Let a store's attributes say something else of how its normals were made."""
    file = Path(str(path)) / "zarr.json"
    root = json.loads(file.read_text())
    root["attributes"]["nimprep"]["modalities"]["normal"]["parameters"] |= parameters
    root["attributes"]["nimprep"] = with_digest(root["attributes"]["nimprep"])
    file.write_text(json.dumps(root))


def test_a_store_of_whole_cells_is_valid_as_it_says_it_is_one(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smoothing = Smoothing(side=16, variance=1e-4, quartic=0, averaging=0.1, apart=1e-6)
    monkeypatch.setattr(normals_edge, "choose_smoothing", lambda *_: smoothing)
    now = nimprep.convert(raw, tmp_path / "now.zarr", camera=CAMERA, normals="nim-edge")
    plain = ConvertOptions.recipe.fget
    with monkeypatch.context() as earlier:
        whole = property(lambda self: replace(plain(self), whole_cells=True))
        earlier.setattr(ConvertOptions, "recipe", whole)
        store = nimprep.convert(raw, tmp_path / "s.zarr", camera=CAMERA, normals="nim-edge")
    assert "cells" not in store.attributes["modalities"]["normal"]["parameters"]
    assert np.abs(store[0].normal - now[0].normal).max() > 0.05
    for one in (now, store):
        assert validate_store(one.path, deep=True).problems == []
    relabel(store.path, {"cells": "quartered"})
    assert any("normal" in problem for problem in validate_store(store.path, deep=True).problems)
