"""Weights from files: torchvision's for encoders, a network's own for the whole of it."""

from __future__ import annotations

import pickle
import re
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import torch
from torch import Tensor, nn

from nimprep.errors import ArrayError, DoubtWarning
from nimprep.networks.densenet import DenseNet121
from nimprep.networks.network import Loaded, Network
from nimprep.networks.resnet import ResNet
from nimprep.networks.vgg import VGG16

FIRST = ("features.0.weight", "conv1.weight", "features.conv0.weight")
"""The first convolution of VGG, ResNet and DenseNet, which sees the image."""

_OLD_NAME = re.compile(r"^(.*denselayer\d+\.(?:norm|conv))\.([12]\.\w+)$")
"""DenseNet's layers as torchvision's files have them: norm.1 for norm1."""

_DAMAGED = (
    pickle.UnpicklingError,
    struct.error,
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What `torch.load` raises of other files, and of damaged ones: it follows what bytes say."""

MARK = "nimprep_network"
"""The key of a file's dict that holds all of a network, under "state"."""


def save_weights(network: Network, path: Path | str) -> None:
    """Write all of a network's weights, for `load_weights` to restore the whole."""
    torch.save({MARK: type(network).__name__, "state": network.state_dict()}, path)


def load_weights(network: Network, path: Path) -> Loaded:
    """Load weights into a network, as far as they fit.

    Parameters
    ----------
    path : path
        What `save_weights` wrote, or a file with torchvision's names.

    Raises
    ------
    ArrayError
        The file cannot be read, is another network's, or has nothing for this one.

    Warns
    -----
    DoubtWarning
        The file lacks a part of the encoder, or has more of one.
    """
    found = read_weights(path)
    if MARK in found:
        return _whole(network, found, path)
    state = found.get("state_dict", found)
    tensors = {str(k): v for k, v in state.items() if isinstance(v, Tensor)}
    return _encoders(network, tensors, path)


def read_weights(path: Path) -> dict[str, Any]:
    """Return the dict in a file of weights, on the CPU; nothing in it is run.

    Raises
    ------
    ArrayError
        It cannot be read, or holds something else.
    """
    try:
        with path.open("rb") as file:
            found = _loaded(file, path)
    except OSError as error:
        raise ArrayError(
            f"{path}: expected a file of weights, found {error.strerror or 'one out of reach'}"
        ) from error
    if not isinstance(found, dict):
        raise ArrayError(f"{path}: expected tensors by name, found {type(found).__name__}")
    return found


def _loaded(file: BinaryIO, path: Path) -> Any:
    """Return what a file of PyTorch's holds."""
    try:
        with warnings.catch_warnings():
            # That a file is of another protocol is no matter where it loads, and said where not.
            warnings.simplefilter("ignore")
            return torch.load(file, map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        whole = isinstance(error, pickle.UnpicklingError) and "GLOBAL" in str(error)
        kind = "a program's objects" if whole else "another, or a damaged one"
        more = "; torch.save(network.state_dict(), ...) writes what is read here" if whole else ""
        raise ArrayError(f"{path}: expected a file of weights, found {kind}{more}") from error


def tensors_in(found: Mapping[str, Any]) -> dict[str, Tensor]:
    """Return the tensors that a file has under "state", none where it has no such dict."""
    state = found.get("state")
    named = state.items() if isinstance(state, dict) else ()
    return {str(name): value for name, value in named if isinstance(value, Tensor)}


def _whole(network: Network, found: Mapping[str, Any], path: Path) -> Loaded:
    own = network.state_dict()
    state = tensors_in(found)
    shapes = {name: tuple(tensor.shape) for name, tensor in state.items()}
    if shapes != {name: tuple(tensor.shape) for name, tensor in own.items()}:
        raise ArrayError(
            f"{path}: expected weights of this {type(network).__name__}, found those of a "
            f"{found[MARK]} of other sizes; build it with the same inputs, classes and width"
        )
    for name, tensor in state.items():
        _check_numbers(name, tensor, path)
    network.load_state_dict(state)
    return Loaded(tuple(own), (), (), ())


def _encoders(network: Network, tensors: Mapping[str, Tensor], path: Path) -> Loaded:
    own = network.state_dict(keep_vars=True)
    tensors = {_OLD_NAME.sub(r"\1\2", name): tensor for name, tensor in tensors.items()}
    if not tensors:
        raise ArrayError(
            f"{path}: expected tensors by name, found none; give torchvision's weights of the "
            "encoder, or the best.pt of a run"
        )
    loaded, adapted, missing, used = [], [], [], set()
    found: list[tuple[Tensor, Tensor]] = []
    for place, name in _places(network):
        if name not in tensors:
            missing.append(name)
            continue
        target, given = own[place], tensors[name]
        fitted, other = _fitted(given, target, name)
        if fitted is None and name.startswith(_behind_deep_stem(network)):
            continue
        if fitted is None:
            raise ArrayError(
                f"{path}: expected {name} of shape {tuple(target.shape)}, found "
                f"{tuple(given.shape)}; weights fit width 1 and the network's own encoder"
            )
        _check_numbers(name, fitted, path)
        found.append((target, fitted))
        loaded.append(place)
        used.add(name)
        adapted += [place] if other else []
    if not loaded:
        raise ArrayError(
            f"{path}: expected weights of {type(network).__name__}'s encoder by torchvision's "
            f"names, found none among {len(tensors)} tensors"
        )
    # All of them or, where one does not fit, none.
    with torch.no_grad():
        for target, fitted in found:
            target.copy_(fitted)
    initial = tuple(name for name in own if name not in set(loaded))
    unused = tuple(name for name in tensors if name not in used)
    _say_others(path, network, missing, unused)
    return Loaded(tuple(loaded), tuple(adapted), initial, unused)


def _behind_deep_stem(network: Network) -> tuple[str, ...]:
    """Return how names begin of what a deep stem has made of other shapes than torchvision's."""
    deep = any(isinstance(m, ResNet) and m.deep_stem for m in network.modules())
    return ("bn1.", "layer1.0.conv1.", "layer1.0.downsample.0.") if deep else ()


def _say_others(
    path: Path, network: Network, missing: Sequence[str], unused: Sequence[str]
) -> None:
    """Warn where a file has some of the encoder, or more: one of another depth, as a rule."""
    stem = ("conv1.",) if _behind_deep_stem(network) else ()
    ours = ("features.transition4.", "features.norm.", "classifier.", *stem)
    lacking = [n for n in missing if not n.startswith(ours) and not n.endswith("_tracked")]
    theirs = ("fc.", "classifier.", "features.norm5.", *stem, *_behind_deep_stem(network))
    left = [n for n in unused if not n.startswith(theirs) and not n.endswith("_tracked")]
    for names, said in ((lacking, "found none for"), (left, "found no place for its")):
        if names:
            warnings.warn(
                f"{path}: expected the weights of {type(network).__name__}'s own encoder, {said} "
                f"{names[0]} and {len(names) - 1} more; give those of the same depth",
                DoubtWarning,
                stacklevel=4,
            )


def _places(network: Network) -> Iterator[tuple[str, str]]:
    """Yield the network's tensors that a file may hold, and their names there."""
    for prefix, module in network.named_modules():
        if isinstance(module, (VGG16, ResNet, DenseNet121)):
            for name in module.state_dict():
                yield f"{prefix}.{name}", name
    for ours, theirs in network.classifier.items():
        for kind in ("weight", "bias"):
            yield f"{ours}.{kind}", f"{theirs}.{kind}"


def _check_numbers(name: str, tensor: Tensor, path: Path) -> None:
    """Raise `ArrayError` where a tensor that is to be loaded holds no finite numbers."""
    counter = name.endswith("num_batches_tracked")
    if not (tensor.is_floating_point() or counter) or not bool(torch.isfinite(tensor).all()):
        found = "some that are none" if tensor.is_floating_point() else f"{tensor.dtype}"
        raise ArrayError(f"{path}: expected finite floats in {name}, found {found}")


def _fitted(given: Tensor, target: Tensor, name: str) -> tuple[Tensor | None, bool]:
    """Return a file's tensor as the network takes it, and whether it is of other channels."""
    if given.shape == target.shape:
        return given, False
    rest = (given.shape[:1] + given.shape[2:], target.shape[:1] + target.shape[2:])
    if name in FIRST and rest[0] == rest[1]:
        return given.to(target.dtype).mean(dim=1, keepdim=True).expand_as(target), True
    # A classifier's fully connected layer is a convolution over all that it saw.
    if name.startswith("classifier") and given.numel() == target.numel():
        return given.reshape(target.shape), False
    return None, False


def count_parameters(network: nn.Module) -> int:
    """Return how many numbers a network has that could be trained."""
    return sum(parameter.numel() for parameter in network.parameters())
