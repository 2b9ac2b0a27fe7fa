"""The networks that Wang et al. (IROS 2020) train with and without surface normals.

    from nimprep.networks import build_network
    network = build_network("rtfnet18", inputs=(3, 3), classes=3)
    logits = network(rgb, normals)  # (B, 3, H, W)

Eight take one image, of as many channels as the setup has; four fuse two. All are written from
their papers, with the channels and layers of the public implementations.
"""

from nimprep.networks.beside import extra_inputs
from nimprep.networks.build import NETWORKS, build_network
from nimprep.networks.checkpoint import Checkpoint, read_checkpoint, save_checkpoint
from nimprep.networks.network import Loaded, Logits, Network
from nimprep.networks.nim_network import NimNetwork
from nimprep.networks.nim_options import PAPER_SETUPS
from nimprep.networks.run_model import RunModel, load_run
from nimprep.networks.weights import count_parameters, load_weights, save_weights

__all__ = [
    "NETWORKS",
    "PAPER_SETUPS",
    "Checkpoint",
    "Loaded",
    "Logits",
    "Network",
    "NimNetwork",
    "RunModel",
    "build_network",
    "count_parameters",
    "extra_inputs",
    "load_run",
    "load_weights",
    "read_checkpoint",
    "save_checkpoint",
    "save_weights",
]
