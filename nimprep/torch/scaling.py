"""How stored values become what a network takes: value * scale + offset per channel."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nimprep.errors import ArrayError
from nimprep.modality import MODALITIES
from nimprep.store.statistics import ROWS, channel_statistics
from nimprep.torch.setups import channels_of

if TYPE_CHECKING:
    from nimprep.store.reader import Store

_CONSTANTS: dict[str, tuple[float, ...]] = {
    name: (1 / modality.divisor,) * modality.channel_count
    for name, modality in MODALITIES.items()
    if modality.values not in ("vectors", "classes")
}

_CUT: dict[str, tuple[float, float]] = {
    name: modality.cut for name, modality in MODALITIES.items() if modality.cut is not None
}

# Kept for a release, for those who import them: `nimprep.modality` says them.
DEPTH_SCALE_M = MODALITIES["depth"].divisor
DISPARITY_SCALE_PX = MODALITIES["disparity"].divisor
TRANSFORMED_DISPARITY_SCALE_PX = MODALITIES["transformed_disparity"].divisor
ELEVATION_SCALE_M = MODALITIES["elevation"].divisor

NAMED = ("constants", "train", "imagenet", "none")
"""What `normalize` can be by name."""

Normalization = Literal["constants", "train", "imagenet", "none"]


@dataclass(frozen=True)
class Scaling:
    """Scale and offset per modality and channel, and the range that its numbers are cut to.

    A pixel without depth, normal, HHA, disparity or a plane's number stays 0 whatever the scaling,
    so that 0 says "none". Transformed disparity and elevation become 0 too where there is
    none, as if on the road.

    Attributes
    ----------
    scale, offset : dict of modality to tuple of float
        For rgb and hha in 0-255, depth and elevation in metres, disparities in pixels, planes,
        which have one channel, in their units. Modalities
        not named are left as they are; normals always are.
    cut : dict of modality to (float, float)
        Numbers beyond these, in the same units, become the nearer of them before they are scaled;
        of modalities of one number per pixel. Those not named are not cut.
    """

    scale: dict[str, tuple[float, ...]]
    offset: dict[str, tuple[float, ...]]
    cut: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, ends in self.cut.items():
            _check_cut(name, ends)
        for values in (self.scale, self.offset):
            for name, row in values.items():
                scaled = name in _CONSTANTS or name not in MODALITIES
                if not scaled or len(row) != channels_of(name):
                    raise ArrayError(
                        f"scaling: expected a number per channel of {', '.join(_CONSTANTS)}, "
                        f"found {len(row)} of {name!r}"
                    )

    @classmethod
    def constants(cls) -> Scaling:
        """Cut and divide by what each record says, rgb and hha by 255; no offsets."""
        return cls(dict(_CONSTANTS), {}, dict(_CUT))

    @classmethod
    def imagenet(cls) -> Scaling:
        """Bring rgb to what encoders trained on ImageNet expect; the others as `constants` does.

        Mean (0.485, 0.456, 0.406) and standard deviation (0.229, 0.224, 0.225) of rgb in 0-1, as
        torchvision's weights state them.
        """
        mean, std = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
        offset = tuple(-m / s for m, s in zip(mean, std, strict=True))
        scale = {**_CONSTANTS, "rgb": tuple(1 / (255 * s) for s in std)}
        return cls(scale, {"rgb": offset}, dict(_CUT))

    @classmethod
    def none(cls) -> Scaling:
        """Leave rgb and hha in 0-255, depth and elevation in metres, disparities in pixels."""
        return cls({}, {})

    @classmethod
    def from_statistics(cls, store: Store, names: Iterable[str], split: str = "train") -> Scaling:
        """Bring each channel to mean 0 and standard deviation 1 over a split's pixels.

        Of rgb, depth, hha and planes; a store keeps no sums of the others. Disparities and
        elevation are cut and divided by the constants, which leave the road of transformed
        disparity and elevation at 0.

        Raises
        ------
        ArrayError
            No pixel of the split has the modality.
        StoreError
            The split has no frames.
        """
        statistics = channel_statistics(store, split)
        planes = [plane.name for plane in store.planes]
        scale: dict[str, tuple[float, ...]] = {}
        offset: dict[str, tuple[float, ...]] = {}
        for name in names:
            if name not in ROWS and name not in planes:
                scale |= {name: _CONSTANTS[name]} if name in _CONSTANTS else {}
                continue
            if name not in statistics:
                raise ArrayError(
                    f"{store.path}: expected pixels with {name} in split {split!r}, found none; "
                    "normalize by 'constants'"
                )
            found = statistics[name]
            # A channel that is the same everywhere has nothing to be divided by.
            scale[name] = tuple(1 / s if s > 0 else 1.0 for s in found.std)
            offset[name] = tuple(-m * s for m, s in zip(found.mean, scale[name], strict=True))
        return cls(scale, offset, dict(_CUT))

    def cut_alone(self) -> Scaling:
        """Return what cuts as this does and scales nothing."""
        return Scaling({}, {}, self.cut)

    def ends(self, name: str) -> tuple[np.float32, np.float32]:
        """Return the range that a modality's numbers are cut to; infinite where they are not."""
        low, high = self.cut.get(name, (-math.inf, math.inf))
        return np.float32(low), np.float32(high)

    def rows(self, name: str) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return a modality's scale and offset, (C,) float32 each."""
        count = channels_of(name)
        return (
            np.array(self.scale.get(name, (1.0,) * count), dtype=np.float32),
            np.array(self.offset.get(name, (0.0,) * count), dtype=np.float32),
        )

    def apply(self, name: str, image: Tensor, out: Tensor) -> None:
        """Write a modality's scaled values.

        Parameters
        ----------
        image : (..., C, H, W) tensor
            rgb and hha in 0-255, depth and elevation in metres, disparities in pixels, normals as
            unit vectors; none is 0, or NaN where the integers are signed and in planes.
        out : (..., C, H, W) float32
            May not overlap the image.
        """
        out.copy_(image)
        if name in MODALITIES and name not in _CONSTANTS:
            return
        if name in self.cut:
            out.clamp_(*self.cut[name])
        scale, offset = (torch.from_numpy(row).to(out.device) for row in self.rows(name))
        out.mul_(scale[:, None, None]).add_(offset[:, None, None])
        modality = MODALITIES.get(name)
        if modality is None or math.isnan(modality.absent):
            out.masked_fill_(image.isnan(), 0)
        elif modality.values != "colors":
            out.masked_fill_((image == 0).all(dim=-3, keepdim=True), 0)


def _and(scale: Mapping[str, tuple[float, ...]], scaling: Scaling) -> Scaling:
    return Scaling({**scaling.scale, **scale}, scaling.offset, scaling.cut)


def _check_cut(name: str, ends: object) -> None:
    """Raise `ArrayError` where numbers cannot be cut so."""
    modality = MODALITIES.get(name)
    if modality is not None and modality.values != "numbers":
        single = ", ".join(n for n, m in MODALITIES.items() if m.values == "numbers")
        raise ArrayError(
            f"cut: expected modalities of one number per pixel ({single}, planes), found {name!r}; "
            "leave it out"
        )
    pair = tuple(ends) if isinstance(ends, (tuple, list)) else ()
    if len(pair) != 2 or not all(isinstance(x, (int, float)) for x in pair):
        raise ArrayError(f"cut: expected two numbers for {name}, found {ends!r}; give (low, high)")
    if not (math.isfinite(pair[0]) and math.isfinite(pair[1]) and pair[0] < pair[1]):
        raise ArrayError(
            f"cut: expected finite numbers, the lower first, for {name}, found {ends!r}; give "
            "(low, high)"
        )


def with_cut(
    scaling: Scaling, cut: Mapping[str, tuple[float, float] | None], names: Iterable[str]
) -> Scaling:
    """Return the scaling with other ranges to cut to; None for a name = not cut.

    Raises
    ------
    ArrayError
        A name is none of `names`, its values are no numbers, or the range is none.
    """
    used = tuple(names)
    if unused := [name for name in cut if name not in used]:
        raise ArrayError(
            f"cut: expected some of {', '.join(used)}, which the setup has, found {unused[0]!r}; "
            "leave it out"
        )
    merged = {**scaling.cut, **cut}
    kept = {name: ends for name, ends in merged.items() if ends is not None}
    return Scaling(scaling.scale, scaling.offset, kept)


def scaling_from(
    normalize: Normalization | Scaling | None, store: Store, names: Iterable[str]
) -> Scaling:
    """Return the scaling that `normalize` names; None = "constants".

    Raises
    ------
    ArrayError
        There is none of that name; or it scales what the store has not.
    """
    planes = {plane.name: (1 / plane.divisor,) for plane in store.planes}
    if isinstance(normalize, Scaling):
        named = {*normalize.scale, *normalize.offset, *normalize.cut}
        if unknown := sorted(named - {*_CONSTANTS, *planes}):
            raise ArrayError(
                f"scaling: expected some of {', '.join((*_CONSTANTS, *planes))}, found "
                f"{unknown[0]!r}"
            )
        return normalize
    if normalize is None or normalize == "constants":
        return _and(planes, Scaling.constants())
    if normalize == "imagenet":
        return _and(planes, Scaling.imagenet())
    if normalize == "none":
        return Scaling.none()
    if normalize == "train":
        return Scaling.from_statistics(store, names)
    raise ArrayError(
        f"normalize: expected one of {', '.join(NAMED)} or a Scaling, found {normalize!r}"
    )
