"""Arrays in containers: HDF5, MATLAB 7.3, .npz and EXR, each told as images of a pattern are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.images import Layout, archive_shapes, hdf5_shapes, read_plane
from nimprep.inspection.samples import MOST_SAMPLES, Sample

CONTAINERS = frozenset((".h5", ".hdf5", ".hdf", ".mat", ".npz", ".exr"))
"""Endings of files that may hold several arrays."""

_SMALLEST = 8
_CHANNELS = (3, 4)


@dataclass(frozen=True)
class Held:
    """Name an array in a container.

    Attributes
    ----------
    key : str
        "" = the only one.
    axes : str
        What its axes are: of "N", "H", "W" and "C".
    frames : int
        How many images; 0 = it is one.
    """

    key: str
    axes: str
    frames: int = 0


def arrays_in(path: Path) -> list[Held]:
    """Return the arrays of a container that may be images.

    Raises
    ------
    DecodeError
        It cannot be read.
    """
    if path.suffix.lower() == ".exr":
        return [Held("", "HWC")]
    is_archive = path.suffix.lower() == ".npz"
    listed = archive_shapes(path, 20) if is_archive else hdf5_shapes(path, 40)
    # MATLAB keeps what cells refer to there.
    shapes = {name: shape for name, shape in listed.items() if not name.startswith("#refs#")}
    reversed_ = path.suffix.lower() == ".mat"
    many = {shape[0] for shape in shapes.values() if len(shape) == 4}
    found = []
    for key, shape in shapes.items():
        axes = _axes(shape, reversed_=reversed_, many=many)
        if axes and min(shape[axes.index("H")], shape[axes.index("W")]) >= _SMALLEST:
            found.append(Held(key, axes, shape[0] if axes[0] == "N" else 0))
    return found


def _axes(shape: Sequence[int], *, reversed_: bool, many: set[int]) -> str:
    """Return what axes are by an array's shape; "" = it is no image.

    MATLAB's come in the reverse order: columns before rows.
    """
    image = "WH" if reversed_ else "HW"
    if len(shape) == 2:
        return image
    if len(shape) == 3:
        if shape[0] in many:
            return f"N{image}"
        if shape[0] in _CHANNELS:
            return f"C{image}"
        return f"{image}C" if shape[2] in (1, *_CHANNELS) and not reversed_ else f"N{image}"
    if len(shape) == 4:
        if shape[1] in _CHANNELS:
            return f"NC{image}"
        return f"N{image}C" if shape[3] in (1, *_CHANNELS) else ""
    return ""


def samples_of(paths: Sequence[Path], held: Held) -> list[Sample]:
    """Decode some images of an array; what cannot be is left out."""
    layout = Layout(key=held.key or None, axes=None if held.key == "" else held.axes)
    total = held.frames or len(paths)
    samples: list[Sample] = []
    for number in range(0, total, max(1, total // MOST_SAMPLES)):
        if len(samples) == MOST_SAMPLES:
            break
        path, index = (paths[0], number) if held.frames else (paths[number], None)
        try:
            image = read_plane(path, layout, index)
        except DecodeError:
            continue
        if image.ndim == 3 and image.shape[2] == 1:
            image = image[..., 0]
        samples.append(Sample(path, image, "array", key=held.key))
    return samples
