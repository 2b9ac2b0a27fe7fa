"""Modality: everything the tool knows about one kind of image, said once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep.depth_unit import steps_per_metre

Values = Literal["colors", "levels", "vectors", "numbers", "measures", "classes"]
"""What a pixel holds::

    colors   three uint8
    levels   three uint8; all 0 = none
    vectors  three integers, a unit vector times the largest there is; all 0 = none
    numbers  one integer, a number times `steps`; `fill` = none
    measures one integer; times `scale` plus `offset` it is the number; `fill` = none, if `has_none`
    classes  the id of a class
"""


Resize = Literal["linear", "linear where some", "unit vectors", "nearest", "nearest by width"]
"""How an image is scaled to another size::

    linear             interpolated; where it shrinks, over the area a pixel covers
    linear where some  the same from the pixels that have something, where the nearest has
    unit vectors       the same, and then brought to unit length
    nearest            the nearest pixel's
    nearest by width   the nearest pixel's, a number of pixels and so scaled with the width
"""


Picture = Literal["as stored", "near and far", "low and high", "directions", "classes"]
"""How people are shown it::

    as stored      its channels as red, green and blue
    near and far   distances on a scale of ratios: near is yellow, far is dark, none grey
    low and high   numbers on a scale of differences: high is yellow, low is dark, none grey
    directions     right is red, up green, towards the camera blue, none grey
    classes        the photograph, tinted in the classes' colours
"""


@dataclass(frozen=True)
class Derivation:
    """Say how a modality is made from others.

    Attributes
    ----------
    make : str
        "module:function", called with a `nimprep.derive.recipe.Given`, returns a `Made`. Imported
        when it is first called, as its kernels take their time.
    describe : str
        "module:function", called with a `Recipe`, returns the `method` and `parameters` that a
        store's attributes say of it.
    made_from : tuple of str
        The modalities that it is made from.
    covers : {"depth", "depth beside depth", "depth or nothing", "at least depth"}
        Where there is some: exactly where depth is, or was filled in; only where there is depth
        above, below, left or right of it, too; there or nowhere, as where no road is; or elsewhere,
        too.
    gravity : bool
        Whether its maker gives a direction of gravity.
    masked : bool
        Whether it depends on which pixels were filled in, which no store says.
    """

    make: str
    describe: str
    made_from: tuple[str, ...] = ("depth",)
    covers: Literal["depth", "depth beside depth", "depth or nothing", "at least depth"] = "depth"
    gravity: bool = False
    masked: bool = False


@dataclass(frozen=True)
class Modality:
    """Describe one kind of image.

    Attributes
    ----------
    name : str
        Of its array in a store, of its tensors, and in `--modalities`, there with hyphens too.
    values : Values
        What a pixel holds.
    long_name, units, comment : str
        CF attributes of its array; "" = none.
    channels : tuple of str
        What each of three channels holds; empty where there is one.
    dtype : str
        Of the stored integers.
    dtypes : tuple of str
        What else `dtype` can be in a store (see `as_dtype`); empty = nothing.
    steps : float
        Stored integers are the values times this, rounded.
    scale, offset : float
        Of measures, which have them in place of steps. A `scale` of numbers is that which `steps`
        are the inverse of, where they are no whole number.
    fill : int
        What is stored where there is none, and in the padding.
    has_none : bool
        Whether measures can be none: then `fill` is no number, and else one like all others.
    beyond : {"nearest", "none"}
        What numbers become that the integers cannot say.
    resize : Resize
        How it is scaled to another size.
    flip : {"mirror", "mirror and negate x"}
        What becomes of it when the frame is mirrored left to right.
    divisor : float
        Tensors are divided by this, in `units`, for networks to start from; vectors never are.
    cut : (float, float), optional
        Before that, numbers of tensors beyond these two, in `units`, become the nearer of them;
        None = none does.
    picture : Picture
        How people are shown it.
    title, about : str
        A heading for its pictures, and what they show, for those who cannot see them; "" = the
        name, and `long_name` with the key to its colours.
    key : tuple of str
        What red, green and blue of its pictures stand for; empty = that needs no words.
    fillable : bool
        Whether its holes can be filled before others are made from it.
    attribute : str
        What a `Frame` calls it; "" = its name, if it has an attribute of its own there.
    derived : Derivation, optional
        None = it comes from the source.
    on_request : bool
        Stored only where it is asked for by name.
    own_unit : bool
        Whether each store chooses its `steps`: see `as_unit`.
    rounded : bool
        Whether a store's unit is coarser than what it was made of, and what is derived from it was
        made of that.
    """

    name: str
    values: Values
    long_name: str
    units: str = ""
    comment: str = ""
    channels: tuple[str, ...] = ()
    dtype: str = "uint8"
    dtypes: tuple[str, ...] = ()
    steps: float = 1
    scale: float = 1
    offset: float = 0
    fill: int = 0
    has_none: bool = True
    beyond: Literal["nearest", "none"] = "nearest"
    resize: Resize = "nearest"
    flip: Literal["mirror", "mirror and negate x"] = "mirror"
    divisor: float = 1
    cut: tuple[float, float] | None = None
    picture: Picture = "low and high"
    title: str = ""
    about: str = ""
    key: tuple[str, ...] = ()
    fillable: bool = False
    attribute: str = ""
    derived: Derivation | None = None
    on_request: bool = False
    own_unit: bool = False
    rounded: bool = False

    @property
    def step(self) -> float:
        """What one stored integer counts, in `units`."""
        return self.scale if self.scale != 1 else 1 / self.steps

    @property
    def most(self) -> float:
        """The greatest number that can be stored, in `units`."""
        return self.number_of(int(np.iinfo(self.dtype).max))

    def number_of(self, stored: float) -> float:
        """Return the number that an integer says, or a mean of some, in `units`."""
        return stored * self.scale if self.scale != 1 else stored / self.steps

    @property
    def channel_count(self) -> int:
        """Channels of an image."""
        return len(self.channels) or 1

    def image_shape(self, height: int, width: int) -> tuple[int, ...]:
        """Return the shape of an image as it is stored."""
        return (height, width, len(self.channels)) if self.channels else (height, width)

    @property
    def is_plain(self) -> bool:
        """Whether measures are bytes that are the numbers themselves; they stay bytes in memory."""
        same = (self.scale, self.offset) == (1, 0) and not self.has_none
        return self.values == "measures" and same and self.dtype == "uint8"

    @property
    def absent(self) -> float:
        """What an image in memory is where there is none, and in padding."""
        if self.values == "measures":
            return float("nan") if self.has_none else self.fill * self.scale + self.offset
        return float("nan") if self.values == "numbers" and self.fill else self.fill

    def blank(self, size: tuple[int, int]) -> npt.NDArray[Any]:
        """Return an image in memory of (height, width) that has nothing anywhere."""
        measured = self.values in ("vectors", "numbers", "measures") and not self.is_plain
        dtype = np.float32 if measured else np.uint8
        return np.full(self.image_shape(*size), self.absent, dtype)

    def as_dtype(self, dtype: str) -> Modality:
        """Return the modality of a store that holds it as this; itself where it is never that."""
        if dtype not in self.dtypes:
            return self
        return replace(self, dtype=dtype, steps=int(np.iinfo(dtype).max))

    def as_unit(self, unit: float | None, *, rounded: bool = False) -> Modality:
        """Return the modality of a store whose integers count this; itself if none chooses that.

        Parameters
        ----------
        unit : float, optional
            In `units`; None = as the table has it.
        rounded : bool
            See `Modality`.
        """
        if not self.own_unit or unit is None:
            return self
        steps = steps_per_metre(unit)
        scale = 1.0 if isinstance(steps, int) else unit
        return replace(self, steps=steps, scale=scale, rounded=rounded)

    @property
    def has_other_unit(self) -> bool:
        """Whether this is a store's that does not count in the table's unit."""
        return self.own_unit and self.step != MODALITIES[self.name].step


MODALITIES: dict[str, Modality] = {
    modality.name: modality
    for modality in (
        Modality(
            name="rgb",
            values="colors",
            long_name="colour",
            channels=("red", "green", "blue"),
            resize="linear",
            divisor=255,
            picture="as stored",
            title="Colour",
            about="photograph",
        ),
        Modality(
            name="depth",
            values="numbers",
            long_name="depth along the optical axis",
            units="m",
            dtype="uint16",
            steps=1000,
            beyond="none",
            # About the range of the D415 that GMRP was taken with.
            divisor=10,
            picture="near and far",
            about="depth, near is yellow, far is dark, grey has none",
            fillable=True,
            attribute="depth_m",
            own_unit=True,
        ),
        Modality(
            name="normal",
            values="vectors",
            long_name="unit surface normal in the camera frame, towards the camera",
            units="1",
            comment="(0, 0, 0) where there is no depth, or none at any of the four neighbours",
            channels=("x right", "y down", "z forward"),
            dtype="int8",
            dtypes=("int8", "int16"),
            steps=127,
            resize="unit vectors",
            flip="mirror and negate x",
            picture="directions",
            title="Normals",
            about="surface normals: red to the right, green up, blue towards the camera",
            derived=Derivation(
                make="nimprep.derive.normals:make_normals",
                describe="nimprep.derive.normals:describe_normals",
                covers="depth beside depth",
            ),
        ),
        Modality(
            name="hha",
            values="levels",
            long_name="HHA",
            channels=("horizontal disparity", "height above ground", "angle with gravity"),
            resize="linear where some",
            divisor=255,
            picture="as stored",
            title="HHA",
            about="HHA: red horizontal disparity, green height, blue angle with gravity",
            key=(
                "horizontal disparity: near is more",
                "height above ground",
                "angle with gravity",
            ),
            derived=Derivation(
                make="nimprep.derive.hha:make_hha",
                describe="nimprep.derive.hha:describe_hha",
                covers="at least depth",
                gravity=True,
                masked=True,
            ),
        ),
        Modality(
            name="disparity",
            values="numbers",
            long_name="disparity of a rectified stereo pair",
            units="pixel",
            dtype="uint16",
            # KITTI's own: up to 255.996 pixels, to 0.002. What is nearer is stored as that.
            steps=256,
            resize="nearest by width",
            # About the road's at the lower edge of KITTI's images.
            divisor=64,
            derived=Derivation(
                make="nimprep.derive.disparity:make_disparity",
                describe="nimprep.derive.disparity:describe_disparity",
            ),
            on_request=True,
        ),
        Modality(
            name="transformed_disparity",
            values="numbers",
            long_name="disparity less the road's own",
            units="pixel",
            dtype="int16",
            # As far to either side of the road, to 0.004 pixels: far below what a matcher resolves.
            steps=128,
            fill=-32768,
            resize="nearest by width",
            # What lies on a road is off by a few; a wrong match by as much as it likes.
            divisor=16,
            cut=(-32, 32),
            derived=Derivation(
                make="nimprep.derive.road_profile:make_transformed_disparity",
                describe="nimprep.derive.road_profile:describe_transformed_disparity",
                covers="depth or nothing",
            ),
            on_request=True,
        ),
        Modality(
            name="elevation",
            values="numbers",
            long_name="height over the road's plane",
            units="m",
            dtype="int16",
            steps=1000,
            fill=-32768,
            # What stands on a road is about as high, and lorries twice; noise far away is more.
            divisor=2,
            cut=(-4, 4),
            derived=Derivation(
                make="nimprep.derive.elevation:make_elevation",
                describe="nimprep.derive.elevation:describe_elevation",
                covers="depth or nothing",
            ),
            on_request=True,
        ),
        Modality(
            name="label",
            values="classes",
            long_name="class",
            fill=255,
            picture="classes",
            title="Labels",
            about="label overlay on the photograph",
        ),
    )
}
"""Every kind of image the tool knows, in the order in which they are listed everywhere.

A dataset may have others, which it describes itself: see `nimprep.plane`.
"""


def given_for(names: Iterable[str]) -> set[str]:
    """Return the modalities of a dataset that these are, or are made from.

    Names that the table has not are a dataset's own: see `nimprep.plane`.
    """
    derived = {name: MODALITIES[name].derived if name in MODALITIES else None for name in names}
    return {
        s
        for name, derivation in derived.items()
        for s in (derivation.made_from if derivation else (name,))
    }


def modality_name(name: str) -> str:
    """Return a modality's name as arrays have it, from a spelling with hyphens as well."""
    return name.strip().replace("-", "_")
