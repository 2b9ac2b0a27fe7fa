"""Images with a palette, by index: for labels the index is the class, the colour but for show.

OpenCV gives the colours alone. Pillow's decoders give the index; they get files only once they were
checked here as for OpenCV.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from nimprep.errors import DecodeError
from nimprep.files import read_start
from nimprep.images import png
from nimprep.images.decode import image_header, read_bytes
from nimprep.images.header import broken
from nimprep.images.orientation import (
    OrientationRule,
    checked_orientation,
    orientation_of,
    turned,
)

_BMP = b"BM"
_PALETTE = 3
"""PNG's colour type."""


def read_palette_index(
    path: Path, orientation: OrientationRule = "apply"
) -> npt.NDArray[np.uint8] | None:
    """Return the indices of a PNG or BMP that has a palette, (H, W); None = it has none.

    Parameters
    ----------
    orientation : {"apply", "ignore", "refuse"}
        What becomes of an EXIF orientation other than 1.

    Raises
    ------
    DecodeError
        It is damaged.
    """
    start = read_start(path, png.HEADER_BYTES)
    is_png = start.startswith(png.SIGNATURE) and start[25:26] == bytes([_PALETTE])
    if not is_png and not start.startswith(_BMP):
        return None
    header = image_header(path, "ignore")
    data = read_bytes(path)
    by = checked_orientation(orientation_of(data), orientation, path)
    checked = png.checked_png(data, path) if is_png else data
    try:
        found = _decoded(checked, is_png)
    except (DecodeError, MemoryError, ImportError):
        raise
    except Exception as error:  # in files made to deceive, Pillow trips over anything
        reason = str(error) or type(error).__name__
        raise broken(path, "palette image", f"one that cannot be read: {reason}") from error
    if found is not None and found.shape != (header.height, header.width):
        raise broken(path, "image", f"a header of {header} before pixels of {found.shape}")
    return None if found is None else turned(found, by)


def _decoded(data: bytes, is_png: bool) -> npt.NDArray[np.uint8] | None:
    image: Any
    if is_png:
        from PIL.PngImagePlugin import PngImageFile

        image = PngImageFile(io.BytesIO(data))
    else:
        from PIL.BmpImagePlugin import BmpImageFile

        image = BmpImageFile(io.BytesIO(data))
    # A BMP in colour has none, and one whose palette is grey is a grey image to OpenCV too.
    if image.mode not in ("P", "1"):
        return None
    return np.asarray(image).astype(np.uint8)
