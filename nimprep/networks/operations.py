"""What is made of depth outside PyTorch, as operations that PyTorch can trace.

They run on the CPU, whatever device the depth is on, and no gradient passes through them.
`torch.compile` and `torch.export` take them as one step each; ONNX has no word for them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nimprep.camera import Camera
from nimprep.derive.methods import Ground

_Make = Callable[[npt.NDArray[np.float32], Camera], npt.NDArray[Any]]


@torch.library.custom_op("nimprep::edge_normals", mutates_args=())
def edge_normals(depth_m: Tensor, intrinsics: Tensor, noise: float | None) -> Tensor:
    """Return normals by "nim-edge", (B, 3, H, W) float32, as `nimprep.estimate_normals` does.

    Parameters
    ----------
    depth_m : (B, 1, H, W) floating, metres
        What is not finite, or 0 or less, is none.
    intrinsics : (B, 3, 3) floating
        K, pixels.
    noise : float, optional
        As `nimprep.estimate_normals` takes it.
    """

    from nimprep.derive.normals import estimate_normals

    def make(depth: npt.NDArray[np.float32], camera: Camera) -> npt.NDArray[Any]:
        return estimate_normals(depth, camera, method="nim-edge", noise=noise)

    return _frame_by_frame(make, depth_m, intrinsics)


@torch.library.custom_op("nimprep::hha", mutates_args=())
def hha_images(depth_m: Tensor, intrinsics: Tensor, ground: str) -> Tensor:
    """Return HHA, (B, 3, H, W) uint8, as `nimprep.encode_hha` does, gravity estimated.

    Parameters
    ----------
    depth_m, intrinsics
        As for `edge_normals`.
    ground : {"lowest", "floor"}
        Where heights are counted from.
    """
    from nimprep.derive.hha import encode_hha

    origin: Ground = "floor" if ground == "floor" else "lowest"

    def make(depth: npt.NDArray[np.float32], camera: Camera) -> npt.NDArray[Any]:
        return encode_hha(depth, camera, ground=origin)

    return _frame_by_frame(make, depth_m, intrinsics)


def _frame_by_frame(make: _Make, depth_m: Tensor, intrinsics: Tensor) -> Tensor:
    height, width = depth_m.shape[-2:]
    made = []
    for depth, matrix in zip(depth_m[:, 0], intrinsics, strict=True):
        some = torch.where(torch.isfinite(depth), depth, 0).clamp(min=0)
        pixels = np.ascontiguousarray(some.to(torch.float32).cpu().numpy())
        camera = Camera.from_matrix(matrix.to(torch.float64).cpu().numpy(), width, height)
        made.append(torch.from_numpy(make(pixels, camera)).permute(2, 0, 1))
    return torch.stack(made).contiguous().to(depth_m.device)


@edge_normals.register_fake
def _(depth_m: Tensor, intrinsics: Tensor, noise: float | None) -> Tensor:
    shape = (len(depth_m), 3, *depth_m.shape[-2:])
    return depth_m.new_empty(shape, dtype=torch.float32)


@hha_images.register_fake
def _(depth_m: Tensor, intrinsics: Tensor, ground: str) -> Tensor:
    return depth_m.new_empty((len(depth_m), 3, *depth_m.shape[-2:]), dtype=torch.uint8)
