"""One time step of a dataset: every modality as arrays, one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera

MODALITIES: tuple[str, ...] = ("rgb", "depth", "normal", "hha", "label")
"""Every image a frame can hold, in the order in which they are listed everywhere."""

IGNORE_LABEL = 255
"""Label of pixels that take part in no statistic: padding, or outside an evaluated area."""

MAX_PIXELS = 1 << 26
"""Images of more pixels are refused before anything is allocated for them (67 megapixels)."""


@dataclass(frozen=True)
class LabelClass:
    """Name one value of the label image and the colour it is drawn in, (R, G, B) of 0-255."""

    id: int
    name: str
    color: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Frame:
    """Hold one time step.

    Attributes
    ----------
    id : str
        Unique within its dataset.
    camera : Camera
        The camera of every image here.
    rgb : (H, W, 3) uint8, optional
        Colour, channels R, G, B.
    depth_m : (H, W) float32, metres, optional
        0 = no depth.
    normal : (H, W, 3) float32, optional
        Unit vectors in the camera frame, pointing at the camera; (0, 0, 0) = none.
    hha : (H, W, 3) uint8, optional
        Horizontal disparity, height above ground, angle with gravity.
    label : (H, W) uint8, optional
        Class ids; 255 = ignore.
    group : str
        The scene the frame belongs to; "" = none known.
    baseline_m : float
        Stereo baseline, metres; NaN = none.
    cam_to_road : (3, 4) float64, optional
        Transform from the camera frame to the road frame, metres.
    """

    id: str
    camera: Camera
    rgb: npt.NDArray[np.uint8] | None = None
    depth_m: npt.NDArray[np.float32] | None = None
    normal: npt.NDArray[np.float32] | None = None
    hha: npt.NDArray[np.uint8] | None = None
    label: npt.NDArray[np.uint8] | None = None
    group: str = ""
    baseline_m: float = float("nan")
    cam_to_road: npt.NDArray[np.float64] | None = None
