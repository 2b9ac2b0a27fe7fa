"""The benchmark's bird's-eye view, one pixel at a time."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt


def bev(
    image: npt.NDArray[np.uint8], road_to_image: npt.NDArray[np.float64]
) -> npt.NDArray[np.uint8]:
    height, width = image.shape[:2]
    view = np.zeros((800, 400, *image.shape[2:]), image.dtype)
    for row in range(800):
        for column in range(400):
            x = float(np.float32(-10 + 0.05 * (column + 0.5)))
            z = float(np.float32(46 - 0.05 * (row + 0.5)))
            a, b, w = (h[0] * x + h[1] * z + h[2] for h in road_to_image.tolist())
            if w <= 0:
                continue
            u, v = a / w, b / w
            if 1 <= u <= width and 1 <= v <= height:
                view[row, column] = image[math.floor(v) - 1, math.floor(u) - 1]
    return view
