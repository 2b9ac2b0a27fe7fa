"""Which method of normals suits depth so noisy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.methods import FixedMethod
from nimprep.derive.noise import estimate_noise

MATTERS_DEG = 0.5
"""Noise that turns normals by less is as good as none: what nim gets wrong on clean scenes."""


@dataclass(frozen=True)
class MeasuredNoise:
    """Say how noisy a frame's depth is, as far as its normals ask.

    Attributes
    ----------
    relative : float
        Median standard deviation of depth by depth; 0 = no noise is found.
    turns_deg : float
        By how much so much more depth at the next pixel turns a normal that faces the camera.
    """

    relative: float
    turns_deg: float


def measure_noise(depth_m: npt.NDArray[np.float32], camera: Camera) -> MeasuredNoise:
    """Measure the noise of checked depth."""
    relative = estimate_noise(depth_m).relative
    turned = math.degrees(math.atan(relative * max(camera.fx, camera.fy)))
    return MeasuredNoise(relative, turned)


def method_for(measured: Sequence[MeasuredNoise]) -> FixedMethod:
    """Return the method for frames so noisy: by the half of them that is more so.

    `scripts/benchmark_real_normals.py` and `benchmark_normals.py` have the errors of both: where
    there is noise, nim's are 5 to 20 times nim-edge's; where none is, their medians are within a
    third of a degree, and nim is the paper's and takes less time.
    """
    noisy = sum(one.turns_deg >= MATTERS_DEG for one in measured)
    return "nim-edge" if 2 * noisy >= len(measured) > 0 else "nim"
