"""What two of the networks take beside their images, of what a data set serves."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.networks.edges import canny_edges
from nimprep.networks.network import SMALLEST, Network
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import Selection, channels_of


def extra_inputs(
    network: Network,
    images: Sequence[Tensor],
    selection: Selection,
    scaling: Scaling,
    depth: Tensor | None = None,
) -> tuple[Tensor, ...]:
    """Return what a network is called with after its images, as `NimNetwork` calls it.

    Parameters
    ----------
    network : Network
    images : sequence of (B, N, H, W) float32
        A batch's "inputs", one or two.
    selection : Selection
    scaling : Scaling
        Both the dataset's, whose batch it is.
    depth : (B, 1, H, W) float32, optional
        As the dataset scales it, for `network.wants_depth`: Depth-aware CNN with normals or HHA.

    Returns
    -------
    tuple of (B, 1, H, W)
        For GSCNN its Canny map, of the raw colour where the images have some; for Depth-aware CNN
        the depth that likeness is of, where that is not its second image; else empty.

    Raises
    ------
    ArrayError
        Depth is needed and not given.
    """
    if network.wants_canny:
        name = colour_of(selection)
        raw = images[0] if name is None else _raw(name, images, selection, scaling)
        return (canny_edges(raw),)
    if network.wants_depth:
        if depth is None:
            raise ArrayError(
                f"depth: expected (B, 1, H, W) for {type(network).__name__} of "
                f"{'+'.join(selection.images)}, found none; its likeness is of depth"
            )
        return (depth,)
    return ()


def whole_logits(
    network: Network,
    images: Sequence[Tensor],
    selection: Selection,
    scaling: Scaling,
    depth: Tensor | None = None,
) -> Tensor:
    """Return a network's logits of whole frames of any size, (B, C, H, W).

    Parameters are those of `extra_inputs`; images have no padding, whose border would be an edge of
    the Canny map.
    """
    height, width = images[0].shape[-2:]
    more = extra_inputs(network, images, selection, scaling, depth)
    # Networks take no smaller images; what is added goes again.
    down, right = max(SMALLEST - height, 0), max(SMALLEST - width, 0)
    given = [functional.pad(image, (0, right, 0, down)) for image in (*images, *more)]
    logits: Tensor = network(*given)
    return logits[..., :height, :width]


def colour_of(selection: Selection) -> str | None:
    """Return the modality that is a colour image, None where there is none."""
    named = (name for name in selection.modalities if name in MODALITIES)
    return next((name for name in named if MODALITIES[name].values == "colors"), None)


def _raw(name: str, images: Sequence[Tensor], selection: Selection, scaling: Scaling) -> Tensor:
    """Return a modality's 8-bit numbers, (B, 3, H, W) uint8, of what they were scaled to."""
    place = next(i for i, group in enumerate(selection.groups) if name in group)
    group = selection.groups[place]
    begin = sum(channels_of(other) for other in group[: group.index(name)])
    part = images[place][:, begin : begin + channels_of(name)]
    scale, offset = (
        torch.from_numpy(row).to(part.device)[:, None, None] for row in scaling.rows(name)
    )
    return ((part - offset) / scale).round().clamp(0, 255).to(torch.uint8)
