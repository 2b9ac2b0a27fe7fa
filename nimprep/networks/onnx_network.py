"""A trained network as a graph: what ONNX can say of a run, its normals included."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.networks.frames import DEPTH
from nimprep.networks.nim_options import scaling_rows, steps_of
from nimprep.networks.run_model import RunModel
from nimprep.torch.nim import METHODS as TRACED
from nimprep.torch.nim import NIM
from nimprep.torch.setups import channels_of
from nimprep.torch.views import VIEWS

CANNY, INTRINSICS = "canny", "intrinsics"


@dataclass(frozen=True)
class GraphInput:
    """Describe one input of the graph.

    Attributes
    ----------
    name : str
    shape : tuple of str or int
        Of its axes, by name where a caller chooses.
    dtype : torch.dtype
    about : str
        What it holds.
    """

    name: str
    shape: tuple[str | int, ...]
    dtype: torch.dtype
    about: str


class GraphNetwork(nn.Module):
    """Take a run's inputs by name and give logits, in operations that ONNX has.

    Parameters
    ----------
    model : RunModel

    Attributes
    ----------
    given : tuple of GraphInput
        In the order of `forward`'s arguments.
    """

    def __init__(self, model: RunModel) -> None:
        super().__init__()
        self.network = model.network
        self._inputs = model.inputs
        recipe, names = model.inputs.recipe, model.inputs.modalities
        vectors = [n for n in names if n in MODALITIES and MODALITIES[n].values == "vectors"]
        inside = recipe.normals in TRACED and recipe.fill == "none" and not recipe.lone_normals
        self._inside = frozenset(vectors if inside else ())
        self.nim = NIM(sign_filter=recipe.sign_filter)
        self._steps = steps_of(model.inputs.normal_dtype)
        wanted = [n for n in names if n not in self._inside]
        if self._inside or model.network.wants_depth:
            wanted.append(DEPTH)
        given = [_described(name) for name in dict.fromkeys(wanted)]
        if self._inside:
            about = "K, pixels; pixel (0, 0) is the centre of the top-left one"
            given.append(GraphInput(INTRINSICS, (1, 3, 3), torch.float32, about))
        if model.network.wants_canny:
            shape = (1, 1, "height", "width")
            about = "Canny's edges of the raw image, thresholds 10 and 100: 255 on one, else 0"
            given.append(GraphInput(CANNY, shape, torch.uint8, about))
        self.given = tuple(given)
        scaled = [name for name in (*names, DEPTH) if name not in vectors]
        self._rows = {name: scaling_rows(name, model.inputs.scaling) for name in scaled}

    def forward(self, *tensors: Tensor) -> Tensor:
        """Return logits, (B, C, H, W); tensors are as `given` says."""
        raw = {entry.name: tensor for entry, tensor in zip(self.given, tensors, strict=True)}
        if DEPTH in raw:
            raw[DEPTH], seen = self._stored(raw[DEPTH])
            for name in self._inside:
                raw[name] = self._rounded(self.nim(seen, raw[INTRINSICS]))
        images = [
            torch.cat([self._image(name, raw) for name in group], dim=1)
            for group in self._inputs.selection.groups
        ]
        if self.network.wants_canny:
            images.append(raw[CANNY].to(images[0].dtype))
        if self.network.wants_depth:
            images.append(self._scaled(DEPTH, raw[DEPTH]))
        found: Tensor = self.network(*images)
        return found

    def _image(self, name: str, raw: dict[str, Tensor]) -> Tensor:
        """Return a modality, or a view of one, as the network takes it."""
        if name not in VIEWS:
            return self._scaled(name, raw[name])
        if name not in _VIEWS:
            raise ArrayError(f"setup: expected views {', '.join(_VIEWS)}, found {name!r}")
        seen: Tensor = _VIEWS[name](self, raw[VIEWS[name].of])
        return seen

    def _scaled(self, name: str, image: Tensor) -> Tensor:
        """Return what `Scaling.apply` writes."""
        image = image.to(torch.float32)
        if name not in self._rows:
            return image
        scale, offset = (torch.tensor(row)[:, None, None] for row in self._rows[name])
        record = MODALITIES.get(name)
        scaled = self._cut(name, image) * scale + offset
        if record is not None and record.values == "colors":
            return scaled
        none = image.isnan()
        if record is not None and record.absent == 0:
            none = (image == 0).all(dim=1, keepdim=True)
        return torch.where(none, torch.zeros_like(scaled), scaled)

    def _cut(self, name: str, image: Tensor) -> Tensor:
        ends = self._inputs.scaling.cut.get(name)
        return image if ends is None else image.clamp(*ends)

    def _stored(self, depth_m: Tensor) -> tuple[Tensor, Tensor]:
        """Return depth as `FrameInputs.as_stored` rounds it, and as normals are derived from it."""
        record = self._inputs.depth
        steps = depth_m * record.steps
        counts = torch.isfinite(depth_m) & (depth_m >= LEAST_DEPTH_M) & (steps < 65535.5)
        none = torch.zeros_like(depth_m)
        rounded = torch.where(counts, steps.round() / record.steps, none)
        if self._steps is None or not self._inputs.is_coarse:
            return rounded, rounded
        return rounded, torch.where(rounded > 0, depth_m, none)

    def _rounded(self, normal: Tensor) -> Tensor:
        """Return normals rounded as the training's store had them."""
        if self._steps is None:
            return normal
        return functional.normalize((normal * self._steps).round(), dim=1)


def _stretched(graph: GraphNetwork, depth: Tensor) -> Tensor:
    """Return depth from 0, an image's nearest, to 1, its farthest; 0 where there is none."""
    depth = graph._cut(DEPTH, depth)
    known = depth != 0
    far = depth.amax(dim=(2, 3), keepdim=True)
    low = torch.where(known, depth, far).amin(dim=(2, 3), keepdim=True)
    stretched = (depth - low) / (far - low).clamp(min=1e-6)
    return torch.where(known, stretched, torch.zeros_like(depth))


_VIEWS = {
    "depth3": lambda graph, depth: graph._scaled(DEPTH, depth).repeat(1, 3, 1, 1),
    "mask": lambda graph, depth: (graph._cut(DEPTH, depth) != 0).to(torch.float32),
    "depth-minmax": _stretched,
}
"""As `nimprep.torch.views` has them, in operations that ONNX has; a test compares."""


def _described(name: str) -> GraphInput:
    """Return the input that a modality is."""
    record = MODALITIES.get(name)
    shape = (1, channels_of(name), "height", "width")
    if record is not None and record.values in ("colors", "levels"):
        return GraphInput(name, shape, torch.uint8, record.long_name or "0 to 255")
    if record is None:
        return GraphInput(name, shape, torch.float32, "in the plane's unit; NaN = none")
    none = "0" if record.absent == 0 else "NaN"
    unit = f", {record.units}" if record.units else ""
    return GraphInput(name, shape, torch.float32, f"{record.long_name}{unit}; {none} = none")
