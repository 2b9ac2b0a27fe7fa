"""A loaded run predicts what a robot has as it would in a store, whatever size and setup."""

from __future__ import annotations

import re
import warnings
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import nimprep
from nimprep.derive.recipe import Recipe
from nimprep.errors import ArrayError
from nimprep.networks import NimNetwork, load_run, read_checkpoint
from nimprep.schema import load_schema
from nimprep.torch.scaling import Scaling
from nimprep.training import predict
from tests.training.runs import change_run, make_run
from tests.training.stores import make_store
from tests.training.test_predict import EVERY, labels_in, scores_in


def given_of(raw: Path, name: str) -> tuple[Any, Any]:
    """Return colour and depth in metres, read from a dataset's files by OpenCV alone."""
    rgb = cv2.imread(str(raw / "rgb" / f"{name}.png"))[:, :, ::-1]
    depth = cv2.imread(str(raw / "depth_u16" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
    metres = depth / np.float32(1000)
    metres[depth == 65535] = 0
    return rgb, metres


def check_alike(store: Path, run: Path, out: Path) -> None:
    """Compare a robot's predictions with those of a store's frames: equal to the last bit."""
    predict(store, run, out, save_scores=True, device="cpu")
    labels, scores = labels_in(out), scores_in(out)
    opened, model = nimprep.open_store(store), load_run(run)
    for index in opened.indices("test"):
        name = opened.ids[index]
        rgb, depth_m = given_of(store.parent / "raw", name)
        found, planes = model.predict(rgb, depth_m, opened.camera(int(index)), scores=True)
        np.testing.assert_array_equal(planes, scores[name])
        np.testing.assert_array_equal(found, labels[name])
        assert found.dtype == np.uint8
        assert np.allclose(planes.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize(("network", "setup"), EVERY, ids=lambda part: str(part))
def test_a_robot_gets_what_a_store_gets(
    store: Path, tmp_path: Path, network: Any, setup: Any
) -> None:
    check_alike(store, make_run(store, tmp_path / "run", network, setup), tmp_path / "p")


@pytest.mark.parametrize(
    "options",
    [
        {"normals": "nim-edge"},
        {"normals": "nim-edge", "noise": 0.001},
        {"sign_filter": True, "normal_dtype": "int16"},
        {"hha_ground": "lowest", "depth_unit": "cm"},
        {"fill": "nearest"},
        {"fill": "nearest", "store_filled": True},
    ],
    ids=str,
)
def test_a_robot_gets_what_a_store_of_any_recipe_gets(
    tmp_path: Path, options: dict[str, Any]
) -> None:
    store = make_store(tmp_path, 3, **options)
    run = make_run(store, tmp_path / "run", "mfnet", ("rgb+d", "normal+hha"))
    check_alike(store, run, tmp_path / "p")


@pytest.mark.parametrize("normals", ["nim", "nim-edge"])
def test_normals_that_no_store_held_are_not_rounded(
    store: Path, tmp_path: Path, normals: str
) -> None:
    run = make_run(store, tmp_path / "run", "unet", "nim-depth", normals=normals)
    assert read_checkpoint(run).normal_dtype is None
    check_alike(store, run, tmp_path / "p")
    cached = make_run(store, tmp_path / "other", "unet", "nim-depth")
    _, depth_m = given_of(store.parent / "raw", "000000")
    camera = nimprep.open_store(store).camera(0)
    one, other = (load_run(r).predict(None, depth_m, camera, scores=True)[1] for r in (run, cached))
    assert not np.array_equal(one, other)


def test_the_layer_with_nim_in_it_gives_the_same(store: Path, tmp_path: Path) -> None:
    run = make_run(store, tmp_path / "run", "mfnet", "nim-rgb+d", normals="nim")
    found = read_checkpoint(run)
    scaling = Scaling(found.scale, found.offset, found.cut)
    layer = NimNetwork(found.build(), "nim-rgb+d", normalize=scaling).eval()
    rgb, depth_m = given_of(store.parent / "raw", "000001")
    camera = nimprep.open_store(store).camera(1)
    with torch.no_grad():
        logits = layer(
            torch.from_numpy(rgb.copy()).permute(2, 0, 1)[None],
            torch.from_numpy(depth_m)[None, None],
            torch.from_numpy(camera.matrix),
        )
    _, scores = load_run(run).predict(rgb, depth_m, camera, scores=True)
    np.testing.assert_allclose(scores, logits.softmax(dim=1)[0].numpy(), atol=1e-5)


@pytest.fixture(scope="module")
def run(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run that takes colour, normals, HHA and elevation."""
    out = tmp_path_factory.mktemp("robot")
    return make_run(store, out, "mfnet", ("rgb", "normal+hha+elevation"))


@pytest.mark.parametrize("size", [(64, 64), (97, 161), (40, 50), (1, 1), (65, 300)])
def test_any_size_is_taken_and_depth_may_be_nowhere(run: Path, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    rgb = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    camera = nimprep.Camera(60, 60, size[1] / 2, size[0] / 2, size[1], size[0])
    model = load_run(run)
    depth_m = rng.uniform(1, 9, size).astype(np.float32)
    nowhere = np.zeros(size, np.float32)
    odd = np.full(size, np.nan)
    odd[0, 0] = np.inf
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        labels, scores = model.predict(rgb, depth_m, camera, scores=True)
        none = model.predict(rgb, nowhere, camera, scores=True)[1]
        np.testing.assert_array_equal(model.predict(rgb, odd, camera, scores=True)[1], none)
    assert labels.shape == size
    assert scores.shape == (3, *size)
    assert np.isfinite(none).all()
    masked = np.ma.masked_array(depth_m, np.ones(size, bool))
    np.testing.assert_array_equal(model.predict(rgb, masked, camera, scores=True)[1], none)


def test_what_the_setup_has_no_use_for_may_be_left_out(store: Path, tmp_path: Path) -> None:
    rgb, depth_m = given_of(store.parent / "raw", "000002")
    model = load_run(make_run(store, tmp_path / "rgb", "unet", "rgb"))
    assert model.needs == ("rgb",)
    np.testing.assert_array_equal(
        model.predict(rgb), model.predict(rgb, depth_m, nimprep.open_store(store).camera(2))
    )
    only = load_run(make_run(store, tmp_path / "d", "unet", "depth"))
    assert only.predict(depth_m=depth_m).shape == depth_m.shape


def test_what_is_given_wrongly_is_told(run: Path) -> None:
    model = load_run(run)
    assert model.needs == ("depth", "rgb")
    rgb, depth_m = np.zeros((64, 70, 3), np.uint8), np.ones((64, 70), np.float32)
    camera = nimprep.Camera(60, 60, 35, 32, 70, 64)
    for given, said in [
        ((None, depth_m, camera), "rgb: expected it for a network of"),
        ((rgb, None, camera), "depth: expected it for a network of"),
        ((rgb, depth_m), "camera: expected it, from which elevation, hha, normal"),
        ((rgb / 255, depth_m, camera), "rgb: expected (H, W, 3) uint8, found (64, 70, 3) float64"),
        ((rgb[..., 0], depth_m, camera), "rgb: expected (H, W, 3) uint8"),
        ((rgb, depth_m[:60], camera), "frame: expected images of one size, found"),
        ((rgb, (1000 * depth_m).astype(np.uint16), camera), "floating-point metres, found uint16"),
        ((rgb, -depth_m, camera), "negative"),
        ((rgb, depth_m, nimprep.Camera(60, 60, 35, 32, 64, 70)), "camera: expected one of the"),
        ((rgb[:0], depth_m[:0], camera), "at least one pixel"),
    ]:
        with pytest.raises(ArrayError, match=re.escape(said)):
            model.predict(*given)
    with pytest.raises(ArrayError, match="planes: expected some of depth, rgb, found 'thermal'"):
        model.predict(rgb, depth_m, camera, planes={"thermal": depth_m})


def test_what_is_no_run_is_told_in_one_line(run: Path, tmp_path: Path) -> None:
    assert repr(load_run(run / "best.pt")).startswith("<mfnet of ('rgb', 'normal+hha+elevation')")
    whole = (run / "best.pt").read_bytes()
    for name, data in {
        "empty": b"",
        "cut": whole[: len(whole) // 2],
        "text": b"no checkpoint",
        "flipped": whole[:2000] + bytes(400) + whole[2400:],
    }.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(ArrayError, match=f"{name}: expected") as told:
            load_run(tmp_path / name)
        assert "\n" not in str(told.value)
    with pytest.raises(ArrayError, match=r"nowhere\.pt: expected"):
        load_run(tmp_path / "nowhere.pt")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ArrayError, match="found none; let it end"):
        load_run(tmp_path / "folder")
    with pytest.raises(ArrayError, match="device: expected one that is here, found cuda:99"):
        load_run(run, "cuda:99")


@pytest.mark.parametrize(
    "fields",
    [
        {"groups": (("rgb",), ("normal", "hha"))},
        {"width": 0.5},
        {"network": "unet"},
        {"recipe": {"normals": "other"}},
        {"scale": {"rgb": (1.0,)}},
        {"channels": (3, 9)},
    ],
    ids=str,
)
def test_a_checkpoint_whose_fields_do_not_fit_is_told(
    store: Path, tmp_path: Path, fields: dict[str, Any]
) -> None:
    run = make_run(store, tmp_path / "run", "mfnet", ("rgb", "normal+hha+elevation"))
    if "recipe" in fields:
        fields = {"recipe": {**read_checkpoint(run).recipe, **fields["recipe"]}}
    change_run(run, **fields)
    with pytest.raises(ArrayError, match=re.escape(str(run))) as told:
        load_run(run)
    assert "\n" not in str(told.value)


def test_checkpoints_hold_every_field_of_a_recipe(store: Path, tmp_path: Path) -> None:
    said = load_schema("checkpoint")["properties"]["recipe"]["properties"]
    assert said.keys() == {field.name for field in fields(Recipe)}
    run = make_run(store, tmp_path / "run", "unet", "nim-depth", normals="nim-edge")
    assert load_run(run).inputs.recipe.whole_cells is False
    recipe = {n: v for n, v in read_checkpoint(run).recipe.items() if n != "whole_cells"}
    change_run(run, recipe=recipe)
    assert load_run(run).inputs.recipe.whole_cells is True


@pytest.mark.parametrize("setup", ["nim-rgb+d", "rgb+hha", "rgb+d"])
def test_depth_beside_the_images_is_scaled_as_in_training(
    store: Path, tmp_path: Path, setup: Any
) -> None:
    run = make_run(store, tmp_path / "run", "depthaware", setup, normalize="train")
    scale, offset = Scaling.from_statistics(nimprep.open_store(store), ["depth"]).rows("depth")
    depth_m = np.array([[0, 2, 9, 40]], np.float32)
    expected = np.where(depth_m > 0, depth_m * scale + offset, 0)
    found = load_run(run).inputs.depth_beside(depth_m)[0].numpy()
    np.testing.assert_allclose(found, expected, atol=1e-6)
