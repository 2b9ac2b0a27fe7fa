"""What networks cost: operations counted by hand, and the table of docs/networks.md."""

import re
from pathlib import Path

import pytest
import torch
from torch import nn

from nimprep.errors import ArrayError
from nimprep.networks import NETWORKS, build_network, count_parameters
from nimprep.networks.cost import count_flops
from tests.networks.test_networks import images, made

PAGE = Path(__file__).parent.parent.parent / "docs" / "networks.md"


def test_a_convolution_has_two_operations_for_each_multiply_add() -> None:
    shape = torch.empty(1, 3, 10, 12, device="meta")
    layers = nn.Sequential(nn.Conv2d(3, 5, 3, padding=1), nn.ReLU(), nn.BatchNorm2d(5))
    assert count_flops(layers, [shape]) == 2 * (10 * 12 * 5) * (3 * 9)
    up = nn.ConvTranspose2d(3, 7, 2, 2)
    assert count_flops(up, [shape]) == 2 * (10 * 12 * 3) * (7 * 4)


@pytest.mark.parametrize("name", ["unet", "mfnet", "rtfnet18", "espnet", "dupsampling", "gscnn"])
def test_operations_are_those_of_the_convolutions_that_run(name: str) -> None:
    network = made(name).train()
    counted = [0]

    def count(layer: nn.Module, given: tuple[torch.Tensor, ...], found: torch.Tensor) -> None:
        assert isinstance(layer, (nn.Conv2d, nn.ConvTranspose2d))
        each = given[0] if isinstance(layer, nn.ConvTranspose2d) else found
        counted[0] += 2 * layer.weight[0].numel() * each.numel()

    convolutions = (nn.Conv2d, nn.ConvTranspose2d)
    layers = [m for m in network.modules() if isinstance(m, convolutions)]
    for layer in layers:
        layer.register_forward_hook(count)
    network.eval()
    with torch.no_grad():
        network(*images(network, 64, 80))
    for layer in layers:
        layer._forward_hooks.clear()
    network.train()
    before = {key: value.clone() for key, value in network.state_dict().items()}
    assert network.flops(64, 80) == counted[0] > 0
    assert all(module.training for module in network.modules())
    assert all(torch.equal(value, before[key]) for key, value in network.state_dict().items())
    with pytest.raises(ArrayError, match="64 or more"):
        network.flops(32, 32)


def test_the_pages_table_says_what_is_counted() -> None:
    rows = dict(re.findall(r"^\| (\w+) \| ([\d,]+ \| [\d.]+) \|", PAGE.read_text(), re.M))
    assert rows.keys() == NETWORKS.keys()
    for name in ("espnet", "gscnn", "mfnet", "rtfnet18", "depthaware"):
        with torch.device("meta"):
            network = build_network(name, (3, 3) if NETWORKS[name].fusion else 6, 3)
        operations = network.flops(480, 640) / 1e9
        assert rows[name] == f"{count_parameters(network):,} | {operations:.1f}", name
