"""Transforms of other libraries on samples: every plane moves with one draw, the camera too.

Their colour changes belong on rgb alone, their moves on every plane, by the nearest pixel but for
rgb. What they did is then read off two more planes that moved along, the pixels' own coordinates,
and a third that tells pixels of the frame from those that were filled in.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, Modality
from nimprep.torch.transforms.geometry import Sample, frame_size, records

_COLORS = {name for name, modality in MODALITIES.items() if modality.values == "colors"}

_INSIDE = 173
"""What marks the frame's own pixels: no number that anybody fills in with."""

_PLACES = ("u", "v", "inside")

Planes = dict[str, Tensor]
"""By name (C, H, W), as a library moves them: rgb uint8, label uint8, the others as a sample."""

_lock = threading.Lock()
"""Other libraries draw from one generator of the process: one sample at a time."""


def _renew_lock() -> None:
    global _lock
    _lock = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


@dataclass(frozen=True)
class Torchvision:
    """Apply a transform of `torchvision.transforms.v2` to a whole sample.

    A `StoreDataset` and a `Compose` make this of such a transform by themselves. rgb is handed over
    as an `Image`, every other plane as a `Mask`, so colours change rgb alone and moves take the
    nearest pixel elsewhere. What is filled in is 255 in label and none in the others. Crops, flips,
    padding and resizing give the camera that belongs to the result, to half a pixel where
    it was resized, and turn normals over; turning and warping are refused where a sample has
    more than rgb, label and depth, and warping where it has depth.

    Parameters
    ----------
    transform : callable
        Draws from torch's generator, which is seeded for the sample and then as it was before.
    """

    transform: Callable[[Any], Any]

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample, moved.

        Raises
        ------
        ArrayError
            The transform did what cannot be done to all that the sample has.
        """
        from torchvision.tv_tensors import Image, Mask

        planes = _planes(sample)
        given = {n: Image(p) if n in _COLORS else Mask(p) for n, p in planes.items()}
        with _lock, torch.random.fork_rng(devices=[]):
            torch.manual_seed(_seed(sample))
            moved = self.transform(given)
        names = _names(self.transform)
        if others := [p for p in moved.values() if not isinstance(p, Tensor)]:
            raise ArrayError(f"{names}: expected tensors back, found {type(others[0])}")
        return _sample(sample, {n: p.as_subclass(Tensor) for n, p in moved.items()}, names)


@dataclass(frozen=True)
class Albumentations:
    """Apply a transform of albumentations 2 to a whole sample, with one draw.

    As `Torchvision` does: rgb is its image, every other plane a mask.

    Parameters
    ----------
    transform : callable
        Its own generator is seeded for every sample.
    """

    transform: Callable[..., dict[str, Any]]

    def __call__(self, sample: Sample) -> Sample:
        """Return the sample, moved.

        Raises
        ------
        ArrayError
            The transform did what cannot be done to all that the sample has, or cannot be seeded,
            as in albumentations before 2.
        """
        seeded = getattr(self.transform, "set_random_seed", None)
        names = _names(self.transform)
        if seeded is None:
            raise ArrayError(f"{names}: expected albumentations 2 or newer, found an older one")
        planes = _planes(sample)
        rgb = planes.pop("rgb", torch.zeros(3, *planes["inside"].shape[1:], dtype=torch.uint8))
        # It stacks masks, so all are of one type, which holds every byte, and one channel.
        masks = [c.float().numpy() for plane in planes.values() for c in plane]
        with _lock:
            seeded(_seed(sample) % 2**32)
            moved = self.transform(image=np.ascontiguousarray(rgb.permute(1, 2, 0)), masks=masks)
        parts = iter(torch.stack([torch.as_tensor(mask) for mask in moved["masks"]]))
        found = {
            name: torch.stack([next(parts) for _ in plane]).to(plane.dtype)
            for name, plane in planes.items()
        }
        if "rgb" in sample:
            found["rgb"] = _channels_first(moved["image"])
        return _sample(sample, found, names)


def _names(transform: Any) -> str:
    children = getattr(transform, "transforms", None)
    if isinstance(children, (list, tuple, torch.nn.ModuleList)) and len(children):
        return ", ".join(_names(child) for child in children)
    return type(transform).__name__


def _seed(sample: Sample) -> int:
    return int(torch.randint(2**63 - 1, (), generator=sample.get("generator")))


def _channels_first(image: Any) -> Tensor:
    """Return (3, H, W) of what a pipeline gave: an array, or a tensor where it ends in one."""
    if isinstance(image, Tensor):
        return image
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))


def _planes(sample: Sample) -> Planes:
    """Return a sample's planes without padding, and those that tell what happened to them."""
    height, width = frame_size(sample)
    planes = {}
    for name in records(sample):
        plane = sample[name][..., :height, :width].contiguous()
        planes[name] = plane.to(torch.uint8)[None] if plane.ndim == 2 else plane
    rows = torch.arange(height, dtype=torch.float32)[:, None]
    columns = torch.arange(width, dtype=torch.float32)
    planes["u"] = columns.expand(1, height, width).contiguous()
    planes["v"] = rows.expand(1, height, width).contiguous()
    planes["inside"] = torch.full((1, height, width), _INSIDE, dtype=torch.uint8)
    return planes


def _sample(before: Sample, planes: Planes, names: str) -> Sample:
    """Return the sample that the moved planes make."""
    if missing := [n for n in (*_PLACES, *_images(before)) if n not in planes]:
        raise ArrayError(f"{names}: expected all of a sample's planes back, found no {missing[0]}")
    sizes = {tuple(plane.shape[-2:]) for plane in planes.values()}
    if len(sizes) > 1:
        raise ArrayError(f"{names}: expected planes of one size back, found {sorted(sizes)}")
    inside = planes["inside"][0] == _INSIDE
    _check_values(before, planes, inside, names)
    move = _move(planes["u"][0].double(), planes["v"][0].double(), inside)
    _check(move, before, names)
    after: Sample = {**before, "size": sizes.pop()}
    for name, modality in records(before).items():
        after[name] = _moved(modality, planes[name], inside, move)
    if "intrinsics" in before:
        k: Tensor = before["intrinsics"]
        if move.kind == "warp":
            after["intrinsics"] = torch.full_like(k, torch.nan)
        else:
            # Of a mirrored world, so that focal lengths stay positive; see `flip`.
            mirror = torch.diag(move.signs())
            after["intrinsics"] = (torch.linalg.inv(move.matrix) @ k.double() @ mirror).to(k.dtype)
    if "gravity" in before:
        g: Tensor = before["gravity"]
        # As K: of the same camera frame, or of that of a mirrored world.
        after["gravity"] = (
            torch.full_like(g, torch.nan) if move.kind == "warp" else (g * move.signs().to(g.dtype))
        )
    return _padded(before, after)


def _images(sample: Sample) -> list[str]:
    return list(records(sample))


def _check_values(sample: Sample, planes: Planes, inside: Tensor, names: str) -> None:
    """Raise where numbers were not moved but mixed, or cut off behind the point."""
    came = torch.stack([planes[name][0][inside] for name in ("u", "v")])
    if not torch.equal(came, came.round()):
        raise ArrayError(
            f"{names}: expected the nearest pixel of every plane but rgb, found a mixture; its "
            "mask_interpolation is to be cv2.INTER_NEAREST"
        )
    for name in _images(sample):
        found = planes[name].dtype
        if sample[name].is_floating_point() and not found.is_floating_point:
            raise ArrayError(
                f"{names}: expected {name} to stay {sample[name].dtype}, found {found}; change the "
                "dtype of Image alone"
            )


@dataclass(frozen=True)
class _Move:
    """Say where pixels came from: (u, v, 1) before = `matrix` (u, v, 1) after."""

    matrix: Tensor
    kind: str

    def signs(self) -> Tensor:
        """Return which axes it turned over, (3,): x, y, z."""
        turned = self.matrix.diag().sign()
        return turned if self.kind == "straight" else torch.ones_like(turned)


def _move(u: Tensor, v: Tensor, inside: Tensor) -> _Move:
    """Return what moved the pixels, told by the coordinates that they brought along."""
    matrix = torch.eye(3, dtype=torch.float64)
    rows, columns = torch.nonzero(inside, as_tuple=True)
    if len(rows) == 0:
        return _Move(matrix, "straight")
    across, down = _line(u, inside), _line(v.T, inside.T)
    if across is not None and down is not None:
        matrix[0, 0], matrix[0, 2] = across
        matrix[1, 1], matrix[1, 2] = down
        return _Move(matrix, "straight")
    ones = torch.ones(len(rows), dtype=torch.float64)
    places = torch.stack([columns.double(), rows.double(), ones], dim=1)
    came = torch.stack([u[inside], v[inside]], dim=1)
    matrix[:2] = torch.linalg.lstsq(places, came, driver="gelsd").solution.T
    # The nearest pixel is half of one away; a quarter more for what a library computes in short.
    fits = (((places @ matrix.T)[:, :2] - came).abs() <= 0.75).all()
    return _Move(matrix, "turn" if fits else "warp")


def _line(came: Tensor, inside: Tensor) -> tuple[float, float] | None:
    """Return slope and offset of where columns came from; None = not as one, or not evenly."""
    there = inside.any(dim=0)
    lowest = torch.where(inside, came, torch.inf).amin(dim=0)[there].numpy()
    highest = torch.where(inside, came, -torch.inf).amax(dim=0)[there].numpy()
    at = torch.nonzero(there)[:, 0].double().numpy()
    if not np.array_equal(lowest, highest) or len(at) != at[-1] - at[0] + 1:
        return None
    if len(at) == 1:
        return 1.0, float(lowest[0] - at[0])
    slope, offset = (float(x) for x in np.polyfit(at, lowest, 1))
    if slope == 0 or (np.abs(slope * at + offset - lowest) > 0.6 + 0.6 * abs(slope)).any():
        return None
    return _whole(at, lowest, slope) or (slope, offset)


def _whole(at: Any, came: Any, slope: float) -> tuple[float, float] | None:
    """Return slope and offset of a window of whole pixels that was scaled, or None: of no such.

    Crops, flips and padding are of this kind, with the window as large as it became.
    """
    count, first = len(at), at[0]
    if slope < 0:
        mirrored = _whole(at, came[::-1], -slope)
        return mirrored and (-mirrored[0], mirrored[1] + mirrored[0] * (2 * first + count - 1))
    for width in sorted(range(1, 2 * count + round(count * slope)), key=_distance(count * slope)):
        if abs(width - count * slope) > 2 + slope:
            return None
        for start in range(max(int(came[0]) - round(slope) - 1, 0), int(came[0]) + 1):
            for part in (0.0, 0.5):
                if np.array_equal(start + np.floor((at - first + part) * width / count), came):
                    scale = width / count
                    return scale, start + (scale - 1) / 2 - scale * first
    return None


def _distance(place: float) -> Callable[[int], float]:
    return lambda number: abs(number - place)


def _check(move: _Move, sample: Sample, names: str) -> None:
    """Raise where what was done to the pixels cannot be done to all that a sample has."""
    if move.kind == "straight":
        return
    most = {"rgb", "label", "depth"} if move.kind == "turn" else {"rgb", "label"}
    # Numbers of a plane have no direction and no place: they stay what they are.
    most |= sample.get("planes", {}).keys()
    if others := [name for name in _images(sample) if name not in most]:
        raise ArrayError(
            f"{names}: expected crops, flips and resizing of a sample with {', '.join(others)}, "
            f"found a {move.kind}, which its values do not follow; leave it out, or take only "
            f"{', '.join(sorted(most))}"
        )


def _moved(modality: Modality, plane: Tensor, inside: Tensor, move: _Move) -> Tensor:
    if modality.name in _COLORS:
        return plane
    if modality.values == "classes":
        plane = plane[0].to(torch.int64)
    plane = torch.where(inside, plane, torch.tensor(modality.absent, dtype=plane.dtype))
    if modality.resize == "nearest by width":
        plane = plane / move.matrix[0, 0].abs().to(plane.dtype)
    if modality.flip == "mirror and negate x":
        # Added to 0, so that none stays 0 and does not become -0.
        plane = 0 + plane * move.signs().to(plane.dtype)[:, None, None]
    return plane


def _padded(before: Sample, after: Sample) -> Sample:
    """Pad frames of a store of several sizes as before, where they kept their own."""
    name = _images(before)[0]
    full, size = tuple(before[name].shape[-2:]), after["size"]
    if size == full or size != frame_size(before):
        return after
    padding = (0, full[1] - size[1], 0, full[0] - size[0])
    for name, modality in records(before).items():
        after[name] = torch.nn.functional.pad(after[name], padding, value=modality.absent)
    return after
