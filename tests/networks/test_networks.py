"""What every network does: any size, any channels, training, weights from files."""

import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn import functional

from nimprep.errors import ArrayError, DoubtWarning
from nimprep.networks import (
    NETWORKS,
    Network,
    build_network,
    count_parameters,
    load_weights,
    save_weights,
)
from nimprep.networks.edges import canny_edges

WIDTH = 0.125
FUSION = [name for name, entry in NETWORKS.items() if entry.fusion]


def made(name: str, channels: int = 3, classes: int = 3) -> Network:
    torch.manual_seed(0)
    inputs = (3, channels) if name in FUSION else channels
    return build_network(name, inputs, classes, width=WIDTH)


def images(network: Network, height: int, width: int, batch: int = 1) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1)
    channels = (network.inputs,) if isinstance(network.inputs, int) else network.inputs
    return [torch.rand(batch, n, height, width, generator=generator) for n in channels]


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize(("height", "width"), [(64, 64), (97, 161)])
def test_any_size_in_is_the_size_out(name: str, height: int, width: int) -> None:
    network = made(name).eval()
    with torch.no_grad():
        logits = network(*images(network, height, width))
    assert logits.shape == (1, 3, height, width)
    assert torch.isfinite(logits).all()


@pytest.mark.parametrize("name", NETWORKS)
def test_two_steps_of_training_lower_the_loss_or_leave_it_finite(name: str) -> None:
    network = made(name, channels=1, classes=2)
    optimiser = torch.optim.SGD(network.parameters(), 1e-3)
    inputs = images(network, 64, 96)
    label = (inputs[0][:, 0] > 0.5).long()
    for _ in range(2):
        found = network(*inputs)
        logits = found[0] if network.auxiliary else found
        loss = functional.cross_entropy(logits, label, ignore_index=255)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        assert torch.isfinite(loss)
    untrained = [n for n, p in network.named_parameters() if p.requires_grad and p.grad is None]
    heads = ("auxiliary_head",)
    assert not [n for n in untrained if not n.startswith(heads)], untrained


@pytest.mark.parametrize("name", ["dupsampling", "gscnn"])
def test_auxiliary_outputs_come_in_training_and_on_request(name: str) -> None:
    network = made(name)
    inputs = images(network, 64, 64, batch=2)
    trained = network(*inputs)
    assert trained._fields[0] == "logits"
    assert trained[1].shape[-2:] == (64, 64)
    network.eval()
    with torch.no_grad():
        assert isinstance(network(*inputs), Tensor)
        assert network.outputs(*inputs)[1] is not None


def test_padding_changes_nothing_where_the_size_divides() -> None:
    network = made("mfnet").eval()
    x, y = images(network, 80, 96)
    with torch.no_grad():
        whole = network(x, y)
        cut = network(x[..., :70, :90], y[..., :70, :90])
        zeros = [functional.pad(image[..., :70, :90], (0, 6, 0, 10)) for image in (x, y)]
        assert torch.equal(cut, network(*zeros)[..., :70, :90])
    assert not torch.equal(cut, whole[..., :70, :90])


def test_edges_fill_their_range_and_can_be_given() -> None:
    x = torch.zeros(1, 3, 64, 64)
    x[..., 32:] = 0.01
    edges = canny_edges(x)
    assert edges.shape == (1, 1, 64, 64)
    assert set(edges.unique().tolist()) == {0.0, 255.0}
    assert edges[..., :20].max() == 0
    network = made("gscnn").eval()
    with torch.no_grad():
        assert torch.equal(network(x), network(x, edges))
        assert not torch.equal(network(x), network(x, 255 - edges))
    assert canny_edges(torch.full((1, 1, 64, 64), 0.5)).max() == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("resnet", 3, 3), "expected one of fcn8s"),
        (("unet", (3, 3), 3), "a number of channels for unet"),
        (("mfnet", 3, 3), "a pair of channel counts for mfnet"),
        (("unet", 0, 3), "a number of channels"),
        (("unet", 3, 0), "classes: expected a positive number"),
        (("unet", 3, 3, 0), "width: expected a number above 0"),
        (("unet", 3, 3, 1.0, None, 4), "fusenet has them"),
        (("fusenet", (3, 1), 3, 0.25, None, 6), "expected 1 to 5"),
        (("unet", 3, 3, 1.0, "nowhere.pth"), "nowhere.pth: expected a file of weights"),
    ],
)
def test_a_wrong_call_is_one_line(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(ArrayError, match=said):
        build_network(*arguments)  # type: ignore[arg-type]


def test_images_that_do_not_fit_are_one_line() -> None:
    network = made("mfnet").eval()
    x, y = images(network, 64, 64)
    for wrong in ((x,), (x, y[:, :1]), (x[..., :32], y[..., :32]), (x, y[..., :50, :])):
        with pytest.raises(ArrayError, match=r"MFNet: expected images of \(B, 3, H, W\)"):
            network(*wrong)


ENCODERS = {
    "fcn8s": ("features.0.weight", "features.28.bias"),
    "segnet": ("features.0.weight", "features.41.running_mean"),
    "deeplabv3plus": ("conv1.weight", "layer3.22.bn3.running_var"),
    "denseaspp": ("features.conv0.weight", "features.denseblock4.denselayer16.conv2.weight"),
    "rtfnet34": ("conv1.weight", "layer2.0.downsample.0.weight"),
    "depthaware": ("features.0.weight", "features.28.bias"),
}
"""First and last names, as torchvision has them, of what each network's encoder takes."""


@pytest.mark.parametrize("name", ENCODERS)
def test_an_encoder_takes_weights_by_torchvisions_names(name: str, tmp_path: Path) -> None:
    network = made(name, channels=1)
    first, last = ENCODERS[name]
    own = network.state_dict()
    prefix = next(k for k in own if k.endswith(first)).removesuffix(first)
    shape = own[prefix + first].shape
    file = {
        first: torch.rand(shape[0], 3, *shape[2:]),
        last: torch.rand(own[prefix + last].shape),
        "classifier.9.weight": torch.zeros(1),
    }
    torch.save(file, tmp_path / "weights.pth")
    loaded = load_weights(network, tmp_path / "weights.pth")
    found = network.state_dict()
    assert torch.equal(found[prefix + last], file[last])
    wanted = file[first] if shape[1] == 3 else file[first].mean(1, keepdim=True)
    assert torch.allclose(found[prefix + first], wanted.expand(shape))
    assert (prefix + first in loaded.adapted) == (shape[1] != 3)
    assert loaded.unused == ("classifier.9.weight",)
    assert set(loaded.loaded) | set(loaded.initial) == set(own)
    assert "1 of the file unused" in str(loaded)


def test_weights_of_another_shape_or_of_nothing_here_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "weights.pth"
    torch.save({"features.3.weight": torch.zeros(64, 64, 3, 3)}, path)
    with pytest.raises(ArrayError, match=r"features\.3\.weight of shape \(8, 8, 3, 3\), found"):
        load_weights(made("segnet"), path)
    with pytest.raises(ArrayError, match="GSCNN's encoder by torchvision's names, found none"):
        load_weights(made("gscnn"), path)
    path.write_bytes(b"no weights")
    with pytest.raises(ArrayError, match=r"weights\.pth: expected a file of weights"):
        load_weights(made("segnet"), path)


NO_WEIGHTS = {
    "empty": b"",
    "text": b"export PATH=/bin\n.gnu\n",
    "picture": b"\x89PNG\r\n\x1a\n" + bytes(range(60)),
    "archive": b"PK\x03\x04" + bytes(200),
    "stack": b"e.",
    "memory": b"h\x65.",
    "length": b"X\xff",
    "persistent": b"I1\nQ.",
    "list": pickle.dumps([1]),
}
"""Files that PyTorch's reader falls over in ways of its own."""


@pytest.mark.parametrize("kind", NO_WEIGHTS)
def test_a_file_of_something_else_is_one_line(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    path.write_bytes(NO_WEIGHTS[kind])
    with pytest.raises(ArrayError, match=r"w\.pth: expected .*, found (another|list)") as raised:
        load_weights(made("segnet"), path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("legacy", [False, True])
def test_a_damaged_file_is_one_line(legacy: bool, tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    network = made("segnet")
    file = {"features.0.weight": torch.rand(8, 3, 3, 3)}
    torch.save(file, path, _use_new_zipfile_serialization=not legacy)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = []
    for place in range(120):
        damaged = bytearray(whole[: None if place % 2 else int(rng.integers(len(whole)))])
        for at in rng.integers(len(damaged) + 1, size=3 * (place % 2)):
            damaged[min(at, len(damaged) - 1)] = int(rng.integers(256))
        path.write_bytes(damaged)
        try:
            with warnings.catch_warnings():
                # Most of the encoder is not in the file.
                warnings.simplefilter("ignore", DoubtWarning)
                load_weights(network, path)
        except ArrayError as error:
            refused.append(str(error))
    assert len(refused) > 50
    assert all(line.startswith(f"{path}: expected ") for line in refused)


def test_objects_of_a_program_are_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    torch.save(made("segnet"), path)
    with pytest.raises(ArrayError, match=r"found a program's objects; .*state_dict\(\)"):
        load_weights(made("segnet"), path)
    torch.save({"epoch": 3}, path)
    with pytest.raises(ArrayError, match=r"expected tensors by name, found none; give"):
        load_weights(made("segnet"), path)


def test_weights_that_are_no_numbers_are_refused_and_change_nothing(tmp_path: Path) -> None:
    path = tmp_path / "w.pth"
    network = made("segnet", channels=1)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    good = torch.rand(8, 3, 3, 3)
    for bad in (torch.full((8,), torch.nan), torch.ones(8, dtype=torch.int64), torch.ones(9)):
        torch.save({"features.0.weight": good, "features.0.bias": bad}, path)
        with pytest.raises(ArrayError, match=r"expected .*features\.0\.bias"):
            load_weights(network, path)
        now = network.state_dict()
        assert all(torch.equal(now[name], tensor) for name, tensor in before.items())
    spoiled = made("segnet")
    with torch.no_grad():
        spoiled.get_parameter("encoder.features.0.bias").fill_(torch.inf)
    save_weights(spoiled, path)
    with pytest.raises(ArrayError, match=r"expected finite floats in encoder\.features\.0\.bias"):
        load_weights(made("segnet"), path)


def test_a_fully_connected_layer_becomes_a_convolution(tmp_path: Path) -> None:
    network = made("fcn8s")
    shape = network.state_dict()["fc6.weight"].shape
    flat = torch.rand(shape[0], shape[1:].numel())
    torch.save({"classifier.0.weight": flat}, tmp_path / "weights.pth")
    load_weights(network, tmp_path / "weights.pth")
    assert torch.equal(network.state_dict()["fc6.weight"], flat.reshape(shape))


def test_a_saved_network_is_restored_whole(tmp_path: Path) -> None:
    network = made("fusenet")
    save_weights(network, tmp_path / "network.pt")
    again = build_network("fusenet", (3, 3), 3, width=WIDTH, weights=tmp_path / "network.pt")
    assert again.loaded is not None
    assert not again.loaded.initial
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, again.state_dict()[name])
    with pytest.raises(ArrayError, match="build it with the same inputs, classes and width"):
        build_network("fusenet", (3, 1), 3, width=WIDTH, weights=tmp_path / "network.pt")


def test_width_makes_networks_small() -> None:
    for name in NETWORKS:
        assert count_parameters(made(name)) < 6e6, name


def test_channels_are_taken_as_a_data_set_says_them() -> None:
    assert build_network("unet", (6,), 2, width=WIDTH).inputs == 6
    assert build_network("rtfnet18", (3, 1), 2, width=WIDTH).inputs == (3, 1)
    with pytest.raises(ArrayError, match=r"inputs: expected a number of channels .* \(3, 3\)"):
        build_network("unet", (3, 3), 2)
