"""Normals by NIM as a layer of a network: the kernel's equations in differentiable tensors."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from nimprep.arrays import LEAST_DEPTH_M
from nimprep.errors import ArrayError

METHODS = ("nim",)
"""What `NIM` takes as `method`."""

# Lengths that count as 0, and as overflown, in units of the pixel's own depth: the square roots of
# the kernel's limits, where it says why.
_FAINT = 1e-15
_HUGE = 1e19

# By how many times a neighbour's depth may differ and still be told from more: products of three
# such ratios, which the gradients go through, stay in float32.
_APART = 1e12


class NIM(nn.Module):
    """Estimate surface normals from a batch of depth images.

    The same values as `nimprep.estimate_normals` up to rounding, as tensor operations: runs on any
    device, with no parameters and no branch on the data, so `torch.compile` and `torch.export`
    take it whole. Gradients flow to the depth and to the intrinsics and are finite everywhere;
    they are 0 where a pixel has no normal and through one that is (0, 0, -1) for want of a
    difference in depth.

    Parameters
    ----------
    method : str
        "nim", the paper's.
    sign_filter : bool
        Sum only the neighbours whose n_z has the majority's sign, before orientation.

    Raises
    ------
    ArrayError
        There is no such method.

    References
    ----------
    Wang et al., "Applying surface normal information in drivable area and road anomaly detection
    for ground mobile robots", IROS 2020.
    """

    def __init__(self, method: str = "nim", sign_filter: bool = False) -> None:
        super().__init__()
        if method not in METHODS:
            known = ", ".join(repr(name) for name in METHODS)
            raise ArrayError(f"method: expected one of {known}, found {method!r}")
        self.method = method
        self.sign_filter = bool(sign_filter)

    def forward(self, depth_m: Tensor, intrinsics: Tensor) -> Tensor:
        """Return the normals of a batch.

        Parameters
        ----------
        depth_m : (B, 1, H, W) floating, metres
            What is not finite, or below 0.1 mm, is no depth; so are negative numbers, which
            `nimprep.estimate_normals` refuses: a layer does not branch on data. Computed in float32
            whatever autocast says; in float64 if it is float64.
        intrinsics : (B, 3, 3) floating
            K, pixels; pixel (0, 0) is the centre of the top-left one. Only fx, fy, cx, cy are
            read.

        Returns
        -------
        (B, 3, H, W) float32, or float64 where the depth is
            Unit vectors (n_x, n_y, n_z) in the camera frame (x right, y down, z forward),
            pointing at the camera: n·P <= 0. (0, 0, 0) exactly where there is no depth, or none at
            any of the four neighbours.

        Raises
        ------
        ArrayError
            The shapes are others.
        """
        if depth_m.ndim != 4 or depth_m.shape[1] != 1:
            raise ArrayError(f"depth_m: expected (B, 1, H, W), found {tuple(depth_m.shape)}")
        if intrinsics.shape != (depth_m.shape[0], 3, 3):
            raise ArrayError(
                f"intrinsics: expected ({depth_m.shape[0]}, 3, 3) as the depth's batch, "
                f"found {tuple(intrinsics.shape)}"
            )
        dtype = torch.float64 if depth_m.dtype == torch.float64 else torch.float32
        return _normals(depth_m.to(dtype), intrinsics, self.sign_filter)

    def extra_repr(self) -> str:
        """Return the options, for `print(model)`."""
        return f"method={self.method!r}, sign_filter={self.sign_filter}"


def _normals(depth: Tensor, intrinsics: Tensor, sign_filter: bool) -> Tensor:
    """Return (B, 3, H, W) normals; the notes on the equations are the kernel's.

    Every result that a condition may reject is computed from harmless numbers there: a gradient of
    infinity times the condition's 0 would be NaN.
    """
    x, y, fx, fy = _rays(depth, intrinsics)
    # As the kernel has it in float32, so that float64 finds depth at the same pixels.
    single = depth.detach().float()
    present = (single >= LEAST_DEPTH_M) & torch.isfinite(single)
    z, (left, right, up, down), (has_left, has_right, has_up, has_down) = _neighbours(
        depth, present
    )
    # The result does not depend on the depths' unit, so the scale needs no gradient. Differences
    # are taken before scaling: two close depths subtract exactly.
    unit = 1 / z.detach().clamp(min=torch.finfo(z.dtype).tiny)
    g_u = _difference(left, right, has_left & has_right, unit) * (up * unit) * (down * unit)
    g_v = _difference(up, down, has_up & has_down, unit) * (left * unit) * (right * unit)
    c, s, sloped = _direction(g_u, g_v * (fy / fx))
    w = c * x + s * y
    # The candidates, left, right, up, down, along dimension 1.
    e = torch.cat([c / fx * left, -c / fx * right, s / fy * up, -s / fy * down], dim=1) * unit
    dz = (torch.cat([left, right, up, down], dim=1) - z) * unit
    s_sum, e_sum = _sum_candidates(dz, e, e - w * dz, sign_filter)
    radial, n_z, summed = _direction(s_sum, e_sum - w * s_sum)
    towards_camera = torch.where(e_sum.detach() > 0, -1.0, 1.0)
    normal = torch.cat([c * radial, s * radial, n_z], dim=1) * towards_camera
    facing = torch.zeros_like(normal)
    facing[:, 2] = -1
    normal = torch.where(sloped & summed, normal, facing)
    measured = present & (has_left | has_right | has_up | has_down)
    return torch.where(measured, normal, torch.zeros_like(normal))


def _rays(depth: Tensor, intrinsics: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return x (B, 1, 1, W), y (B, 1, H, 1), fx and fy (B, 1, 1, 1) in the depth's dtype."""
    height, width = depth.shape[2:]
    # Pixel numbers and cx are not exact in half precision.
    k = intrinsics.to(torch.promote_types(intrinsics.dtype, torch.float32))
    k = k[:, None, :, :, None].to(depth.device)
    fx, cx, fy, cy = k[:, :, 0, 0:1], k[:, :, 0, 2:3], k[:, :, 1, 1:2], k[:, :, 1, 2:3]
    u = torch.arange(width, device=depth.device, dtype=k.dtype)
    v = torch.arange(height, device=depth.device, dtype=k.dtype)[:, None]
    rays = ((u - cx) / fx, (v - cy) / fy, fx, fy)
    x, y, fx, fy = (part.to(depth.dtype) for part in rays)
    return x, y, fx, fy


def _neighbours(
    depth: Tensor, present: Tensor
) -> tuple[Tensor, tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Return the depth, 1 where there is none, its four neighbours and whether they are there.

    A missing neighbour takes the pixel's own depth: no candidate, a one-sided difference. One that
    is beyond all measure nearer or farther counts as `_APART` times so.
    """
    z = torch.where(present, depth, torch.ones_like(depth))
    around, seen = pad(z, (1, 1, 1, 1)), pad(present, (1, 1, 1, 1))
    height, width = depth.shape[2:]
    corners = ((1, 0), (1, 2), (0, 1), (2, 1))
    has = tuple(seen[..., v : v + height, u : u + width] for v, u in corners)
    beside = (around[..., v : v + height, u : u + width] for v, u in corners)
    least, most = z.detach() / _APART, z.detach() * _APART
    near = (torch.where(h, d, z).clamp(least, most) for h, d in zip(has, beside, strict=True))
    return z, tuple(near), has


def _difference(before: Tensor, after: Tensor, both: Tensor, unit: Tensor) -> Tensor:
    """Return the central difference, or the one-sided one doubled."""
    difference = (before - after) * unit
    return torch.where(both, difference, 2 * difference)


def _direction(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return (a, b) as a unit vector, and whether it has a direction; (1, 1) / sqrt(2) if not."""
    # Divided by the larger first, so that neither squares nor their gradients leave the range.
    larger = torch.maximum(a.detach().abs(), b.detach().abs())
    known = (larger > _FAINT) & (larger < _HUGE)
    one = torch.ones_like(larger)
    scale = torch.where(known, larger, one)
    a, b = torch.where(known, a, one) / scale, torch.where(known, b, one) / scale
    length = torch.sqrt(a * a + b * b)
    return a / length, b / length, known


def _sum_candidates(
    dz: Tensor, e: Tensor, dz_n_z: Tensor, sign_filter: bool
) -> tuple[Tensor, Tensor]:
    """Return S and E, (B, 1, H, W), of four candidates along dimension 1; dz = 0 adds nothing."""
    counts = dz != 0
    squared = torch.where(counts, dz * dz + dz_n_z * dz_n_z, torch.ones_like(dz))
    per_length = counts / torch.sqrt(squared)
    sign = torch.sign(dz.detach())
    s, e = sign * dz * per_length, sign * e * per_length
    if sign_filter:
        side = sign * torch.sign(dz_n_z.detach())
        votes = side.sum(dim=1, keepdim=True)
        majority = torch.where(votes >= 0, 1.0, -1.0)
        kept = (side == majority) | (side == 0).all(dim=1, keepdim=True)
        s, e = s * kept, e * kept
    return s.sum(dim=1, keepdim=True), e.sum(dim=1, keepdim=True)
