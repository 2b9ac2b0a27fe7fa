"""The options of `NimNetwork`: which setups, which scaling, how normals are rounded."""

from __future__ import annotations

from collections.abc import Callable

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.networks.network import Network
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import SETUPS, Selection, Setup, select

MADE = ("rgb", "depth", "normal", "hha")
"""What can be made of colour, depth and a camera; HHA outside PyTorch."""

PAPER_SETUPS: tuple[Setup, ...] = tuple(n for n, parts in SETUPS.items() if set(parts) <= {*MADE})
"""The setups that `NimNetwork` takes: the paper's."""

_NAMED: dict[str, Callable[[], Scaling]] = {
    "constants": Scaling.constants,
    "imagenet": Scaling.imagenet,
    "none": Scaling.none,
}


def selection_of(network: Network, setup: Setup | tuple[str, ...]) -> Selection:
    """Return what a network's images are made of; `ArrayError` where its channels are others."""
    channels = getattr(network, "inputs", None)
    if channels is None:
        kind = type(network).__name__
        raise ArrayError(f"network: expected one that build_network made, found {kind}")
    selection = select(setup, fusion=isinstance(channels, tuple))
    if not set(selection.images) <= set(MADE):
        raise ArrayError(
            f"setup: expected one of {', '.join(PAPER_SETUPS)} or a mix of {', '.join(MADE)}, "
            f"which can be made of rgb, depth and intrinsics, found {setup!r}"
        )
    wanted = selection.channels if isinstance(channels, tuple) else selection.channels[0]
    if channels != wanted:
        raise ArrayError(
            f"network: expected one of inputs={wanted!r} for {setup!r}, found {channels!r}"
        )
    return selection


def steps_of(normal_dtype: str | None) -> int | None:
    """Return the steps to which a store rounds normals; None = not at all."""
    known = MODALITIES["normal"]
    if normal_dtype is None:
        return None
    if normal_dtype not in known.dtypes:
        raise ArrayError(
            f"normal_dtype: expected one of {', '.join(known.dtypes)} or None, found "
            f"{normal_dtype!r}"
        )
    return int(known.as_dtype(normal_dtype).steps)


def scaling_named(normalize: object) -> Scaling:
    """Return a scaling that needs no statistics, or the one that was given."""
    if isinstance(normalize, Scaling):
        return normalize
    name = "constants" if normalize is None else normalize
    if not isinstance(name, str) or name not in _NAMED:
        raise ArrayError(
            f"normalize: expected one of {', '.join(_NAMED)} or a Scaling, found {normalize!r}; "
            "of a dataset, give its scaling"
        )
    return _NAMED[name]()


def scaling_rows(name: str, scaling: Scaling) -> tuple[list[float], list[float]]:
    """Return a modality's scale and offset per channel."""
    # Depth beside what was trained on is scaled by no statistics of its own.
    known = name in scaling.scale or not scaling.scale
    scale, offset = (scaling if known else Scaling.constants()).rows(name)
    return scale.tolist(), offset.tolist()
