"""What an image file says of itself, before any pixel is decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nimprep.errors import DecodeError
from nimprep.frame import MAX_PIXELS

MAX_BYTES = 8 * MAX_PIXELS
"""A decoded image takes at most as many: the most pixels, of four channels of 16 bits."""


@dataclass(frozen=True)
class ImageHeader:
    """Tell what an image file says of itself.

    Attributes
    ----------
    height, width : int
        Pixels.
    bits : int
        Per channel, as stored.
    kind : str
        "grey", "RGB", "palette", "RGBA", ...
    channels : int
        As decoded.
    frames : int, optional
        How many images of this kind the file holds; None = it is one.
    """

    height: int
    width: int
    bits: int
    kind: str
    channels: int = 1
    frames: int | None = None

    def __str__(self) -> str:
        return f"{self.width}x{self.height} {self.bits}-bit {self.kind}"


def check_header(header: ImageHeader, path: Path) -> None:
    """Raise `DecodeError` where an image claims more than memory should be spent on."""
    pixels = header.height * header.width
    size = pixels * header.channels * -(-header.bits // 8)
    if not 0 < pixels <= MAX_PIXELS or min(header.height, header.width) < 0 or size > MAX_BYTES:
        raise DecodeError(
            f"{path}: expected an image of 1 to {MAX_PIXELS} pixels, found a header of {header}"
        )


def broken(path: Path, name: str, found: str) -> DecodeError:
    """Return the error for a file of some format that is not whole."""
    return DecodeError(f"{path}: expected a whole {name}, found {found}")
