"""A store's frames as pictures: one scale per modality for all frames, and a key to each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.modality import Modality
from nimprep.report.collect import Collected, physical
from nimprep.report.depth_charts import depth_quantiles
from nimprep.report.pictures import (
    ColorScale,
    Picture,
    depth_picture,
    label_picture,
    normal_picture,
    shrink,
)
from nimprep.store.frames import from_integers
from nimprep.store.reader import Store


@dataclass(frozen=True)
class Look:
    """Say how a modality is shown.

    Attributes
    ----------
    modality : Modality
    title : str
        For a heading.
    about : str
        What its picture shows, for those who cannot see it.
    scale : ColorScale, optional
        Of values, where one number has one colour.
    """

    modality: Modality
    title: str
    about: str
    scale: ColorScale | None = None


class Artist:
    """Draw a store's frames.

    Parameters
    ----------
    store : Store
    facts : Collected
        Its statistics, for the scales.

    Attributes
    ----------
    looks : dict of str to Look
        By modality, in the store's order.
    """

    def __init__(self, store: Store, facts: Collected) -> None:
        self.store = store
        self.looks = {name: _look(store, facts, name) for name in store.modalities}

    def draw(self, index: int, name: str, width: int | None = None) -> Picture:
        """Return a frame's picture of one modality, (H, W, 3) uint8, of its size before padding.

        Where a width is given, the picture is at most that wide, and of a large image only every
        n-th row and column is drawn, at least twice as many as are shown.

        Raises
        ------
        KeyError
            The store has no such modality.
        StoreError
            The store is damaged.
        """
        if width is None:
            return self._draw(index, name, 1)
        columns = int(self.store.tables.image_size[index, 1])
        return shrink(self._draw(index, name, max(1, columns // (2 * width))), width)

    def _draw(self, index: int, name: str, step: int) -> Picture:
        look = self.looks[name]
        image = self._stored(index, name, step)
        match look.modality.picture:
            case "as stored":
                return image
            case "directions":
                return normal_picture(_unit(image))
            case "classes":
                rgb = self._stored(index, "rgb", step) if "rgb" in self.looks else None
                return label_picture(image, self.store.classes, rgb)
        if look.scale is None:
            return image
        if look.modality.picture == "near and far":
            return depth_picture(from_integers(look.modality, image), look.scale)
        values = physical(self.store, name, image)
        return look.scale.paint(values, np.isfinite(values))

    def _stored(self, index: int, name: str, step: int) -> npt.NDArray[Any]:
        height, width = (int(n) for n in self.store.tables.image_size[index])
        image = self.store.arrays[name].read(index)
        return np.ascontiguousarray(image[:height:step, :width:step])


def _unit(stored: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return (H, W, 3) integer normals at unit length; their scale cancels out."""
    vectors = stored.astype(np.float32)
    squares = np.einsum("ijk,ijk->ij", vectors, vectors)
    return np.asarray(vectors / np.sqrt(np.maximum(squares, np.float32(1)))[:, :, None])


def _look(store: Store, facts: Collected, name: str) -> Look:
    modality = store.arrays[name].modality
    title = modality.title or name.replace("_", " ").capitalize()
    about = modality.about or modality.long_name
    if modality.picture not in _SCALED or modality.channels:
        return Look(modality, title, about)
    return Look(
        modality,
        title,
        modality.about or f"{about}, {_SCALED[modality.picture]}, grey has none",
        _scale(modality, facts),
    )


_SCALED = {"near and far": "near is yellow, far is dark", "low and high": "yellow is high"}


def _scale(modality: Modality, facts: Collected) -> ColorScale:
    """Return the scale from the number that 1 % are below to the one that 1 % are above."""
    unit = "" if modality.units == "1" else modality.units
    if modality.name in facts.pooled:
        values = facts.pooled[modality.name]
        known = values[np.isfinite(values)]
        low, high = (float(x) for x in np.percentile(known, [1, 99])) if known.size else (0.0, 1.0)
    else:
        low, high = depth_quantiles(facts, (0.01, 0.99))
    if modality.picture == "low and high":
        # What tensors are cut to is what there is to see: beyond it small things have one colour.
        least, most = modality.cut or (low, high)
        low, high = max(low, least), min(high, most)
        low, high = (low, high) if low < high else (low - 0.5, low + 0.5)
        return ColorScale(low, high, unit)
    if not 0 < low < high:
        middle = low if low > 0 else 1.0
        low, high = middle / 2, middle * 2
    return ColorScale(low, high, unit, reverse=True, log=True)
