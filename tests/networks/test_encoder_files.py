"""Files as torchvision writes them load whole; those of another depth are said."""

import re
import warnings
from pathlib import Path

import pytest
import torch
from torch import Tensor, nn

from nimprep.errors import DoubtWarning
from nimprep.networks import NETWORKS, build_network
from nimprep.networks.densenet import DenseNet121
from nimprep.networks.resnet import ResNet
from nimprep.networks.vgg import VGG16


def file_of(kind: str) -> dict[str, Tensor]:
    """Return tensors of torchvision's names and shapes, each with numbers of its own."""
    encoders: dict[str, nn.Module] = {
        "vgg16_bn": VGG16(3, batch_norm=True),
        "densenet121": DenseNet121(3),
    }
    encoder = encoders.get(kind) or ResNet(int(kind.removeprefix("resnet")), 3)
    state = encoder.state_dict()
    if kind == "densenet121":
        # As in the files themselves; torchvision changes the names as it loads them.
        old = re.compile(r"(denselayer\d+\.(?:norm|conv))([12]\.)")
        own = ("features.transition4.", "features.norm.")
        state = {old.sub(r"\1.\2", n): t for n, t in state.items() if not n.startswith(own)}
        state |= {f"features.norm5.{kind}": torch.zeros(1024) for kind in ("weight", "bias")}
        state |= {"classifier.weight": torch.zeros(10, 1024)}
    elif kind.startswith("resnet"):
        state |= {"fc.weight": torch.zeros(10, 512), "fc.bias": torch.zeros(10)}
    return {n: t for n, t in state.items() if not n.endswith("num_batches_tracked")}


@pytest.mark.parametrize(
    ("name", "kind", "initial"),
    [
        ("segnet", "vgg16_bn", "decoder."),
        ("fusenet", "vgg16_bn", "decoder."),
        ("denseaspp", "densenet121", r"(blocks|head|encoder.features.(transition4|norm)\b)"),
        ("rtfnet18", "resnet18", "decoder."),
        (
            "dupsampling",
            "resnet50",
            r"(low|joined|up|auxiliary_head"
            r"|encoder.(conv1|bn1|layer1.0.conv1|layer1.0.downsample.0))",
        ),
    ],
)
def test_a_file_of_the_same_encoder_is_taken_whole(
    name: str, kind: str, initial: str, tmp_path: Path
) -> None:
    torch.save(file_of(kind), tmp_path / "w.pth")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DoubtWarning)
        network = build_network(
            name, (3, 1) if NETWORKS[name].fusion else 4, 2, weights=tmp_path / "w.pth"
        )
    assert network.loaded is not None
    left = [n for n in network.loaded.initial if not n.endswith("num_batches_tracked")]
    assert left
    assert [n for n in left if not re.match(initial, n)] == []


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("rtfnet34", "resnet18", r"RTFNet's own encoder, found none for layer1\.2\.conv1\.weight"),
        ("rtfnet18", "resnet34", r"found no place for its layer1\.2\.conv1\.weight and \d+ more"),
    ],
)
def test_a_file_of_another_depth_is_said(name: str, kind: str, said: str, tmp_path: Path) -> None:
    torch.save(file_of(kind), tmp_path / "w.pth")
    with pytest.warns(DoubtWarning, match=said):
        build_network(name, (3, 3), 2, weights=tmp_path / "w.pth")
