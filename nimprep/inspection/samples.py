"""Some files of a pattern decoded, whatever they hold, and what their pixels are like."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.images import read_array, read_bytes, read_header

MOST_SAMPLES = 6
"""So many files of a pattern are decoded."""

_MOST_PIXELS = 40_000_000
"""Of all samples of a pattern together; the first is decoded in any case."""

IMAGES = frozenset(
    f".{ending}"
    for names in ("png jpg jpeg jpe bmp tif tiff webp", "pgm ppm pnm pfm npy")
    for ending in names.split(" ")
)
"""Endings of files that may be images. What they are is told by their first bytes."""


@dataclass(frozen=True)
class Sample:
    """Hold one file's pixels as they are stored.

    Attributes
    ----------
    path : Path
    pixels : (H, W) or (H, W, C)
        Channels R, G, B, A; palette images by index.
    kind : str
        What the header says: "grey", "RGB", "palette", "array", ...
    palette : (K, 3) uint8, optional
    key : str
        Name of the array in a .npz file.
    """

    path: Path
    pixels: npt.NDArray[Any]
    kind: str
    palette: npt.NDArray[np.uint8] | None = None
    key: str = ""

    @property
    def channels(self) -> int:
        return 1 if self.pixels.ndim == 2 else self.pixels.shape[2]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.pixels.shape[1], self.pixels.shape[0]


def some_of(members: Sequence[Any]) -> list[Any]:
    """Return a few, spread over them all."""
    return list(members[:: max(1, len(members) // MOST_SAMPLES)][:MOST_SAMPLES])


def sampled(chosen: Sequence[Path], problems: list[str], root: Path) -> list[Sample]:
    """Decode files; what cannot be is a line of `problems`."""
    found: list[Sample] = []
    pixels = 0
    for path in chosen:
        if found and pixels > _MOST_PIXELS:
            break
        try:
            sample = decoded(path)
        except DecodeError as error:
            problems.append(" ".join(str(error).replace(f"{root}/", "").split()))
            continue
        pixels += sample.pixels.shape[0] * sample.pixels.shape[1]
        found.append(sample)
    return found


def decoded(path: Path) -> Sample:
    """Decode a file.

    Raises
    ------
    DecodeError
        It is no image, or a damaged one.
    """
    if path.suffix.lower() == ".npy":
        return _laid_out(Sample(path, read_array(path), "array"))
    header = read_header(path)
    data = read_bytes(path)
    if header.kind == "palette":
        from PIL import Image

        with Image.open(io.BytesIO(data)) as image:
            flat = image.getpalette() or []
            palette = np.array(flat, np.uint8).reshape(-1, 3)
            try:
                return Sample(path, np.asarray(image), "palette", palette)
            except (OSError, ValueError, SyntaxError) as error:
                raise DecodeError(f"{path}: expected an image, found {error}") from error
    import cv2

    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        made = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise DecodeError(f"{path}: expected an image, found {error.err}") from error
    if made is None:
        raise DecodeError(f"{path}: expected an image, found {len(data)} bytes that are none")
    pixels = np.asarray(made)
    if pixels.ndim == 3 and pixels.shape[2] >= 3:
        pixels = pixels[..., [2, 1, 0, *range(3, pixels.shape[2])]]
    return Sample(path, pixels, header.kind)


def _laid_out(sample: Sample) -> Sample:
    """Return an array as an image: a single channel without its axis."""
    pixels = sample.pixels
    if pixels.ndim == 3 and 1 in (pixels.shape[0], pixels.shape[2]):
        pixels = pixels[0] if pixels.shape[0] == 1 else pixels[..., 0]
    if pixels.ndim not in (2, 3) or pixels.dtype.kind not in "uif" or pixels.size == 0:
        raise DecodeError(
            f"{sample.path}: expected an image's array, found shape {sample.pixels.shape} "
            f"of {pixels.dtype}"
        )
    return Sample(sample.path, pixels, "array", key=sample.key)


def roughness(plane: npt.NDArray[Any]) -> float:
    """Return how much neighbours differ: the median step that is no 0, over the values' spread.

    Near 0 for smooth planes, some 0.3 for noise; 0 where nothing varies.
    """
    values = plane.astype(np.float64)
    steps = np.abs(np.diff(values, axis=1)).ravel()
    steps = np.concatenate([steps, np.abs(np.diff(values, axis=0)).ravel()])
    steps = steps[np.isfinite(steps)]
    finite = values[np.isfinite(values)]
    if steps.size == 0 or finite.size == 0:
        return 0.0
    low, high = np.percentile(finite, (2, 98))
    return float(steps.mean() / (high - low)) if high > low else 0.0
