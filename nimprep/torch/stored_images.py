"""One frame's images out of a store, into memory that the caller provides."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch
from numcodecs import blosc
from torch import Tensor
from torch.utils.data import get_worker_info

from nimprep.derive.methods import FIXED_METHODS, FixedMethod, check_method
from nimprep.derive.normals import estimate_normals
from nimprep.errors import ArrayError, StoreError
from nimprep.frame import IGNORE_LABEL
from nimprep.kernels import samples
from nimprep.modality import MODALITIES, Modality
from nimprep.plane import values_of
from nimprep.store.buffers import empty
from nimprep.store.frames import (
    from_integers,
    to_integers,
)
from nimprep.store.reader import Store
from nimprep.torch.scaling import Scaling
from nimprep.torch.setups import Selection
from nimprep.torch.views import VIEWS

NormalsFrom = Literal["cached", FixedMethod]
"""Where normals come from: the store, or a method of `estimate_normals`."""

MADE = ("normal",)
"""What can be made from the stored depth as a frame is read."""


class StoredImages:
    """Decode a store's frames into tensors, padding included.

    Holds no open file; safe between threads, after a fork, and to pickle.

    Parameters
    ----------
    store : Store
    selection : Selection
    normals : str
        "cached", or a method of `estimate_normals`.
    merged : (256,) uint8, optional
        The label that each stored one becomes.

    Raises
    ------
    StoreError
        The store lacks a modality; how to get it is said.
    ArrayError
        `normals` is unknown.
    """

    def __init__(
        self,
        store: Store,
        selection: Selection,
        normals: NormalsFrom = "cached",
        merged: npt.NDArray[np.uint8] | None = None,
    ) -> None:
        if normals not in ("cached", *FIXED_METHODS):
            known = ", ".join(("cached", *FIXED_METHODS))
            raise ArrayError(f"normals: expected one of {known}, found {normals!r}")
        if normals != "cached":
            check_method(normals)  # compiles its kernels before workers start
        self.store = store
        self._method: FixedMethod = "nim" if normals == "cached" else normals
        self.merged = np.arange(256, dtype=np.uint8) if merged is None else merged
        self._merges = merged is not None
        self._made = () if normals == "cached" else MADE
        for name in selection.modalities:
            needed = "depth" if name in self._made else name
            if needed not in store.modalities:
                raise StoreError(_lacking(store, name, needed))
        # A setup takes unlabelled frames as well: all of them is 255, ignore.
        if selection.label and "label" not in store.modalities and not selection.inputs:
            raise StoreError(_lacking(store, "label", "label"))
        self.size: tuple[int, int] = next(iter(store.arrays.values())).shape[1:3]  # type: ignore[assignment]

    def modality(self, name: str) -> Modality:
        """Return a modality as `stored` gives it."""
        array = None if name in self._made else self.store.arrays.get(name)
        return MODALITIES[name] if array is None else array.modality

    def stored(self, name: str, index: int, out: npt.NDArray[Any] | None = None) -> Any:
        """Return an image as the store holds it, (H, W) or (H, W, 3), in `out` where given."""
        if get_worker_info() is not None:
            # A worker's main thread would else start Blosc's pool of threads.
            blosc.use_threads = False
        if name in self._made:
            values = to_integers(MODALITIES[name], self._estimated(index))
            if out is None:
                return values
            out[...] = values
            return out
        array = self.store.arrays.get(name)
        if array is None:
            out = empty(self.size, np.uint8) if out is None else out
            out[...] = MODALITIES[name].fill
            return out
        out = empty(array.shape[1:], array.dtype) if out is None else out
        array.decode(array.fetch(index), out, index)
        if self._merges and array.modality.values == "classes":
            out[...] = self.merged[out]
        return out

    def scaled(self, name: str, index: int, scaling: Scaling, out: Tensor) -> None:
        """Write an image as the network takes it: one pass from the decoded chunk.

        Parameters
        ----------
        out : (C, H, W) float32, contiguous
        """
        if name in VIEWS:
            view = VIEWS[name]
            values = torch.from_numpy(empty((1, *self.size), np.float32))
            self.scaled(view.of, index, scaling.cut_alone(), values)
            view.write(values, scaling.apply, out)
            return
        planes = out.numpy().reshape(out.shape[0], -1)
        modality = self.modality(name)
        if modality.values == "vectors":
            self._unit(name, index, planes)
            return
        stored = self.stored(name, index).reshape(-1)
        scale, offset = scaling.rows(name)
        low, high = scaling.ends(name)
        if modality.values == "numbers":
            fill, steps = modality.fill, modality.steps
            samples.scaled_plane(stored, fill, steps, low, high, scale[0], offset[0], planes[0])
        elif modality.values == "measures":
            numbers = values_of(modality).clip(low, high) * scale[0] + offset[0]
            numbers[np.isnan(numbers)] = 0
            planes[0] = numbers.take(stored.view(f"uint{8 * stored.dtype.itemsize}"))
        elif modality.values == "levels":
            samples.scaled_some(stored, scale, offset, planes)
        else:
            samples.scaled_colors(stored, scale, offset, planes)

    def label(self, index: int, out: Tensor) -> None:
        """Write the label: (H, W) int64, 255 = ignore and padding."""
        samples.widened(self.stored("label", index).reshape(-1), out.numpy().reshape(-1))

    def image(self, name: str, index: int) -> Tensor:
        """Return an image as transforms take it.

        rgb and hha (3, H, W) uint8, depth, disparity, transformed_disparity and elevation
        (1, H, W) float32 as a `Frame` has them, planes (1, H, W) float32 or uint8 likewise, normal
        (3, H, W) float32 unit vectors, label (H, W) int64.
        """
        modality = self.modality(name)
        if modality.values == "vectors":
            planes = empty((3, *self.size), np.float32)
            self._unit(name, index, planes.reshape(3, -1))
            return torch.from_numpy(planes)
        if modality.values == "classes":
            label = torch.from_numpy(empty(self.size, np.int64))
            self.label(index, label)
            return label
        image = torch.from_numpy(from_integers(modality, self.stored(name, index)))
        return image.permute(2, 0, 1) if modality.channels else image[None]

    def _unit(self, name: str, index: int, planes: npt.NDArray[np.float32]) -> None:
        if name in self._made:
            samples.channels_first(self._estimated(index).reshape(-1), planes)
        else:
            samples.unit_vectors(self.stored(name, index).reshape(-1), planes)

    def _estimated(self, index: int) -> npt.NDArray[np.float32]:
        """Return the normals of a frame's stored depth, (H, W, 3), zeros in the padding."""
        camera = self.store.camera(index)
        height, width = camera.shape
        depth_m = from_integers(self.modality("depth"), self.stored("depth", index))
        out = empty((*camera.shape, 3), np.float32)
        valid = np.ascontiguousarray(depth_m[:height, :width])
        estimate_normals(valid, camera, method=self._method, out=out, num_threads=1)
        if camera.shape == self.size:
            return out
        padded = np.zeros((*self.size, 3), dtype=np.float32)
        padded[:height, :width] = out
        return padded


def merged_classes(store: Store, classes: Mapping[str, int]) -> npt.NDArray[np.uint8]:
    """Return the label that each stored one becomes, (256,), by the classes' names.

    Raises
    ------
    ArrayError
        The store has no class of a name, a class has no label, or a label is not 0 to 255.
    """
    own = {entry["name"]: int(entry["id"]) for entry in store.about.classes}
    given = {name: label for name, label in classes.items() if name != "*"}
    if unknown := [name for name in given if name not in own]:
        raise ArrayError(
            f"classes: expected some of {', '.join(own) or 'none'}, found {unknown[0]!r}"
        )
    left = [name for name in own if name not in given]
    if left and "*" not in classes:
        raise ArrayError(
            f"classes: expected a label for each class, found none for {', '.join(left)}; name "
            "them, or '*' for all that are not named"
        )
    for name, label in classes.items():
        if isinstance(label, bool) or not isinstance(label, int) or not 0 <= label <= IGNORE_LABEL:
            raise ArrayError(f"classes: expected 0 to 255, found {label!r} for {name!r}")
    merged = np.full(256, IGNORE_LABEL, np.uint8)
    for name, stored in own.items():
        merged[stored] = given.get(name, classes.get("*", IGNORE_LABEL))
    return merged


def _lacking(store: Store, name: str, needed: str) -> str:
    there = ", ".join(store.modalities)
    advice = f"convert again with --modalities {','.join((*store.modalities, needed))}"
    if MODALITIES[name].values == "classes":
        advice = "convert a dataset with labels"
    elif name == needed and name in MADE and "depth" in store.modalities:
        advice += f", or compute them with normals={FIXED_METHODS[0]!r}"
    return f"{store.path}: expected {needed}, found only {there}; {advice}"
