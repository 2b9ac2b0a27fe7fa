"""Between a frame in memory and the integers a store holds."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import StoreError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality
from nimprep.store.buffers import empty
from nimprep.store.images import ImageArray

MAX_DEPTH_M = 65.535
"""The farthest depth a store can say, metres; what is farther is stored as none."""


def to_integers(modality: Modality, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image of a `Frame` as a store holds it."""
    if modality.values == "vectors":
        from nimprep.kernels import quantisation

        out = np.empty(image.shape, modality.dtype)
        vectors = np.ascontiguousarray(image, np.float32)
        quantisation.normals_to_integers(vectors, np.float32(modality.steps), out)
        return out
    return _rounded(modality, image) if modality.values == "numbers" else image


def _rounded(modality: Modality, numbers: npt.NDArray[np.float32]) -> npt.NDArray[Any]:
    numbers = np.ascontiguousarray(numbers, np.float32)
    out = np.empty(numbers.shape, modality.dtype)
    if modality.beyond == "none":
        from nimprep.kernels.quantisation import metres_to_millimetres

        metres_to_millimetres(numbers, out)
        return out
    from nimprep.kernels.planes import positives_to_integers, signed_to_integers

    round_into = signed_to_integers if modality.fill else positives_to_integers
    round_into(numbers, modality.steps, out)
    return out


def from_integers(modality: Modality, stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image of a store as a `Frame` has it.

    Numbers are float32; where there is none, they are 0 if the integers are unsigned, NaN if not.
    Vectors are float32 of unit length. All else stays as it is.
    """
    if modality.values == "vectors":
        from nimprep.kernels import quantisation

        out = empty(stored.shape, np.float32)
        quantisation.normals_from_integers(np.ascontiguousarray(stored), out)
        return out
    if modality.values != "numbers":
        return stored
    numbers = empty(stored.shape, np.float32)
    np.divide(stored, np.float32(modality.steps), out=numbers, dtype=np.float32)
    if modality.fill:
        numbers[stored == modality.fill] = np.nan
    return numbers


def depth_to_millimetres(depth_m: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Round (H, W) float32 metres to uint16 millimetres; beyond `MAX_DEPTH_M` = 0, none."""
    return to_integers(MODALITIES["depth"], depth_m)


def depth_from_millimetres(stored: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
    """Return (H, W) uint16 millimetres as float32 metres, each the float32 nearest to it."""
    return from_integers(MODALITIES["depth"], stored)


def normals_to_integers(normal: npt.NDArray[np.float32], dtype: str) -> npt.NDArray[Any]:
    """Return (H, W, 3) float32 unit vectors as int8 or int16; none stays all 0."""
    return to_integers(MODALITIES["normal"].as_dtype(dtype), normal)


EAGER = ("rgb", "depth", "label")
"""Read with a frame; what is derived from them is read when asked for, as few need all of it."""


class StoredFrame(Frame):
    """A frame of a store: its chunks are read and checked, and decompressed when asked for.

    So a frame costs what is used of it: rgb, depth and label without the normals, say; normals and
    HHA are not even read before. Asking for an image that the store lacks gives None, as with any
    `Frame`.
    """

    _arrays: dict[str, ImageArray]
    _chunks: dict[str, npt.NDArray[np.uint8] | None]
    _number: int

    @classmethod
    def fetch(
        cls, number: int, arrays: dict[str, ImageArray], camera: Camera, **fields: Any
    ) -> StoredFrame:
        """Read a frame's chunks of these arrays and check them.

        Raises
        ------
        StoreError
            A shard is missing, or a checksum does not fit.
        """
        frame = cls.__new__(cls)
        chunks = {name: arrays[name].fetch(number) for name in EAGER if name in arrays}
        # What is a cached property below must not be set here, hence no call of __init__.
        frame.__dict__.update(fields, camera=camera, _arrays=arrays, _chunks=chunks, _number=number)
        return frame

    def _image(self, name: str) -> npt.NDArray[Any] | None:
        if name not in self._arrays:
            return None
        array = self._arrays[name]
        packed = self._chunks[name] if name in self._chunks else array.fetch(self._number)
        height, width = self.camera.shape
        padded = empty(array.shape[1:], array.dtype)
        array.decode(packed, padded, self._number)
        if padded.shape[:2] != (height, width):
            padded = np.ascontiguousarray(padded[:height, :width])
        return from_integers(array.modality, padded)

    @cached_property
    def rgb(self) -> npt.NDArray[np.uint8] | None:
        """Colour, (H, W, 3) uint8."""
        return self._image("rgb")

    @cached_property
    def depth_m(self) -> npt.NDArray[np.float32] | None:
        """Depth, (H, W) float32 metres, 0 = none."""
        return self._image("depth")

    @cached_property
    def normal(self) -> npt.NDArray[np.float32] | None:
        """Normals, (H, W, 3) float32 unit vectors, (0, 0, 0) = none."""
        return self._image("normal")

    @cached_property
    def hha(self) -> npt.NDArray[np.uint8] | None:
        """HHA, (H, W, 3) uint8."""
        return self._image("hha")

    @cached_property
    def disparity(self) -> npt.NDArray[np.float32] | None:
        """Disparity, (H, W) float32 pixels, 0 = none."""
        return self._image("disparity")

    @cached_property
    def transformed_disparity(self) -> npt.NDArray[np.float32] | None:
        """Disparity less the road's, (H, W) float32 pixels, NaN = none."""
        return self._image("transformed_disparity")

    @cached_property
    def elevation(self) -> npt.NDArray[np.float32] | None:
        """Height over the road's plane, (H, W) float32 metres, NaN = none."""
        return self._image("elevation")

    @cached_property
    def label(self) -> npt.NDArray[np.uint8] | None:
        """Class ids, (H, W) uint8, 255 = ignore."""
        return self._image("label")


def check_size(size: tuple[int, int], padded: tuple[int, ...], where: str) -> None:
    """Raise `StoreError` where a frame's size does not fit the padded images."""
    if not (0 < size[0] <= padded[0] and 0 < size[1] <= padded[1]):
        raise StoreError(
            f"{where}: expected a size within {padded[1]}x{padded[0]}, found {size[1]}x{size[0]}"
        )
