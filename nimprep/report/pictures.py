"""What each modality looks like to a person: (H, W, 3) uint8 pictures, their scales and files."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep.errors import ArrayError
from nimprep.frame import IGNORE_LABEL, LabelClass
from nimprep.kitti.images import png_bytes
from nimprep.kitti.overlay import tint

Picture = npt.NDArray[np.uint8]
"""(H, W, 3), channels R, G, B."""

NO_VALUE = (118, 118, 118)
"""Grey of pixels without a value: no scale here has a grey."""

BACKGROUND = 0
"""Id of the class that an overlay leaves as photographed."""

_IGNORED = (40, 40, 40)


@dataclass(frozen=True)
class ColorScale:
    """Say which colour stands for which value: viridis, from dark blue to yellow.

    Attributes
    ----------
    low, high : float
        What is beyond gets the colour of the end. ``high`` is above ``low``.
    unit : str
        Of both; "" = none.
    reverse : bool
        Yellow is the low end: the near end, where depth is shown.
    log : bool
        Equal ratios, not equal differences, are equally far apart; ``low`` is then above 0.
    """

    low: float
    high: float
    unit: str = ""
    reverse: bool = False
    log: bool = False

    def __post_init__(self) -> None:
        finite = np.isfinite(self.low) and np.isfinite(self.high)
        if not finite or self.low >= self.high or (self.log and self.low <= 0):
            expected = "0 < low < high" if self.log else "low < high"
            raise ArrayError(
                f"colour scale: expected {expected}, found {self.low:g} to {self.high:g}"
            )

    def place(self, values: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """Return where values lie between the ends, 0 to 1; what is not finite at 0."""
        numbers = np.asarray(values, dtype=np.float32)
        ends = np.array([self.low, self.high], dtype=np.float32)
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.log:
                numbers, ends = np.log(numbers), np.log(ends)
            place = (numbers - ends[0]) / (ends[1] - ends[0])
        return np.asarray(np.clip(np.nan_to_num(place, nan=0.0), 0, 1), dtype=np.float32)

    def paint(self, values: npt.NDArray[Any], valid: npt.NDArray[np.bool_]) -> Picture:
        """Colour values, (H, W), in the scale's unit; grey where not valid."""
        colors: Picture = self._colors[np.rint(self.place(values) * 255).astype(np.uint8)]
        colors[~valid] = NO_VALUE
        return colors

    @property
    def _colors(self) -> Picture:
        return viridis()[::-1] if self.reverse else viridis()

    def stops(self, number: int = 17) -> list[str]:
        """Return the scale's colours from low to high as "#rrggbb", evenly spaced."""
        chosen = self._colors[np.rint(np.linspace(0, 255, number)).astype(int)]
        return [css_color(c) for c in chosen]

    def ticks(self) -> list[float]:
        """Return a few round values within the scale, ascending."""
        if self.log:
            powers = range(int(np.floor(np.log10(self.low))), int(np.log10(self.high)) + 1)
            round_values = [float(f"{m}e{p}") for p in powers for m in (1, 2, 5)]
            return [v for v in round_values if self.low <= v <= self.high]
        span = self.high - self.low
        power = 10.0 ** np.floor(np.log10(span / 5))
        step = next(power * m for m in (1, 2, 5, 10) if span / (power * m) <= 6)
        first = int(np.ceil(self.low / step - 1e-6))
        last = int(np.floor(self.high / step + 1e-6))
        return [float(f"{i * step:.6g}") for i in range(first, last + 1)]


@cache
def viridis() -> Picture:
    """Return OpenCV's viridis as (256, 3) uint8, R, G, B."""
    import cv2

    ramp = np.arange(256, dtype=np.uint8)[:, None]
    colors = cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return np.asarray(colors, dtype=np.uint8).copy()


def css_color(color: Sequence[int]) -> str:
    """Return (R, G, B) of 0-255 as "#rrggbb"."""
    red, green, blue = (int(c) for c in color)
    return f"#{red:02x}{green:02x}{blue:02x}"


def depth_picture(depth_m: npt.NDArray[np.float32], scale: ColorScale) -> Picture:
    """Colour depth, (H, W) metres, 0 = none."""
    return scale.paint(depth_m, depth_m > 0)


def normal_picture(normal: npt.NDArray[np.floating]) -> Picture:
    """Colour normals, (H, W, 3) unit vectors in the camera frame, in the usual way.

    Red = to the right, green = up, blue = towards the camera, each (1 + component) / 2, so that
    what faces the camera is lavender and the ground green. Grey where the normal is (0, 0, 0).
    """
    towards = normal.astype(np.float32) * np.array([1, -1, -1], np.float32)
    picture: Picture = np.rint(np.clip((towards + 1) * 127.5, 0, 255)).astype(np.uint8)
    # A third of the time of any(axis=2).
    x, y, z = np.moveaxis(towards, 2, 0)
    picture[(x == 0) & (y == 0) & (z == 0)] = NO_VALUE
    return picture


def normal_sphere(size: int = 160) -> npt.NDArray[np.uint8]:
    """Return the key to `normal_picture`: a ball as the camera sees it, (size, size, 4) R, G, B, A.

    Each pixel of the ball has the colour of the ball's own normal there; around it, alpha is 0.
    """
    position = (np.arange(size) + 0.5) * 2 / size - 1
    x, y = np.meshgrid(position, position)
    radius2 = x**2 + y**2
    normal = np.stack([x, y, -np.sqrt(np.clip(1 - radius2, 0, None))], axis=2)
    ball = normal_picture(normal)
    # One pixel of transition, so that the outline is smooth.
    alpha = np.clip((1 - np.sqrt(radius2)) * size / 2, 0, 1) * 255
    return np.dstack([ball, np.rint(alpha).astype(np.uint8)])


def label_picture(
    label: npt.NDArray[np.uint8],
    classes: Sequence[LabelClass],
    rgb: Picture | None = None,
) -> Picture:
    """Tint a photograph, or grey where there is none, with the colours of its labels.

    Parameters
    ----------
    label : (H, W) uint8
        Pixels of class 0 (background) stay as they are; 255 (ignore) becomes nearly black, and so
        does an id that `classes` does not name, as magenta.
    classes : sequence of LabelClass
    rgb : (H, W, 3) uint8, optional
    """
    drawn = np.full((*label.shape, 3), NO_VALUE, np.uint8) if rgb is None else rgb.copy()
    for value in np.flatnonzero(np.bincount(label.ravel(), minlength=256)):
        color = next((c.color for c in classes if c.id == value), (255, 0, 255))
        if value == IGNORE_LABEL:
            color = _IGNORED
        if value != BACKGROUND:
            tint(drawn, label == value, color)
    return drawn


def shrink(image: Picture, width: int) -> Picture:
    """Return a picture at most this wide, each pixel the mean of what it covers."""
    import cv2

    height, full = image.shape[:2]
    if full <= width:
        return image
    size = (width, max(1, round(height * width / full)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def encode_picture(
    image: npt.NDArray[np.uint8], kind: Literal["webp", "jpeg", "png"], quality: int = 60
) -> bytes:
    """Return a picture as the bytes of a file: (H, W, 3) R, G, B or, as PNG, (H, W, 4) with alpha.

    `quality`, 1 to 100, is that of WebP and JPEG; PNG loses nothing.
    """
    import cv2

    if kind == "png" and image.shape[2] == 3:
        return png_bytes(image)
    order = [2, 1, 0, 3][: image.shape[2]]
    flag = {"webp": cv2.IMWRITE_WEBP_QUALITY, "jpeg": cv2.IMWRITE_JPEG_QUALITY}
    settings = [flag[kind], quality] if kind in flag else []
    extension = ".jpg" if kind == "jpeg" else f".{kind}"
    _, data = cv2.imencode(extension, np.ascontiguousarray(image[:, :, order]), settings)
    return bytes(data)


def data_uri(data: bytes, kind: str) -> str:
    """Return a file's bytes as an address that a page can hold."""
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
