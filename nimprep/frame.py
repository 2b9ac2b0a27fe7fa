"""One time step of a dataset: every modality as arrays, one camera."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from nimprep import modality
from nimprep.arrays import without_mask
from nimprep.camera import Camera, unit_gravity
from nimprep.errors import ArrayError
from nimprep.modality import modality_name as modality_name

IGNORE_LABEL: int = modality.MODALITIES["label"].fill
"""Label of pixels that take part in no statistic: padding, or outside an evaluated area."""

VIRTUAL_BASELINE_M = 0.055
"""Baseline where a dataset has none: that of the RealSense D415, which took GMRP (datasheet).

So GMRP's disparities are those the camera itself matched, at the colour image's focal length, and
a store's uint16 holds them for depth from 0.2 m on (see `nimprep.modality`).
"""


MAX_PIXELS = 1 << 26
"""Images of more pixels are refused before anything is allocated for them (67 megapixels)."""


ByteImage = Literal["rgb", "hha", "label"]
"""Modalities whose images are uint8."""

FloatImage = Literal["depth", "normal", "disparity", "transformed_disparity", "elevation"]
"""Those whose images are float32."""


@dataclass(frozen=True)
class LabelClass:
    """Name one value of the label image and the colour it is drawn in, (R, G, B) of 0-255."""

    id: int
    name: str
    color: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Frame:
    """Hold one time step.

    Depth is checked, and masks of masked arrays become what says none: 0, NaN, 255 in labels.

    Attributes
    ----------
    id : str
        Unique within its dataset.
    camera : Camera
        The camera of every image here.
    rgb : (H, W, 3) uint8, optional
        Colour, channels R, G, B.
    depth_m : (H, W) float32, metres, optional
        0 = no depth; what is made one of NaN, infinity or less than 0.1 mm is there 0.
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
    gravity : (3,) float64, optional
        Direction of gravity in the camera frame, pointing down, as it was given: made a unit vector
        here. None = it was not, and is estimated where it is needed.
    others : mapping of str to array
        The images of further modalities, by name; of planes (`nimprep.plane`) the numbers, (H, W),
        in their units: float32, NaN = none, or uint8 that is as it is stored.
    signs : mapping of str to float
        What was measured on the raw values: see `nimprep.doubts.raw`.
    absent : frozenset of str
        Modalities that the dataset has not for this frame; their images say none throughout.

    Raises
    ------
    ArrayError
        The depth is no floating (H, W) array of the camera's size, or negative somewhere; the
        colours are masked; or gravity is no direction.
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
    gravity: npt.NDArray[np.float64] | None = None
    others: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    signs: Mapping[str, float] = field(default_factory=dict)
    absent: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        try:
            for name, record in modality.MODALITIES.items():
                given = self.image(name)
                if not isinstance(given, np.ma.MaskedArray):
                    continue
                place, plain = record.attribute or name, _plain(record, given)
                if not hasattr(self, place):
                    place, plain = "others", {**self.others, name: plain}
                object.__setattr__(self, place, plain)
            self._take_masks_off_planes()
            if self.gravity is not None:
                object.__setattr__(self, "gravity", unit_gravity(self.gravity))
            if self.depth_m is not None:
                # Here, as its kernels take their time to load.
                from nimprep.depth import checked_depth

                object.__setattr__(self, "depth_m", checked_depth(self.depth_m, self.camera))
        except ArrayError as error:
            raise ArrayError(f"frame {self.id!r}: {error}") from error

    @overload
    def __getitem__(self, name: ByteImage) -> npt.NDArray[np.uint8]: ...
    @overload
    def __getitem__(self, name: FloatImage) -> npt.NDArray[np.float32]: ...
    @overload
    def __getitem__(self, name: str) -> npt.NDArray[Any]: ...
    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        """Return the image of a modality by its name ("depth" is `depth_m`): it must be there.

        Where the attributes may be None, this is an array for type checkers too.

        Raises
        ------
        ArrayError
            The frame has none, or there is no such modality.
        """
        found = self.image(name)
        if found is None:
            raise ArrayError(
                f"frame {self.id!r}: expected {name}, found {', '.join(self) or 'no image'}; "
                "ask for one of those"
            )
        return found

    def __contains__(self, name: object) -> bool:
        """Tell whether the frame has an image of this modality."""
        return name in tuple(self)

    def __iter__(self) -> Iterator[str]:
        """Yield the modalities of which the frame has an image."""
        yield from (name for name in modality.MODALITIES if self.image(name) is not None)
        yield from (name for name in self.others if name not in modality.MODALITIES)

    def image(self, name: str) -> npt.NDArray[Any] | None:
        """Return the image of a modality by its name, an attribute or one of `others`.

        Raises
        ------
        ArrayError
            There is no such modality.
        """
        if name not in modality.MODALITIES:
            if name in self.others:
                return self.others[name]
            known = ", ".join(dict.fromkeys((*modality.MODALITIES, *self.others)))
            raise ArrayError(f"image: expected one of {known}, found {name!r}")
        attribute = modality.MODALITIES[name].attribute or name
        found: npt.NDArray[Any] | None = getattr(self, attribute, self.others.get(name))
        return found

    def _take_masks_off_planes(self) -> None:
        masked = {
            name: np.where(np.ma.getmaskarray(image), np.nan, image.data).astype(np.float32)
            for name, image in self.others.items()
            if isinstance(image, np.ma.MaskedArray)
        }
        if masked:
            object.__setattr__(self, "others", {**self.others, **masked})


def _plain(record: modality.Modality, image: np.ma.MaskedArray[Any, Any]) -> Any:
    """Return an image with what says none where it was masked, all channels of a pixel as one."""
    if record.values == "colors":
        return without_mask(image, record.name)
    mask: npt.NDArray[np.bool_] = np.ma.getmaskarray(image)
    if image.ndim == 3:
        mask = np.any(mask, axis=-1, keepdims=True)
    return np.where(mask, np.array(record.absent).astype(image.dtype), image.data)


# Kept for a release, for those who import them: `nimprep.modality` says all of this.


class Plane(NamedTuple):
    """What is said of a modality of one number per pixel: number = stored / steps."""

    dtype: str
    steps: float
    units: str
    none: int


MODALITIES: tuple[str, ...] = tuple(modality.MODALITIES)
ON_REQUEST: tuple[str, ...] = tuple(n for n, m in modality.MODALITIES.items() if m.on_request)
PLANES: dict[str, Plane] = {
    n: Plane(m.dtype, m.steps, m.units, m.fill)
    for n, m in modality.MODALITIES.items()
    if m.values == "numbers"
}
