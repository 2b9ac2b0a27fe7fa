"""One time step of a dataset: every modality as arrays, one camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera

MODALITIES: tuple[str, ...] = (
    "rgb",
    "depth",
    "normal",
    "hha",
    "disparity",
    "transformed_disparity",
    "elevation",
    "label",
)
"""Every image a frame can hold, in the order in which they are listed everywhere."""

ON_REQUEST: tuple[str, ...] = ("disparity", "transformed_disparity", "elevation")
"""Modalities that a store has only where they were asked for by name."""


@dataclass(frozen=True)
class Plane:
    """Say how an image of one number per pixel is kept as integers: number = stored / steps.

    Attributes
    ----------
    dtype : {"uint16", "int16"}
        Unsigned: 0 = none, in memory too. Signed: `none` = none, in memory NaN, as 0 is a number.
    steps : int
        Of a pixel or of a metre.
    units : {"pixel", "m"}
    """

    dtype: str
    steps: int
    units: str

    @property
    def none(self) -> int:
        """What is stored where there is no number."""
        return 0 if self.dtype == "uint16" else -32768


PLANES: dict[str, Plane] = {
    "depth": Plane("uint16", 1000, "m"),
    # KITTI's own: up to 255.996 pixels, to 0.002. What is nearer is stored as that.
    "disparity": Plane("uint16", 256, "pixel"),
    # As far to either side of the road, to 0.004 pixels: far below what a matcher resolves.
    "transformed_disparity": Plane("int16", 128, "pixel"),
    "elevation": Plane("int16", 1000, "m"),
}
"""The modalities of one number per pixel.

Numbers beyond an integer's range become its ends, so that all of them are there where depth is;
only depth itself is none where it is too far.
"""


VIRTUAL_BASELINE_M = 0.055
"""Baseline where a dataset has none: that of the RealSense D415, which took GMRP (datasheet).

So GMRP's disparities are those the camera itself matched, at the colour image's focal length, and
a store's uint16 holds them for depth from 0.2 m on (see `PLANES`).
"""


def modality_name(name: str) -> str:
    """Return a modality's name as arrays have it, from a spelling with hyphens as well."""
    return name.strip().replace("-", "_")


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
    disparity : (H, W) float32, pixels, optional
        fx * baseline / depth; 0 = none.
    transformed_disparity : (H, W) float32, pixels, optional
        Disparity less the road's own: 0 on the road; NaN = none.
    elevation : (H, W) float32, metres, optional
        Height over the road's plane; NaN = none.
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
    disparity: npt.NDArray[np.float32] | None = None
    transformed_disparity: npt.NDArray[np.float32] | None = None
    elevation: npt.NDArray[np.float32] | None = None
    label: npt.NDArray[np.uint8] | None = None
    group: str = ""
    baseline_m: float = float("nan")
    cam_to_road: npt.NDArray[np.float64] | None = None
