"""Between a frame in memory and the integers a store holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.errors import StoreError
from nimprep.frame import Frame
from nimprep.modality import MODALITIES, Modality
from nimprep.plane import from_plane, to_plane
from nimprep.store.buffers import empty
from nimprep.store.images import ImageArray


def to_integers(modality: Modality, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image of a `Frame` as a store holds it."""
    if modality.values == "vectors":
        from nimprep.kernels import quantisation

        out = np.empty(image.shape, modality.dtype)
        vectors = np.ascontiguousarray(image, np.float32)
        quantisation.normals_to_integers(vectors, np.float32(modality.steps), out)
        return out
    if modality.values == "measures":
        return to_plane(modality, image)
    return _rounded(modality, image) if modality.values == "numbers" else image


def _rounded(modality: Modality, numbers: npt.NDArray[np.float32]) -> npt.NDArray[Any]:
    if modality.beyond == "none":
        return depth_to_integers(modality, numbers)[0]
    numbers = np.ascontiguousarray(numbers, np.float32)
    out = np.empty(numbers.shape, modality.dtype)
    from nimprep.kernels.planes import positives_to_integers, signed_to_integers

    round_into = signed_to_integers if modality.fill else positives_to_integers
    round_into(numbers, modality.steps, out)
    return out


def from_integers(modality: Modality, stored: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image of a store as a `Frame` has it.

    Numbers are float32; where there is none, they are 0 if the integers are unsigned, NaN if not,
    and NaN in planes.
    Vectors are float32 of unit length. All else stays as it is.
    """
    if modality.values == "vectors":
        from nimprep.kernels import quantisation

        out = empty(stored.shape, np.float32)
        quantisation.normals_from_integers(np.ascontiguousarray(stored), out)
        return out
    if modality.values == "measures":
        return from_plane(modality, stored)
    if modality.values != "numbers":
        return stored
    numbers = empty(stored.shape, np.float32)
    np.divide(stored, np.float32(modality.steps), out=numbers, dtype=np.float32)
    if modality.fill:
        numbers[stored == modality.fill] = np.nan
    return numbers


def depth_to_integers(
    modality: Modality, depth_m: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.uint16], int]:
    """Return (H, W) float32 metres as a store holds them, and how many that had some have none.

    None is what lies beyond `Modality.most`, and what is nearer than half a step.
    """
    from nimprep.kernels.quantisation import metres_to_steps

    numbers = np.ascontiguousarray(depth_m, np.float32)
    out = np.empty(numbers.shape, np.uint16)
    lost = metres_to_steps(numbers, np.float32(modality.steps), out)
    return out, int(lost)


def normals_to_integers(normal: npt.NDArray[np.float32], dtype: str) -> npt.NDArray[Any]:
    """Return (H, W, 3) float32 unit vectors as int8 or int16; none stays all 0."""
    return to_integers(MODALITIES["normal"].as_dtype(dtype), normal)


class StoredImages(Mapping[str, npt.NDArray[Any]]):
    """A frame's images by modality: read and checked, and decompressed when asked for.

    What is derived is not even read before, as few need all of it.

    Raises
    ------
    StoreError
        A shard is missing, or a checksum does not fit.
    """

    def __init__(self, index: int, arrays: dict[str, ImageArray], shape: tuple[int, int]) -> None:
        self._index = index
        self._arrays = arrays
        self._shape = shape
        self._images: dict[str, npt.NDArray[Any]] = {}
        given = (name for name, array in arrays.items() if array.modality.derived is None)
        self._chunks = {name: arrays[name].fetch(index) for name in given}

    def __len__(self) -> int:
        return len(self._arrays)

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        if name not in self._images:
            self._images[name] = self._decoded(name)
        return self._images[name]

    def _decoded(self, name: str) -> npt.NDArray[Any]:
        array = self._arrays[name]
        packed = self._chunks[name] if name in self._chunks else array.fetch(self._index)
        height, width = self._shape
        padded = empty(array.shape[1:], array.dtype)
        array.decode(packed, padded, self._index)
        if padded.shape[:2] != self._shape:
            padded = np.ascontiguousarray(padded[:height, :width])
        return from_integers(array.modality, padded)


def _of_store(name: str) -> Any:
    return cached_property(lambda frame: frame.others.get(name))


class StoredFrame(Frame):
    """A frame of a store: its chunks are read and checked, and decompressed when asked for.

    So a frame costs what is used of it: rgb, depth and label without the normals, say. Asking for
    an image that the store lacks gives None, as with any `Frame`; `others` has all of them.
    """

    rgb = _of_store("rgb")
    depth_m = _of_store("depth")
    normal = _of_store("normal")
    hha = _of_store("hha")
    disparity = _of_store("disparity")
    transformed_disparity = _of_store("transformed_disparity")
    elevation = _of_store("elevation")
    label = _of_store("label")

    def __iter__(self) -> Iterator[str]:
        """Yield the modalities that the store has, as far as they are read."""
        return iter(self.others)

    @classmethod
    def fetch(
        cls, index: int, arrays: dict[str, ImageArray], camera: Camera, **fields: Any
    ) -> StoredFrame:
        """Read a frame's chunks of these arrays and check them.

        Raises
        ------
        StoreError
            A shard is missing, or a checksum does not fit.
        """
        frame = cls.__new__(cls)
        images = StoredImages(index, arrays, camera.shape)
        # What is a cached property must not be set here, hence no call of __init__.
        frame.__dict__.update(fields, camera=camera, others=images)
        return frame


def check_size(size: tuple[int, int], padded: tuple[int, ...], where: str) -> None:
    """Raise `StoreError` where a frame's size does not fit the padded images."""
    if not (0 < size[0] <= padded[0] and 0 < size[1] <= padded[1]):
        raise StoreError(
            f"{where}: expected a size within {padded[1]}x{padded[0]}, found {size[1]}x{size[0]}"
        )
