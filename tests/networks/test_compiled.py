"""Compilers take every network whole, and half precision runs through it.

`torch.compile` with the backend "eager": what it makes of a graph is PyTorch's own affair, that it
is one graph is the network's.
"""

import pytest
import torch

from nimprep.networks import NETWORKS, build_network
from tests.networks.test_networks import images

SMALL = [name for name in NETWORKS if not name.startswith("rtfnet")] + ["rtfnet18"]


@pytest.mark.parametrize("name", SMALL)
def test_a_network_is_one_graph_and_runs_in_bfloat16(name: str) -> None:
    torch.compiler.reset()
    inputs = (3, 3) if NETWORKS[name].fusion else 3
    network = build_network(name, inputs, 3, width=0.0625).eval()
    given = images(network, 65, 70)
    if network.wants_depth:
        given.append(given[1][:, :1])
    with torch.no_grad():
        wanted = network(*given)
        compiled = torch.compile(network, fullgraph=True, backend="eager")
        torch.testing.assert_close(compiled(*given), wanted)
        program = torch.export.export(network, tuple(given))
        torch.testing.assert_close(program.module()(*given), wanted)
    network.train()
    labels = torch.zeros(1, 65, 70, dtype=torch.int64)
    with torch.autocast("cpu", torch.bfloat16):
        loss = network.loss(network(*given), labels)
    loss.backward()
    assert loss.isfinite()
    grads = [p.grad for p in network.parameters() if p.grad is not None]
    assert grads
    assert all(grad.isfinite().all() for grad in grads)
