"""A store's frames as pictures: one scale per modality for all frames, and a key to each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.report.collect import KNOWN, Collected, physical
from nimprep.report.depth_charts import depth_quantiles
from nimprep.report.pictures import (
    ColorScale,
    Picture,
    depth_picture,
    label_picture,
    normal_picture,
    shrink,
)
from nimprep.store.frames import depth_from_millimetres
from nimprep.store.reader import Store

_TITLES = {
    "rgb": "Colour",
    "depth": "Depth",
    "normal": "Normals",
    "hha": "HHA",
    "label": "Labels",
}
_ABOUT = {
    "rgb": "photograph",
    "depth": "depth, near is yellow, far is dark, grey has none",
    "normal": "surface normals: red to the right, green up, blue towards the camera",
    "hha": "HHA: red horizontal disparity, green height, blue angle with gravity",
    "label": "label overlay on the photograph",
}


@dataclass(frozen=True)
class Look:
    """Say how a modality is shown.

    Attributes
    ----------
    name : str
        The modality.
    title : str
        For a heading.
    about : str
        What its picture shows, for those who cannot see it.
    scale : ColorScale, optional
        Of values, where one number has one colour.
    """

    name: str
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

    def draw(self, frame: int, name: str, width: int | None = None) -> Picture:
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
            return self._draw(frame, name, 1)
        columns = int(self.store.tables.image_size[frame, 1])
        return shrink(self._draw(frame, name, max(1, columns // (2 * width))), width)

    def _draw(self, frame: int, name: str, step: int) -> Picture:
        look = self.looks[name]
        image = self._stored(frame, name, step)
        if name == "depth" and look.scale is not None:
            return depth_picture(depth_from_millimetres(image), look.scale)
        if name == "normal":
            return normal_picture(_unit(image))
        if name == "label":
            rgb = self._stored(frame, "rgb", step) if "rgb" in self.looks else None
            return label_picture(image, self.store.classes, rgb)
        if look.scale is not None:
            values = physical(self.store, name, image)
            return look.scale.paint(values, np.isfinite(values))
        return image

    def _stored(self, frame: int, name: str, step: int) -> npt.NDArray[Any]:
        height, width = (int(n) for n in self.store.tables.image_size[frame])
        image = self.store.arrays[name].read(frame)
        return np.ascontiguousarray(image[:height:step, :width:step])


def _unit(stored: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return (H, W, 3) integer normals at unit length; their scale cancels out."""
    vectors = stored.astype(np.float32)
    squares = np.einsum("ijk,ijk->ij", vectors, vectors)
    return np.asarray(vectors / np.sqrt(np.maximum(squares, np.float32(1)))[:, :, None])


def _look(store: Store, facts: Collected, name: str) -> Look:
    if name == "depth":
        return Look(name, _TITLES[name], _ABOUT[name], _depth_scale(facts))
    if name in KNOWN:
        return Look(name, _TITLES[name], _ABOUT[name])
    title = name.replace("_", " ").replace("-", " ").capitalize()
    array = store.arrays[name]
    about = str(array.spec.attributes.get("long_name", name))
    if len(array.shape) > 3:
        return Look(name, title, about)
    known = facts.pooled[name][np.isfinite(facts.pooled[name])]
    low, high = np.percentile(known, [1, 99]) if known.size else (0.0, 1.0)
    low, high = (low, high) if low < high else (low - 0.5, low + 0.5)
    unit = str(array.spec.attributes.get("units", ""))
    scale = ColorScale(float(low), float(high), "" if unit == "1" else unit)
    return Look(name, title, f"{about}, yellow is high, grey has none", scale)


def _depth_scale(facts: Collected) -> ColorScale:
    """Return the scale from the depth that 1 % are nearer than to the one 1 % are beyond."""
    low, high = depth_quantiles(facts, (0.01, 0.99))
    if not low < high:
        middle = low if low > 0 else 1.0
        low, high = middle / 2, middle * 2
    return ColorScale(low, high, "m", reverse=True, log=True)
