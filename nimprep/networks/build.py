"""Networks by name."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from nimprep.errors import ArrayError
from nimprep.networks.network import Network


class _Entry(NamedTuple):
    """Say where a network is, whether it takes two images, and what else makes it."""

    module: str
    name: str
    fusion: bool
    options: tuple[tuple[str, int], ...] = ()


NETWORKS: dict[str, _Entry] = {
    "fcn8s": _Entry("fcn8s", "FCN8s", False),
    "segnet": _Entry("segnet", "SegNet", False),
    "unet": _Entry("unet", "UNet", False),
    "deeplabv3plus": _Entry("deeplabv3plus", "DeepLabV3Plus", False),
    "denseaspp": _Entry("denseaspp", "DenseASPP", False),
    "dupsampling": _Entry("dupsampling", "DUpsampling", False),
    "espnet": _Entry("espnet", "ESPNet", False),
    "gscnn": _Entry("gscnn", "GSCNN", False),
    "fusenet": _Entry("fusenet", "FuseNet", True),
    "depthaware": _Entry("depthaware", "DepthAwareCNN", True),
    "mfnet": _Entry("mfnet", "MFNet", True),
    **{
        f"rtfnet{n}": _Entry("rtfnet", "RTFNet", True, (("depth", n),))
        for n in (18, 34, 50, 101, 152)
    },
}
"""The paper's networks; those that fuse take a pair of images."""


def build_network(
    name: str,
    inputs: int | tuple[int, ...],
    classes: int,
    width: float = 1.0,
    weights: Path | str | None = None,
    stages: int = 5,
) -> Network:
    """Make a network.

    Parameters
    ----------
    name : str
        A name in `NETWORKS`.
    inputs : int or tuple of int
        Channels of the image; a pair, of both images, for a network that fuses. What a data set's
        `selection.channels` says is taken as it is.
    classes : int
        Channels of the logits.
    width : float
        Of the channels within: 1 = as published, less for small machines; at most 1.
    weights : path, optional
        For the encoder, in torchvision's naming (vgg16, vgg16_bn, resnet18 to 152, densenet121), as
        the network has it; or what `save_weights` wrote, for the whole. What came of it is in
        the network's `loaded`.
    stages : int
        Of FuseNet alone: how many are fused, 1 to 5.

    Returns
    -------
    Network
        In training mode; calling it with images (B, N, H, W), H and W 64 or more, gives logits
        (B, classes, H, W).

    Raises
    ------
    ArrayError
        The name or a number is not one of these, or the weights do not fit.
    """
    if name not in NETWORKS:
        raise ArrayError(f"name: expected one of {', '.join(NETWORKS)}, found {name!r}")
    entry = NETWORKS[name]
    channels = inputs if isinstance(inputs, tuple) else (inputs,)
    _check(name, entry, channels, classes, width, stages)
    make: Callable[..., Network] = getattr(
        importlib.import_module(f"nimprep.networks.{entry.module}"), entry.name
    )
    options = {**dict(entry.options), **({"stages": stages} if name == "fusenet" else {})}
    network = make(channels if entry.fusion else channels[0], classes, width, **options)
    if weights is not None:
        from nimprep.networks.weights import load_weights

        network.loaded = load_weights(network, Path(os.fspath(weights)))
    return network


def _check(
    name: str,
    entry: _Entry,
    channels: tuple[object, ...],
    classes: object,
    width: object,
    stages: object,
) -> None:
    if len(channels) != 1 + entry.fusion or not all(_positive(n) for n in channels):
        kind = "a pair of channel counts" if entry.fusion else "a number of channels"
        raise ArrayError(f"inputs: expected {kind} for {name}, found {channels!r}")
    if not _positive(classes):
        raise ArrayError(f"classes: expected a positive number, found {classes!r}")
    if not isinstance(width, (int, float)) or not 0 < width <= 1:
        raise ArrayError(f"width: expected a number above 0 and at most 1, found {width!r}")
    if stages != 5 and name != "fusenet":
        raise ArrayError(f"stages: expected none for {name}, found {stages!r}; fusenet has them")


def _positive(number: object) -> bool:
    return isinstance(number, int) and not isinstance(number, bool) and number > 0
