"""One frame from reader to chunks: check, derive, quantise, pad, compress."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.camera import Camera
from nimprep.derive.modalities import DERIVED, Recipe, derive, fill_frame
from nimprep.errors import ArrayError, DecodeError
from nimprep.frame import Frame
from nimprep.readers.base import Reader
from nimprep.store.frames import (
    depth_from_millimetres,
    depth_to_millimetres,
    normals_to_integers,
)
from nimprep.store.shards import encode_chunk
from nimprep.store.statistics import channel_sums
from nimprep.store.writer import StoreLayout


@dataclass(frozen=True)
class EncodedFrame:
    """Hold what a frame adds to a store.

    Attributes
    ----------
    chunks : dict of modality to bytes
    camera : Camera
    group : str
    baseline_m : float
    cam_to_road : (3, 4) float64
        NaN where there is none.
    gravity : (3,) float64
        Direction HHA was made with; NaN without HHA.
    channel_sums : (7, 3) int64
        See `nimprep.store.statistics.channel_sums`.
    depth_counts : (65536,) int64
        Pixels per depth in millimetres.
    digest : str
        SHA-256 of the frame's source files.
    """

    chunks: dict[str, bytes]
    camera: Camera
    group: str
    baseline_m: float
    cam_to_road: npt.NDArray[np.float64]
    gravity: npt.NDArray[np.float64]
    channel_sums: npt.NDArray[np.int64]
    depth_counts: npt.NDArray[np.int64]
    digest: str


def source_digest(reader: Reader, frame_id: str) -> str:
    """Return the SHA-256 of a frame's source files, names and contents."""
    digest = hashlib.sha256()
    for path in reader.sources(frame_id):
        name = path.relative_to(reader.root) if path.is_relative_to(reader.root) else path.name
        digest.update(f"{name}\0".encode())
        try:
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        except OSError as error:
            raise DecodeError(
                f"{path}: expected a readable file, found {error.strerror}"
            ) from error
    return digest.hexdigest()


def _padded(image: npt.NDArray[Any], shape: tuple[int, ...], fill: int) -> npt.NDArray[Any]:
    if image.shape == shape:
        return image
    if image.shape[0] > shape[0] or image.shape[1] > shape[1]:
        raise ArrayError(
            f"expected at most {shape[1]}x{shape[0]} pixels like the dataset's depth, "
            f"found {image.shape[1]}x{image.shape[0]}"
        )
    padded = np.full(shape, fill, dtype=image.dtype)
    padded[: image.shape[0], : image.shape[1]] = image
    return padded


def encode_frame(
    reader: Reader, frame_id: str, layout: StoreLayout, recipe: Recipe
) -> EncodedFrame:
    """Read one frame and make everything a store holds of it, on the calling thread alone.

    Raises
    ------
    DecodeError
        A file is damaged or holds what cannot be; it is named.
    """
    wanted = set(layout.modalities)
    if wanted & set(DERIVED):
        wanted.add("depth")
    if recipe.fill == "colorization":
        wanted.add("rgb")
    frame = reader.read(frame_id, wanted)
    try:
        stored, gravity = _stored_images(frame, layout, recipe)
        chunks = _chunks(frame, stored, layout)
    except ArrayError as error:
        raise DecodeError(f"frame {frame_id!r}: {error}") from error
    counts = np.zeros(65536, dtype=np.int64)
    if "depth" in stored:
        counts = np.bincount(stored["depth"].reshape(-1), minlength=65536)
    return EncodedFrame(
        chunks=chunks,
        camera=frame.camera,
        group=frame.group,
        baseline_m=frame.baseline_m,
        cam_to_road=np.full((3, 4), np.nan) if frame.cam_to_road is None else frame.cam_to_road,
        gravity=gravity,
        channel_sums=channel_sums({n: i for n, i in stored.items() if n in layout.modalities}),
        depth_counts=counts,
        digest=source_digest(reader, frame_id),
    )


def _stored_images(
    frame: Frame, layout: StoreLayout, recipe: Recipe
) -> tuple[dict[str, npt.NDArray[Any]], npt.NDArray[np.float64]]:
    """Return the frame's images as the store holds them, and the direction of gravity."""
    copied = {"rgb": frame.rgb, "label": frame.label}
    stored: dict[str, npt.NDArray[Any]] = {n: i for n, i in copied.items() if i is not None}
    missing = None
    if frame.depth_m is not None:
        # From here on depth is what the store says it is: what is derived can be made again.
        frame, stored["depth"] = _as_stored(frame, frame.depth_m)
        frame, missing = fill_frame(frame, recipe)
        if recipe.store_filled and frame.depth_m is not None:
            frame, stored["depth"] = _as_stored(frame, frame.depth_m)
    derived = derive(frame, missing, layout.modalities, recipe)
    stored |= derived.images
    if "normal" in stored:
        stored["normal"] = normals_to_integers(stored["normal"], layout.normal_dtype)
    return stored, derived.gravity


def _as_stored(
    frame: Frame, depth_m: npt.NDArray[np.float32]
) -> tuple[Frame, npt.NDArray[np.uint16]]:
    """Round depth to what a store can say; return the frame with it, and it in millimetres."""
    millimetres = depth_to_millimetres(depth_m)
    if not millimetres.any():
        raise ArrayError(
            "expected depth of 0.5 mm to 65.535 m somewhere, found none; check --depth-scale"
        )
    return replace(frame, depth_m=depth_from_millimetres(millimetres)), millimetres


def _chunks(
    frame: Frame, stored: dict[str, npt.NDArray[Any]], layout: StoreLayout
) -> dict[str, bytes]:
    chunks = {}
    for name in layout.modalities:
        if name not in stored:
            raise DecodeError(f"frame {frame.id!r}: expected {name}, found none")
        image = _padded(stored[name], layout.image_shape(name), int(layout.spec(name).fill))
        chunks[name] = encode_chunk(image, layout.chunk_codec(name))
    return chunks
