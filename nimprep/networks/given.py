"""What a robot gives a network: colour, depth and a camera, checked and brought to their units."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.errors import ArrayError

# As `nimprep.encode_hha` has it: outside of these no median of depth in metres lies.
_NEAR_M, _FAR_M = 0.05, 100.0

# Interpolation overshoots; 8-bit numbers as floats go far beyond.
_BRIGHTEST = 2.0


class Given(NamedTuple):
    """Hold what was given, each None where it was not.

    Attributes
    ----------
    rgb : (B, 3, H, W) float32, 0 to 255
    depth_m : (B, 1, H, W) float32 or float64, metres
        0 = none.
    intrinsics : (B, 3, 3) floating
    hha : (B, 3, H, W) float32, 0 to 255
    """

    rgb: Tensor | None
    depth_m: Tensor | None
    intrinsics: Tensor | None
    hha: Tensor | None


def checked(
    rgb: Tensor | None,
    depth_m: Tensor | None,
    intrinsics: Tensor | None,
    hha: Tensor | None,
) -> Given:
    """Return what was given in one form.

    Numbers are looked at too, except in a graph that PyTorch compiles or exports.

    Raises
    ------
    ArrayError
        A shape, a type or a number is not as `NimNetwork` says.
    """
    depth = None if depth_m is None else _depth(depth_m)
    matrix = None if intrinsics is None else _intrinsics(intrinsics, depth)
    given = Given(_colors("rgb", rgb), depth, matrix, _colors("hha", hha))
    sizes = {
        f"{name} {(len(image), *image.shape[2:])}": (len(image), *image.shape[2:])
        for name, image in (("rgb", given.rgb), ("depth_m", depth), ("hha", given.hha))
        if image is not None
    }
    if len(set(sizes.values())) > 1:
        raise ArrayError(f"expected images of one batch and size, found {', '.join(sizes)}")
    return given


def _colors(name: str, image: Tensor | None) -> Tensor | None:
    if image is None:
        return None
    if image.ndim != 4 or image.shape[1] != 3:
        raise ArrayError(f"{name}: expected (B, 3, H, W), found {tuple(image.shape)}")
    if image.dtype == torch.uint8:
        return image.to(torch.float32)
    if not image.is_floating_point():
        raise ArrayError(f"{name}: expected uint8, or floats from 0 to 1, found {image.dtype}")
    if not torch.compiler.is_compiling():
        low, high = (float(n) for n in image.detach().aminmax())
        if not 1 - _BRIGHTEST <= low <= high <= _BRIGHTEST:
            raise ArrayError(
                f"{name}: expected uint8, or floats from 0 to 1, found floats from {low:g} to "
                f"{high:g}; scaling is the layer's own"
            )
    return image.to(torch.float32) * 255


def _depth(depth_m: Tensor) -> Tensor:
    depth = depth_m[:, None] if depth_m.ndim == 3 else depth_m
    if depth.ndim != 4 or depth.shape[1] != 1:
        raise ArrayError(
            f"depth_m: expected (B, 1, H, W) or (B, H, W), found {tuple(depth_m.shape)}"
        )
    if not depth.is_floating_point():
        raise ArrayError(
            f"depth_m: expected floating-point metres, found {depth.dtype}; divide raw values by "
            "their units per metre first"
        )
    # Half precision keeps 3 mm at 5 m, and the differences of neighbours are less.
    depth = depth.to(torch.promote_types(depth.dtype, torch.float32))
    some = torch.isfinite(depth) & (depth >= LEAST_DEPTH_M)
    if not torch.compiler.is_compiling():
        _check_metres(depth.detach(), some)
    return torch.where(some, depth, torch.zeros_like(depth))


def _check_metres(depth: Tensor, some: Tensor) -> None:
    negative = (depth < 0) & torch.isfinite(depth)
    counts = torch.stack([some.sum(), (some & (depth < _NEAR_M)).sum(), (depth > _FAR_M).sum()])
    known, near, far = counts.tolist()
    if 2 * near > known or 2 * (far - int((depth == torch.inf).sum())) > known:
        median = float(depth[some].median())
        raise ArrayError(
            f"depth_m: expected metres, whose median lies from {_NEAR_M} to {_FAR_M:g}, found "
            f"{median:g}; divide raw values by their units per metre first"
        )
    if negative.any():
        raise ArrayError(
            f"depth_m: expected metres >= 0, found {int(negative.sum())} negative; where there is "
            "none, put 0 or NaN"
        )


def _intrinsics(intrinsics: Tensor, depth: Tensor | None) -> Tensor:
    count = intrinsics.shape[0] if depth is None else len(depth)
    matrix = intrinsics.expand(count, 3, 3) if intrinsics.shape == (3, 3) else intrinsics
    if matrix.shape != (count, 3, 3) or not matrix.is_floating_point():
        raise ArrayError(
            f"intrinsics: expected floating (B, 3, 3) or (3, 3), B as the depth's, found "
            f"{matrix.dtype} {tuple(intrinsics.shape)}"
        )
    if not torch.compiler.is_compiling():
        k = matrix.detach().to(torch.float64)
        row = torch.tensor((0.0, 0.0, 1.0), dtype=k.dtype, device=k.device)
        if not ((k[:, 2] == row).all() and (k[:, [0, 1], [0, 1]] > 0).all()):
            raise ArrayError(
                f"intrinsics: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {k[0].tolist()}"
            )
    return matrix
