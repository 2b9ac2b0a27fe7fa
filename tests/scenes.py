"""A road whose depth and labels are known, for fakes of public datasets."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

SIZE = (24, 36)
FX, FY, CX, CY = 30.0, 31.0, 17.5, 8.0


class Scene(NamedTuple):
    """Hold a made picture and what is true of it.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    depth_m : (H, W) float32, metres
        0 = none, in the sky.
    label : (H, W) uint8
        Ids of Cityscapes: 7 road, 11 building, 23 sky, 26 car.
    """

    rgb: npt.NDArray[np.uint8]
    depth_m: npt.NDArray[np.float32]
    label: npt.NDArray[np.uint8]


def scene(seed: int, size: tuple[int, int] = SIZE) -> Scene:
    """Return a plane 1.6 m below the camera to a wall at 25 m, with a car somewhere at 5 m."""
    rng = np.random.default_rng(seed)
    v, _ = np.mgrid[: size[0], : size[1]].astype(float)
    depth = np.where(v > CY, 1.6 * FY / np.maximum(v - CY, 1e-6), 25.0)
    depth = np.minimum(depth, 25.0)
    label = np.where(depth < 25, 7, 11).astype(np.uint8)
    left = int(rng.integers(2, size[1] - 8))
    depth[10:16, left : left + 6], label[10:16, left : left + 6] = 5.0, 26
    depth[:3], label[:3] = 0, 23
    # Smooth, so that a JPEG of it is what it was within a few levels.
    coarse = rng.integers(40, 200, (3, 4, 3)).astype(np.uint8)
    rgb = cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_LINEAR)
    return Scene(np.asarray(rgb), depth.astype(np.float32), label)


def disparity_of(depth_m: npt.NDArray[np.float32], fx_baseline: float) -> npt.NDArray[np.float64]:
    """Return disparity, pixels, 0 where there is no depth."""
    return np.where(depth_m > 0, fx_baseline / np.maximum(depth_m, 1e-3), 0)
