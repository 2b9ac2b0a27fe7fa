"""A network with NIM in it: colour, depth and a camera in, logits out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from nimprep.derive.methods import FIXED_METHODS, GROUNDS, FixedMethod, Ground, check_method
from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.networks.beside import colour_of
from nimprep.networks.edges import canny_edges
from nimprep.networks.given import Given, checked
from nimprep.networks.network import Network
from nimprep.networks.nim_options import scaling_named, scaling_rows, selection_of, steps_of
from nimprep.networks.operations import edge_normals, hha_images
from nimprep.torch.nim import METHODS as TRACED
from nimprep.torch.nim import NIM
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import Setup


class NimNetwork(nn.Module):
    """Give a network colour, depth and a camera; the normals are computed inside.

    What the network sees is what `StoreDataset` gives for the setup, from the same colour and
    depth: with ``normals="nim"``, to 1e-5. Normals that a store keeps are rounded, to steps of
    1/127 or 1/32767, and so up to 0.006 or 2.1e-5 beside those; `normal_dtype` rounds likewise.

    `torch.compile` and `torch.export` take it whole, ONNX too but for "nim-edge" and for HHA and
    Canny maps that are not given.

    Parameters
    ----------
    network : Network
        What `build_network` makes, of the setup's channels: as one number where it takes one image,
        as a pair where it fuses.
    setup : str or tuple of str
        One of the paper's: rgb, depth, hha, rgb+d, rgb+hha, nim-depth, nim-rgb+d; the three of two
        modalities for fusion as well. Or another mix of rgb, depth, normal and hha, as
        `StoreDataset` takes it.
    method : {"nim", "nim-edge"}
        How normals are estimated; see `nimprep.estimate_normals`. "nim" is differentiable and runs
        where the depth is; "nim-edge" is a kernel on the CPU, through which no gradient passes.
    sign_filter : bool
        Of "nim" alone.
    noise : float, optional
        Of "nim-edge" alone.
    normal_dtype : {"int8", "int16"}, optional
        Round normals as a store does that holds them as this: what a network saw that was trained
        with cached ones. Where rounding falls on an edge they may still differ by a step. None = as
        they are.
    hha_ground : {"floor", "lowest"}
        Of HHA that is computed here: where heights are counted from.
    normalize : str or Scaling, optional
        As the network was trained: "constants" (None), "imagenet", "none", or the `scaling` of the
        training data, ``StoreDataset(...).scaling``, which "train" made.

    Attributes
    ----------
    network : Network
    selection : Selection
        Which modalities each tensor of the network's input is made of.
    scaling : Scaling

    Raises
    ------
    ArrayError
        The setup is none of these, the network's channels are others, or an option does not fit.

    Examples
    --------
    ::

        network = build_network("rtfnet18", inputs=(3, 3), classes=3)
        model = NimNetwork(network, "nim-rgb+d").eval()
        logits = model(rgb, depth_m, intrinsics)  # (B, 3, H, W)

    References
    ----------
    Wang et al., "Applying surface normal information in drivable area and road anomaly detection
    for ground mobile robots", IROS 2020.
    """

    def __init__(
        self,
        network: Network,
        setup: Setup | tuple[str, ...],
        method: FixedMethod = "nim",
        sign_filter: bool = False,
        *,
        noise: float | None = None,
        normal_dtype: Literal["int8", "int16"] | None = None,
        hha_ground: Ground = "floor",
        normalize: Literal["constants", "imagenet", "none"] | Scaling | None = None,
    ) -> None:
        super().__init__()
        if method not in FIXED_METHODS:
            known = ", ".join(map(repr, FIXED_METHODS))
            raise ArrayError(f"method: expected one of {known}, found {method!r}")
        check_method(method, sign_filter, noise)
        if hha_ground not in GROUNDS:
            known = ", ".join(GROUNDS)
            raise ArrayError(f"hha_ground: expected one of {known}, found {hha_ground!r}")
        self.steps = steps_of(normal_dtype)
        self.network = network
        self.setup = setup
        self.selection = selection_of(network, setup)
        self.scaling = scaling_named(normalize)
        scaled = [name for name in _MAKERS if MODALITIES[name].values != "vectors"]
        self._rows = {name: scaling_rows(name, self.scaling) for name in scaled}
        self.method = method
        self.noise = noise
        self.hha_ground = hha_ground
        self.nim = NIM(sign_filter=sign_filter)

    def forward(
        self,
        rgb: Tensor | None = None,
        depth_m: Tensor | None = None,
        intrinsics: Tensor | None = None,
        hha: Tensor | None = None,
        canny: Tensor | None = None,
    ) -> Any:
        """Return what the network gives: logits, (B, C, H, W); in training with its auxiliary ones.

        What the setup has no use for may be None.

        Parameters
        ----------
        rgb : (B, 3, H, W) uint8 or floating
            8-bit colour, or floats from 0 to 1, 1 being 255.
        depth_m : (B, 1, H, W) or (B, H, W) floating, metres
            Along the optical axis; 0, NaN, infinity = none, as below 0.1 mm.
        intrinsics : (B, 3, 3) or (3, 3) floating
            K, pixels; pixel (0, 0) is the centre of the top-left one. Of the images as they are
            given, after any crop or change of size.
        hha : (B, 3, H, W) uint8 or floating, optional
            As `nimprep.encode_hha` makes it, its channels in front; floats as for `rgb`. None =
            computed of the depth on the CPU, gravity estimated, where the setup has HHA.
        canny : (B, 1, H, W), optional
            Of GSCNN alone: 255 on an edge, else 0. None = computed of `rgb` on the CPU, or of the
            network's input where the setup has no colour.

        Raises
        ------
        ArrayError
            Something is missing, or of another shape or type; numbers cannot be what they are to
            be, which is not looked at in a graph that PyTorch compiles or exports.
        """
        return self.network(*self._arguments(rgb, depth_m, intrinsics, hha, canny))

    def outputs(
        self,
        rgb: Tensor | None = None,
        depth_m: Tensor | None = None,
        intrinsics: Tensor | None = None,
        hha: Tensor | None = None,
        canny: Tensor | None = None,
    ) -> Any:
        """Return the network's every output in any mode; parameters as for `forward`."""
        return self.network.outputs(*self._arguments(rgb, depth_m, intrinsics, hha, canny))

    def inputs(
        self,
        rgb: Tensor | None = None,
        depth_m: Tensor | None = None,
        intrinsics: Tensor | None = None,
        hha: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        """Return the network's images, as `StoreDataset` gives them in "inputs", one or two."""
        return self._images(checked(rgb, depth_m, intrinsics, hha))

    def extra_repr(self) -> str:
        """Return the options, for `print(model)`."""
        return f"setup={self.setup!r}, method={self.method!r}"

    def _arguments(
        self,
        rgb: Tensor | None,
        depth_m: Tensor | None,
        intrinsics: Tensor | None,
        hha: Tensor | None,
        canny: Tensor | None,
    ) -> list[Tensor]:
        given = checked(rgb, depth_m, intrinsics, hha)
        arguments = list(self._images(given))
        if canny is not None and not self.network.wants_canny:
            raise ArrayError(f"canny: expected none, found one; {self._name} takes no edges")
        if self.network.wants_canny:
            if canny is None and colour_of(self.selection):
                canny = canny_edges(self._needed(given.rgb, "rgb").round().to(torch.uint8))
            arguments += [] if canny is None else [canny.to(arguments[0].dtype)]
        if self.network.wants_depth:
            depth = self._scaled("depth", self._needed(given.depth_m, "depth_m"))
            arguments.append(depth.to(arguments[0].dtype))
        return arguments

    def _images(self, given: Given) -> tuple[Tensor, ...]:
        planes = {n: self._scaled(n, self._made(n, given)) for n in self.selection.modalities}
        dtype = next(self.network.parameters()).dtype
        return tuple(
            torch.cat([planes[name].to(dtype) for name in group], dim=1)
            for group in self.selection.groups
        )

    def _made(self, name: str, given: Given) -> Tensor:
        make: Callable[[Given], Tensor] = getattr(self, _MAKERS[name])
        return make(given)

    def _scaled(self, name: str, image: Tensor) -> Tensor:
        """Return what `Scaling.apply` writes, as operations that PyTorch traces; 0 stays none."""
        if name not in self._rows:
            return image
        scale, offset = (
            torch.tensor(row, dtype=image.dtype, device=image.device)[:, None, None]
            for row in self._rows[name]
        )
        ends = self.scaling.cut.get(name)
        cut = image if ends is None else image.clamp(*ends)
        scaled = cut * scale + offset
        if MODALITIES[name].values == "colors":
            return scaled
        none = (image == 0).all(dim=1, keepdim=True)
        return torch.where(none, torch.zeros_like(scaled), scaled)

    def _rgb(self, given: Given) -> Tensor:
        return self._needed(given.rgb, "rgb")

    def _depth(self, given: Given) -> Tensor:
        return self._needed(given.depth_m, "depth_m")

    def _normal(self, given: Given) -> Tensor:
        normal = self._estimated(given)
        if self.steps is None:
            return normal
        integers = (normal.detach() * self.steps).round()
        rounded = functional.normalize(integers, dim=1)
        # The gradient is that of the normal: a step has none.
        return rounded + (normal - normal.detach())

    def _estimated(self, given: Given) -> Tensor:
        depth, matrix = self._depth(given), self._needed(given.intrinsics, "intrinsics")
        if self.method in TRACED:
            normal: Tensor = self.nim(depth, matrix)
            return normal
        if depth.requires_grad or matrix.requires_grad:
            raise ArrayError(
                f"depth_m: expected none that requires a gradient with {self.method!r}, found one; "
                f"{TRACED[0]!r} passes it on"
            )
        edged: Tensor = edge_normals(depth, matrix, self.noise)
        return edged

    def _hha(self, given: Given) -> Tensor:
        if given.hha is not None:
            return given.hha
        depth, matrix = self._depth(given), self._needed(given.intrinsics, "intrinsics")
        hha: Tensor = hha_images(depth.detach(), matrix.detach(), self.hha_ground)
        return hha.to(torch.float32)

    def _needed(self, tensor: Tensor | None, name: str) -> Tensor:
        if tensor is None:
            raise ArrayError(f"{name}: expected it for setup {self.setup!r}, found none")
        return tensor

    @property
    def _name(self) -> str:
        return type(self.network).__name__


_MAKERS = {"rgb": "_rgb", "depth": "_depth", "normal": "_normal", "hha": "_hha"}
"""The methods that make each modality of what is given."""
