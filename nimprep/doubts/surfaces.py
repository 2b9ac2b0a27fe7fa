"""Signs in what is made of depth: noise in normals, and channels that say one thing everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.doubts.depth import LEAST_FOCAL_PX
from nimprep.modality import MODALITIES, Modality

NOISY_DEG = 13.0
"""Expected turn of a normal: 20 to 45 on stereo frames of GMRP and KITTI, 0 to 8.8 on completed
LiDAR, 1 on rendered streets without noise."""

ROUGH_DEG = 6.0
"""Of the road's normals: 11 to 21 on those stereo frames, 2 to 3.5 on rendered streets."""

Noise = dict[str, float]

_SIGNS = {
    "relative": "noise_relative",
    "expected_deg": "noise_expected_deg",
    "roughness_deg": "noise_roughness_deg",
}
"""What a store says of noise, by the names of the signs that it is the median of."""

_LEVEL_GROUND = {
    "height above ground": ((0, 2), (18, 22)),
    "angle with gravity": ((36, 40), (218, 218)),
}
"""What most of a road has where nothing is wrong: by the lowest point or the floor, and level. An
angle of 180 degrees is that of no plane, as where depth is sparse, which is said by itself."""

_SAMPLED = 50_000
_LEAST_PIXELS = 100
LEAST_IMAGE = 1 << 14
"""Pixels; of smaller images nothing is said, which have few windows of the size that noise is told
in, and are of one thing more often."""


def normal_signs(
    depth_m: npt.NDArray[np.float32], camera: Camera, *, smoothed: bool
) -> dict[str, float]:
    """Measure the noise in the normals of an image.

    Parameters
    ----------
    depth_m : (H, W) float32, metres
        What normals are made of; 0 = none.
    smoothed : bool
        Whether they are made by a method that smooths noise.

    Returns
    -------
    dict
        ``noise_relative``, ``noise_expected_deg`` and, where there is a road,
        ``noise_roughness_deg``: see `nimprep.derive.normal_noise`; ``noisy_normals_deg``: the last
        where noise is expected in normals that are not smoothed, 0 where none is. Nothing of a
        small image.
    """
    if depth_m.size < LEAST_IMAGE or min(camera.fx, camera.fy) < LEAST_FOCAL_PX:
        return {}
    # Here, as its kernels take their time to load.
    from nimprep.derive.normal_noise import normal_noise

    noise = normal_noise(depth_m, camera)
    signs = {sign: getattr(noise, name) for name, sign in _SIGNS.items()}
    if not smoothed:
        signs["noisy_normals_deg"] = (
            noise.roughness_deg if noise.expected_deg >= NOISY_DEG else 0.0 * noise.roughness_deg
        )
    return {name: value for name, value in signs.items() if math.isfinite(value)}


def noise_of(frames: list[Mapping[str, float]]) -> Noise | None:
    """Return what a store says of noise, from the signs of its frames; None = nothing is known.

    Returns
    -------
    dict, optional
        ``frames``: so many were measured; medians over them of ``relative``, ``expected_deg`` and,
        where a road is in view, ``roughness_deg``.
    """
    measured = [signs for signs in frames if _SIGNS["relative"] in signs]
    if not measured:
        return None
    found: Noise = {"frames": len(measured)}
    for name, sign in _SIGNS.items():
        values = [signs[sign] for signs in measured if sign in signs]
        if values:
            found[name] = float(f"{np.median(values):.4g}")
    return found


def joined_noise(found: list[Mapping[str, float] | None]) -> Noise | None:
    """Return what is said of noise in stores that are joined: means, by the frames measured."""
    parts = [part for part in found if part]
    if len(parts) < 2:
        return dict(parts[0]) if parts else None
    joined: Noise = {"frames": sum(int(part["frames"]) for part in parts)}
    for name in _SIGNS:
        some = [part for part in parts if name in part]
        if some:
            mean = np.average([p[name] for p in some], weights=[p["frames"] for p in some])
            joined[name] = float(f"{mean:.4g}")
    return joined


def one_value_sign(modality: Modality, channel: int | None = None) -> str:
    """Return the name of the sign that a modality, or a channel of it, has one value."""
    return f"{modality.name}_at_one" + ("" if channel is None else f"_{channel}")


def level_signs(images: Mapping[str, npt.NDArray[np.uint8]]) -> dict[str, float]:
    """Measure which share of a frame's pixels has one and the same value, per channel.

    Parameters
    ----------
    images : mapping of modality to (H, W, 3) uint8
        As stored; those of "levels" count, where not all three are 0. What a level road has counts
        as none: height and angle of it are one value where nothing is wrong.
    """
    signs = {}
    for name, image in images.items():
        modality = MODALITIES.get(name)
        height, width = image.shape[:2]
        if modality is None or modality.values != "levels" or height * width < LEAST_IMAGE:
            continue
        step = max(1, math.isqrt(height * width // _SAMPLED))
        part = image[step // 2 :: step, step // 2 :: step]
        some = part[part.any(axis=2)]
        if len(some) < _LEAST_PIXELS:
            continue
        for c, channel in enumerate(modality.channels):
            count = np.bincount(some[:, c], minlength=256)
            most = int(count.argmax())
            level = any(a <= most <= b for a, b in _LEVEL_GROUND.get(channel, ()))
            signs[one_value_sign(modality, c)] = 0.0 if level else float(count[most] / len(some))
    return signs


def cut_sign(modality: Modality) -> str:
    """Return the name of the sign that numbers of a modality lie beyond its integers."""
    return f"{modality.name}_cut"


def can_be_cut(modality: Modality) -> bool:
    """Return whether numbers beyond a modality's integers are stored as the nearest of them."""
    numbers = modality.values == "numbers" and modality.derived is not None
    return numbers and modality.beyond == "nearest"


def cut_signs(
    made: Mapping[str, npt.NDArray[Any]], stored: Mapping[str, npt.NDArray[Any]]
) -> dict[str, float]:
    """Measure which share of a frame's derived numbers is stored as the nearest that can be.

    Parameters
    ----------
    made : mapping of modality to (H, W) float32
        As derived.
    stored : mapping of modality to (H, W) integers
        The same as the store holds them.

    Returns
    -------
    dict
        Of those alone of which some is cut. What is rounded up to the least integer counts as kept.
    """
    signs = {}
    for name, numbers in made.items():
        modality = MODALITIES[name]
        if not can_be_cut(modality):
            continue
        integers = stored[name]
        most = np.iinfo(modality.dtype).max
        at_end = integers == most
        if modality.fill:
            at_end |= integers == -most
        # Nearly all images end here, where none is as high as that.
        beyond = np.abs(numbers[at_end]) * modality.steps >= most + 0.5
        if beyond.any():
            known = np.count_nonzero(integers != modality.fill)
            signs[cut_sign(modality)] = float(np.count_nonzero(beyond) / known)
    return signs


def depth_counts_sign(counts: npt.NDArray[np.int64]) -> dict[str, float]:
    """Measure which share of a frame's depth is one value, of how many pixels have each stored.

    Parameters
    ----------
    counts : (N,) int64
        Of every stored integer; 0 = none.
    """
    known = int(counts[1:].sum())
    if known < LEAST_IMAGE:
        return {}
    return {one_value_sign(MODALITIES["depth"]): float(counts[1:].max() / known)}
