"""What crop, flip and resize do to every image of a sample and to its camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES, Modality

Sample = dict[str, Any]

IMAGES = tuple(MODALITIES)
"""The keys of any sample that are images; all of one size. Planes of a dataset come after them."""


def records(sample: Mapping[str, Any]) -> dict[str, Modality]:
    """Return what is known of each image in a sample, by its key; planes bring it along."""
    known = {**MODALITIES, **sample.get("planes", {})}
    return {name: modality for name, modality in known.items() if name in sample}


def frame_size(sample: Sample) -> tuple[int, int]:
    """Return (height, width) of the frame itself, without padding.

    Raises
    ------
    ArrayError
        The sample has no image, images of several sizes, or a size larger than they are.
    """
    shapes = {name: tuple(sample[name].shape[-2:]) for name in records(sample)}
    if len(set(shapes.values())) != 1:
        raise ArrayError(f"sample: expected images of one size, found {shapes or 'no image'}")
    padded = next(iter(shapes.values()))
    height, width = (int(n) for n in sample.get("size", padded))
    if not (0 < height <= padded[0] and 0 < width <= padded[1]):
        raise ArrayError(f"sample: expected a size within {padded}, found {(height, width)}")
    return height, width


def check_returned(sample: Any, frame_id: str, given: Collection[str]) -> None:
    """Check what somebody's transform made of a sample.

    Parameters
    ----------
    given : collection of str
        The sample's keys before.

    Raises
    ------
    ArrayError
        It is no dict, lacks one of the keys, has images of several sizes, one that is no tensor or
        of other channels, numbers that are none, or a label of other than whole numbers from 0 to
        255.
    """
    where = f"frame {frame_id!r}: expected"
    if not isinstance(sample, Mapping):
        raise ArrayError(f"{where} a dict from the transform, found {type(sample).__name__}")
    needed = [name for name in given if name != "generator"]
    if missing := [name for name in needed if name not in sample]:
        raise ArrayError(f"{where} {missing[0]} from the transform, found {', '.join(sample)}")
    known = records(sample)
    images = {name: sample[name] for name in known if name in needed}
    for name, image in images.items():
        shape: tuple[Any, ...] = (known[name].channel_count, "H", "W")
        if known[name].values == "classes":
            shape = shape[1:]
        if not isinstance(image, Tensor):
            raise ArrayError(f"{where} tensors from the transform, found {name} {type(image)}")
        if image.ndim != len(shape) or (len(shape) == 3 and len(image) != shape[0]):
            found = tuple(image.shape)
            raise ArrayError(f"{where} {name} {shape} from the transform, found {found}")
    sizes = {tuple(image.shape[-2:]) for image in images.values()}
    if len(sizes) > 1:
        raise ArrayError(f"{where} images of one size from the transform, found {sorted(sizes)}")
    for name, image in images.items():
        # A sum is NaN where one number is, and takes a pass less than a comparison.
        if image.is_floating_point() and not math.isfinite(float(image.sum())):
            _check_numbers(known[name], image, where)
    label = images.get("label")
    if label is not None and label.is_floating_point() and not torch.equal(label, label.round()):
        raise ArrayError(
            f"{where} whole numbers in label from the transform, found others; take the nearest "
            "pixel where it is resized or turned"
        )
    if label is not None and label.numel() and not 0 <= label.min() <= label.max() <= 255:
        raise ArrayError(
            f"{where} label from 0 to 255 from the transform, found {label.min()} to {label.max()}"
        )


def _check_numbers(modality: Modality, image: Tensor, where: str) -> None:
    """Raise where an image has infinities, or NaN that does not stand for none."""
    none_is_nan = math.isnan(modality.absent)
    if not (image.isinf() if none_is_nan else ~image.isfinite()).any():
        return
    none = "NaN" if none_is_nan else f"{modality.absent:g}"
    found = "infinity" if image.isinf().any() else "NaN"
    raise ArrayError(
        f"{where} finite {modality.name} from the transform, found {found}; {none} stands for none"
    )


def _with_images(sample: Sample, change: Callable[[Modality, Tensor], Tensor]) -> Sample:
    """Return a copy of the sample with every image changed, `size` not yet."""
    changed = {name: change(modality, sample[name]) for name, modality in records(sample).items()}
    return {**sample, **changed}


def _with_camera(sample: Sample, matrix: list[list[float]]) -> Sample:
    """Return the sample with K multiplied from the left by what happened to pixels, (3, 3)."""
    if "intrinsics" not in sample:
        return sample
    k: Tensor = sample["intrinsics"]
    return {**sample, "intrinsics": torch.tensor(matrix, dtype=k.dtype, device=k.device) @ k}


def crop(sample: Sample, top: int, left: int, height: int, width: int) -> Sample:
    """Cut out the window that starts at pixel (left, top) of the frame; the camera moves along.

    Where the window leaves the frame at the bottom or the right, the rest is padding: 0, 255 for
    labels, NaN for transformed disparity, elevation and planes that can be none, what a stored 0
    stands for in other planes. `size` becomes that of the part inside.

    Raises
    ------
    ArrayError
        The window's corner lies outside the frame, or it is empty.
    """
    frame_height, frame_width = frame_size(sample)
    if not (0 <= top < frame_height and 0 <= left < frame_width and height > 0 and width > 0):
        raise ArrayError(
            f"crop: expected a window that starts inside {frame_width}x{frame_height}, "
            f"found {width}x{height} at ({left}, {top})"
        )
    bottom, right = min(top + height, frame_height), min(left + width, frame_width)
    beyond = (0, left + width - right, 0, top + height - bottom)

    def cut(modality: Modality, image: Tensor) -> Tensor:
        inside = image[..., top:bottom, left:right]
        if not any(beyond):
            return inside
        return pad(inside, beyond, value=modality.absent)

    result = {**_with_images(sample, cut), "size": (bottom - top, right - left)}
    return _with_camera(result, [[1, 0, -left], [0, 1, -top], [0, 0, 1]])


def flip(sample: Sample) -> Sample:
    """Mirror the frame left to right: n_x changes sign and cx becomes W - 1 - cx.

    So does x of ``gravity``, where a sample has it; crops and other sizes leave it as it is.

    HHA, disparities and elevation have no direction across the image, so they are mirrored like a
    colour. Padding stays at the right, and W is the frame's own width.
    """
    _, width = frame_size(sample)

    def mirror(modality: Modality, image: Tensor) -> Tensor:
        mirrored = torch.cat([image[..., :width].flip(-1), image[..., width:]], dim=-1)
        if modality.flip == "mirror and negate x":
            # Taken from 0, so that none stays 0 and does not become -0.
            mirrored[0] = 0 - mirrored[0]
        return mirrored

    result = _with_images(sample, mirror)
    if "intrinsics" in sample:
        k = sample["intrinsics"].clone()
        k[0, 2] = width - 1 - k[0, 2]
        result["intrinsics"] = k
    if "gravity" in sample:
        result["gravity"] = sample["gravity"] * sample["gravity"].new_tensor([-1, 1, 1])
    return result


def resize(sample: Sample, height: int, width: int) -> Sample:
    """Scale the frame to (height, width), outer edges aligned; padding is dropped.

    Depth, disparities, elevation and label take the nearest pixel; disparities count pixels of the
    image's width and are scaled with it, as fx is. Colours and HHA are interpolated linearly, over
    the area where the image shrinks, normals likewise and then brought to unit length. HHA and
    normals are interpolated from the pixels that have them and are there where the nearest pixel
    has them, so a normal is exactly where depth is if it was before. K is scaled with its edges
    aligned; a different scale in x and y changes the camera, not the normals. Planes
    take the nearest pixel, or are interpolated from pixels that have a number, as records say.

    Notes
    -----
    A depth that stands up to half a pixel off its place is right for its label, and makes no
    surface that the image does not have; but its differences are uneven unless the size shrinks
    by a whole number. For normals, resize them, not the depth they come from.

    Raises
    ------
    ArrayError
        The size is not positive.
    """
    if height <= 0 or width <= 0:
        raise ArrayError(f"resize: expected a positive size, found {width}x{height}")
    old_height, old_width = frame_size(sample)
    rows, columns = _nearest(old_height, height), _nearest(old_width, width)

    def scale(modality: Modality, image: Tensor) -> Tensor:
        image = image[..., :old_height, :old_width]
        nearest = image[..., rows[:, None], columns]
        match modality.resize:
            case "linear" if image.dtype == torch.uint8:
                return _linear_bytes(image, height, width)
            case "linear":
                return _linear(image, height, width)
            case "linear where some" if modality.values == "measures":
                return _linear_numbers(image, nearest, height, width)
            case "linear where some":
                return _rounded(_linear_where_known(image.float(), nearest, height, width))
            case "unit vectors":
                return _unit_normals(_linear_where_known(image, nearest, height, width), nearest)
            case "nearest by width":
                return nearest * (width / old_width)
            case "nearest":
                return nearest

    result = {**_with_images(sample, scale), "size": (height, width)}
    sx, sy = width / old_width, height / old_height
    return _with_camera(result, [[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])


def _nearest(old: int, new: int) -> Tensor:
    """Return which of `old` pixels each of `new` has its centre in."""
    # In integers: floating point puts centres that fall on an edge to either side.
    return ((2 * torch.arange(new) + 1) * old) // (2 * new)


def _linear(image: Tensor, height: int, width: int) -> Tensor:
    """Interpolate (C, H, W) linearly; where it shrinks, over the area a pixel covers."""
    return interpolate(
        image[None], (height, width), mode="bilinear", align_corners=False, antialias=True
    )[0]


def _linear_bytes(image: Tensor, height: int, width: int) -> Tensor:
    """Interpolate (C, H, W) uint8: where PyTorch does so in bytes, it is several times as fast."""
    # PyTorch 2.13 computes nonsense in bytes where the result is one pixel wide.
    if width > 1:
        return _linear(image, height, width)
    return _rounded(_linear(image.float(), height, width))


def _rounded(image: Tensor) -> Tensor:
    return image.round().clamp(0, 255).to(torch.uint8)


def _linear_where_known(image: Tensor, nearest: Tensor, height: int, width: int) -> Tensor:
    """Interpolate (C, H, W) from pixels that are not all 0; 0 where the nearest pixel is."""
    known = (image != 0).any(dim=0, keepdim=True).to(image.dtype)
    both = _linear(torch.cat([image, known]), height, width)
    share = both[-1:]
    there = (nearest != 0).any(dim=0, keepdim=True)
    # The nearest pixel has a share of its own, so there is one wherever it is known.
    return torch.where(there, both[:-1] / torch.where(there, share, 1.0), 0.0)


def _linear_numbers(image: Tensor, nearest: Tensor, height: int, width: int) -> Tensor:
    """Interpolate (1, H, W) from pixels that are no NaN; NaN where the nearest pixel is."""
    known = ~image.isnan()
    mixed, share = _linear(torch.cat([image.nan_to_num(0), known.to(image)]), height, width)
    there = ~nearest[0].isnan()
    return torch.where(there, mixed / torch.where(there, share, 1.0), torch.nan)[None]


def _unit_normals(mixed: Tensor, nearest: Tensor) -> Tensor:
    """Bring (3, H, W) to unit length; where vectors cancelled, the nearest pixel's."""
    length = torch.linalg.vector_norm(mixed, dim=0, keepdim=True)
    cancelled = length < 1e-3
    return torch.where(cancelled, nearest, mixed / torch.where(cancelled, 1.0, length))
