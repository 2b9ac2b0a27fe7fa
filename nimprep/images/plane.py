"""One image of any kind of file, by its layout: image files, arrays in containers, bare numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_start
from nimprep.images import archive, exr, hdf5
from nimprep.images.array import (
    SIGNATURE,
    ArrayHeader,
    raw_axes,
    read_array_header,
    read_array_part,
    read_raw_header,
    read_raw_part,
)
from nimprep.images.axes import array_header, as_image, check_index, checked_axes
from nimprep.images.decode import image_header, read_bytes, read_image
from nimprep.images.header import ImageHeader
from nimprep.images.layout import PLAIN, Layout

_Kind = Literal["image", "raw", "npy", "npz", "hdf5", "exr"]
_START = 520
_LETTERS = "RGBA"


def read_header(path: Path, layout: Layout = PLAIN) -> ImageHeader:
    """Return the size and kind of a file's images, and how many there are, without decoding any.

    Raises
    ------
    DecodeError
        It is no image, is cut short, claims more than `MAX_PIXELS` pixels, or is not as its layout
        says.
    """
    kind = _kind(path, layout)
    if kind in ("image", "exr"):
        _refuse_array_layout(path, layout, key=kind == "exr")
    if kind == "image":
        return image_header(path, layout.orientation)
    if kind == "exr":
        return exr.exr_header(read_bytes(path), path, layout.key)
    return _array(kind, path, layout)[2]


def read_plane(path: Path, layout: Layout = PLAIN, index: int | None = None) -> npt.NDArray[Any]:
    """Return one image's raw values, as they lie in the file.

    Parameters
    ----------
    path : Path
    layout : Layout
        What the file does not say of itself.
    index : int, optional
        Which of the frames in it, where it holds many: where its axes have N.

    Returns
    -------
    (H, W) or (H, W, C), integers or floating
        C-contiguous, in the machine's byte order. Channels of image files in the order R, G, B, A;
        NaN and infinity stay.

    Raises
    ------
    DecodeError
        It is damaged, or not as its layout says.
    """
    kind = _kind(path, layout)
    if kind in ("image", "exr"):
        check_index(None, index, path)
        _refuse_array_layout(path, layout, key=kind == "exr")
    if kind == "image":
        image = read_image(path, orientation=layout.orientation)
        # OpenCV has them in the order B, G, R, A.
        if image.ndim == 3 and image.shape[2] >= 3:
            image = image[:, :, [2, 1, 0, 3][: image.shape[2]]]
    elif kind == "exr":
        image = exr.decode_exr(read_bytes(path), path, layout.key)
    else:
        image = _read_array(kind, path, layout, index)
    if layout.byte_order == "swapped" and kind != "raw":
        image = image.byteswap()
    return np.ascontiguousarray(_channel(image, layout.channel, path))


def _kind(path: Path, layout: Layout) -> _Kind:
    if layout.raw is not None:
        return "raw"
    ending = path.suffix.lower()
    if ending == ".npy":
        return "npy"
    start = read_start(path, _START)
    if ending == ".npz" or (layout.key is not None and start.startswith(archive.SIGNATURE)):
        return "npz"
    if hdf5.is_hdf5(start):
        return "hdf5"
    if start.startswith(SIGNATURE):
        return "npy"
    return "exr" if start.startswith(exr.SIGNATURE) else "image"


def _refuse_array_layout(path: Path, layout: Layout, *, key: bool = False) -> None:
    """Raise `DecodeError` where the layout of an image file says what only arrays have."""
    wrong = {"axes": layout.axes not in (None, "HW", "HWC")}
    wrong["byte_order"] = layout.byte_order in ("little", "big")
    wrong["key"] = layout.key is not None and not key
    for name in (name for name, is_wrong in wrong.items() if is_wrong):
        # What is neither says so by itself: a MATLAB 5 file, a zip file.
        read_header(path, PLAIN)
        raise DecodeError(
            f"{path}: expected an array, as the description's {name!r} says, found an image file; "
            f"leave {name!r} out"
        )


def _array(kind: _Kind, path: Path, layout: Layout) -> tuple[ArrayHeader, str, ImageHeader]:
    """Return what a container's array is, what its axes are, and what its images are."""
    axes = layout.axes
    if kind == "raw" and layout.raw is not None:
        found, axes = read_raw_header(path, layout.raw, layout), raw_axes(layout.raw, axes)
    elif kind == "npz":
        found = archive.read_archive_header(path, layout.key)
    elif kind == "hdf5":
        found = hdf5.read_hdf5_header(path, layout.key)
    else:
        found = read_array_header(path)
    if found.dtype.kind not in "biuf":
        raise DecodeError(
            f"{path}: expected integers or floating numbers, found {found.dtype}; "
            "save the plane that counts"
        )
    said = layout.byte_order
    if (
        kind != "raw"
        and (said == "little" or said == "big")
        and found.dtype.newbyteorder(said) != found.dtype
    ):
        raise DecodeError(
            f"{path}: expected {said}-endian numbers, as the description's "
            "'byte_order' says, found a file that says the other; leave 'byte_order' out, or give "
            '"swapped" where the file is wrong'
        )
    axes = checked_axes(found.shape, axes, path)
    return found, axes, array_header(found.shape, found.dtype, axes, path)


def _read_array(kind: _Kind, path: Path, layout: Layout, index: int | None) -> npt.NDArray[Any]:
    _, axes, header = _array(kind, path, layout)
    check_index(header.frames, index, path)
    axis = axes.index("N") if index is not None else None
    if kind == "raw" and layout.raw is not None:
        array = read_raw_part(path, layout.raw, replace(layout, axes=axes), axis, index)
    elif kind == "npz":
        array = archive.read_archive_part(path, layout.key, axis, index)
    elif kind == "hdf5":
        array = hdf5.read_hdf5_part(path, layout.key, axis, index)
    else:
        array = read_array_part(path, axis, index)
    image = as_image(array, axes.replace("N", ""))
    return image.view(np.uint8) if image.dtype == np.bool_ else image


def _channel(image: npt.NDArray[Any], channel: str | int | None, path: Path) -> npt.NDArray[Any]:
    """Return the channel that counts, or all."""
    if channel is None:
        return image
    number = _LETTERS.index(channel) if isinstance(channel, str) else channel
    count = 1 if image.ndim == 2 else image.shape[2]
    if number >= count:
        raise DecodeError(
            f"{path}: expected a channel {channel!r}, found {count} channels; mend 'channel'"
        )
    picked: npt.NDArray[Any] = image if image.ndim == 2 else image[:, :, number]
    return picked
