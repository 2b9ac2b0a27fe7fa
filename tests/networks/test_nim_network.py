"""A network with NIM in it sees what a data set's tensors would have shown it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import nimprep
from nimprep.errors import ArrayError
from nimprep.networks import (
    NETWORKS,
    PAPER_SETUPS,
    NimNetwork,
    extra_inputs,
)
from nimprep.networks.edges import canny_edges
from nimprep.torch import SETUPS, Scaling, StoreDataset
from nimprep.torch.setups import select
from tests.networks.frames import CAMERA, made, served, taken

FUSED = [name for name in PAPER_SETUPS if len(SETUPS[name]) == 2]
CASES = [(name, False) for name in PAPER_SETUPS] + [(name, True) for name in FUSED]


def test_the_setups_are_the_papers() -> None:
    assert PAPER_SETUPS == ("rgb", "depth", "hha", "rgb+d", "rgb+hha", "nim-depth", "nim-rgb+d")
    assert FUSED == ["rgb+d", "rgb+hha", "nim-rgb+d"]


@pytest.mark.parametrize(("setup", "fusion"), CASES)
def test_it_sees_what_a_data_set_shows(setup: Any, fusion: bool, path: Path) -> None:
    network = made("mfnet" if fusion else "unet", setup, fusion)
    model = NimNetwork(network, setup).eval()
    wanted = served(path, setup, fusion, normals="nim")
    found = model.inputs(**taken(path))
    assert len(found) == len(wanted) == 1 + fusion
    for a, b in zip(found, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-5)
    with torch.no_grad():
        logits = model(**taken(path))
        torch.testing.assert_close(logits, network(*wanted), rtol=0, atol=1e-5)
    assert logits.shape == (2, 3, 64, 80)


@pytest.mark.parametrize("normalize", ["constants", "imagenet", "none", "train"])
def test_the_normalisation_is_the_data_sets(normalize: Any, path: Path) -> None:
    data = StoreDataset(path, split=None, setup="rgb+d", normalize=normalize)
    wanted = data.__getitems__([0, 1])["inputs"]
    given: Any = data.scaling if normalize == "train" else normalize
    found = NimNetwork(made("unet", "rgb+d"), "rgb+d", normalize=given).inputs(**taken(path))[0]
    torch.testing.assert_close(found, wanted, rtol=1e-6, atol=1e-5)


def test_a_mix_of_its_own_and_a_cut_are_the_data_sets(path: Path) -> None:
    setup = ("rgb", "depth+normal")
    scaling = Scaling({"rgb": (0.01,) * 3, "depth": (0.5,)}, {}, {"depth": (2.0, 2.2)})
    wanted = served(path, setup, True, normals="nim", normalize=scaling)
    model = NimNetwork(made("mfnet", setup, True), setup, normalize=scaling)
    for a, b in zip(model.inputs(**taken(path)), wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-5)
    assert wanted[1][:, 0].unique().numel() > 2
    assert wanted[1][:, 0].max() == pytest.approx(1.1)


def test_colour_as_floats_is_the_same_colour(path: Path) -> None:
    model = NimNetwork(made("mfnet", "nim-rgb+d", True), "nim-rgb+d", normalize="imagenet")
    given = taken(path)
    again = {**given, "rgb": given["rgb"].float() / 255, "depth_m": given["depth_m"][:, None]}
    for a, b in zip(model.inputs(**given), model.inputs(**again), strict=True):
        torch.testing.assert_close(a, b)
    shared = {**given, "intrinsics": given["intrinsics"][0]}
    assert torch.equal(model.inputs(**shared)[1], model.inputs(**given)[1])


@pytest.mark.parametrize("dtype", ["int8", "int16"])
def test_normals_are_rounded_as_a_store_rounds_them(dtype: Any, path: Path, tmp_path: Path) -> None:
    raw = path.parent / "raw"
    store = nimprep.convert(raw, tmp_path / "b.zarr", camera=CAMERA, normal_dtype=dtype).path
    network = made("unet", "nim-depth")
    wanted = served(store, "nim-depth")[0]
    found = NimNetwork(network, "nim-depth", normal_dtype=dtype).inputs(**taken(store))[0]
    plain = NimNetwork(network, "nim-depth").inputs(**taken(store))[0]
    off = (found - wanted).abs().amax(dim=1)
    # On the edge between two steps either is right.
    assert float((off > 1e-6).float().mean()) < 0.005
    assert float(off.max()) < (0.009 if dtype == "int8" else 5e-5)
    assert float(((plain - wanted).abs().amax(dim=1) > 1e-6).float().mean()) > 0.5


def test_normals_by_the_other_method_and_by_the_sign_filter(path: Path) -> None:
    given, network = taken(path), made("unet", "nim-depth")
    frame = nimprep.open_store(path)[0]
    for options in ({"method": "nim-edge", "noise": 0.01}, {"sign_filter": True}):
        found = NimNetwork(network, "nim-depth", **options).inputs(**given)[0]  # type: ignore[arg-type]
        wanted = nimprep.estimate_normals(frame["depth"], frame.camera, **options)  # type: ignore[arg-type]
        np.testing.assert_allclose(found[0].permute(1, 2, 0).numpy(), wanted, atol=1e-5)
    plain = NimNetwork(network, "nim-depth").inputs(**given)[0]
    assert not torch.allclose(found, plain, atol=1e-2)


def test_gradients_reach_depth_through_the_network(path: Path) -> None:
    given = taken(path)
    given["depth_m"].requires_grad_()
    NimNetwork(made("unet", "nim-depth"), "nim-depth", normal_dtype="int8")(
        **given
    ).sum().backward()
    gradient = given["depth_m"].grad
    assert gradient is not None
    assert gradient.isfinite().all()
    assert gradient.any()
    edge = NimNetwork(made("unet", "nim-depth"), "nim-depth", method="nim-edge")
    with pytest.raises(ArrayError, match="none that requires a gradient with 'nim-edge'"):
        edge(**given)


def test_hha_can_be_given_or_is_computed(path: Path) -> None:
    model = NimNetwork(made("mfnet", "rgb+hha", True), "rgb+hha")
    given = taken(path)
    hha = np.stack([nimprep.open_store(path)[i]["hha"] for i in range(2)])
    own = torch.from_numpy(hha).permute(0, 3, 1, 2)
    assert torch.equal(model.inputs(**given)[1], model.inputs(given["rgb"], hha=own)[1])
    lowest = NimNetwork(model.network, "rgb+hha", hha_ground="lowest").inputs(**given)[1]
    assert not torch.equal(lowest, model.inputs(**given)[1])


@pytest.mark.parametrize("setup", ["rgb", "rgb+hha", "nim-depth"])
def test_edges_are_those_of_the_raw_colour(setup: Any, path: Path) -> None:
    network = made("gscnn", setup)
    model = NimNetwork(network, setup, normalize="imagenet").eval()
    given = taken(path)
    data = StoreDataset(path, split=None, setup=setup, normalize="imagenet", normals="nim")
    inputs = data.__getitems__([0, 1])["inputs"]
    (edges,) = extra_inputs(network, [inputs], data.selection, data.scaling)
    raw = given["rgb"] if "rgb" in data.selection.modalities else inputs
    assert torch.equal(edges, canny_edges(raw))
    with torch.no_grad():
        logits = model(**given)
        torch.testing.assert_close(logits, network(inputs, edges), rtol=0, atol=1e-5)
        other = model(**given, canny=255 - edges)
        torch.testing.assert_close(other, network(inputs, 255 - edges), rtol=0, atol=1e-5)
    assert not torch.allclose(logits, other)
    assert model.outputs(**given).edge.shape == (2, 1, 64, 80)


@pytest.mark.parametrize("setup", FUSED)
def test_likeness_stays_on_depth_whatever_the_second_image_is(setup: Any, path: Path) -> None:
    network = made("depthaware", setup, True)
    model = NimNetwork(network, setup).eval()
    images = served(path, setup, True, normals="nim")
    data = StoreDataset(path, split=None, modalities=("depth",))
    depth = data.__getitems__([0, 1])["depth"]
    selection = select(setup, fusion=True)
    extra = extra_inputs(network, images, selection, data.scaling, depth)
    assert [torch.equal(e, depth) for e in extra] == ([] if setup == "rgb+d" else [True])
    with torch.no_grad():
        wanted = network(*images, depth)
        torch.testing.assert_close(model(**taken(path)), wanted, rtol=0, atol=1e-5)
        torch.testing.assert_close(network(*images, *extra), wanted, rtol=0, atol=0)
        assert not torch.allclose(network(*images, 2 * depth), wanted)
    if extra:
        with pytest.raises(ArrayError, match="likeness is of depth"):
            extra_inputs(network, images, selection, data.scaling)


def test_in_training_it_gives_what_the_network_gives(path: Path) -> None:
    model = NimNetwork(made("dupsampling", "nim-rgb+d"), "nim-rgb+d").train()
    found = model(**taken(path))
    assert found._fields == ("logits", "auxiliary")
    assert isinstance(model.eval()(**taken(path)), Tensor)
    assert next(iter(model.state_dict())).startswith("network.")
    double = model.double()
    assert double(**taken(path)).dtype == torch.float64


@pytest.mark.parametrize("name", ["mfnet", "gscnn"])
def test_it_is_compiled_and_exported_whole(name: str, path: Path) -> None:
    fusion = NETWORKS[name].fusion
    model = NimNetwork(made(name, "nim-rgb+d", fusion), "nim-rgb+d").eval()
    given = taken(path)
    with torch.no_grad():
        wanted = model(**given)
        compiled = torch.compile(model, fullgraph=True, backend="eager")
        torch.testing.assert_close(compiled(**given), wanted, rtol=0, atol=1e-5)
        program = torch.export.export(model, (), given)
        torch.testing.assert_close(program.module()(**given), wanted, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "given"),
    [({"method": "nim-edge"}, {"setup": "nim-depth"}), ({}, {"setup": "hha"})],
)
def test_what_torch_cannot_compute_is_one_step_of_the_graph(
    options: Any, given: Any, path: Path
) -> None:
    setup = given["setup"]
    model = NimNetwork(made("unet", setup), setup, **options).eval()
    frames = {**taken(path), "rgb": None}
    with torch.no_grad():
        program = torch.export.export(model, (), frames)
        torch.testing.assert_close(program.module()(**frames), model(**frames))


def test_a_kitti_frame_gives_the_same_logits(reference_data: Path, tmp_path: Path) -> None:
    store = nimprep.convert(reference_data / "kitti_road", tmp_path / "road.zarr").path
    network = made("rtfnet18", "nim-rgb+d", True)
    data = StoreDataset(store, split=None, setup="nim-rgb+d", fusion=True, normals="nim")
    model = NimNetwork(network, "nim-rgb+d").eval()
    sample = data[0]
    frame = nimprep.open_store(store)[int(data.indices[0])]
    height, width = frame.camera.shape
    images = [image[None, :, :height, :width] for image in sample["inputs"]]
    rgb = torch.from_numpy(frame["rgb"]).permute(2, 0, 1)[None]
    depth = torch.from_numpy(frame["depth"])[None]
    torch.testing.assert_close(
        model.inputs(rgb, depth, sample["intrinsics"])[1], images[1], rtol=0, atol=1e-5
    )
    with torch.no_grad():
        found = model(rgb, depth, sample["intrinsics"])
        torch.testing.assert_close(found, network(*images), rtol=0, atol=1e-5)
