"""What a file does not say of itself: which array in it counts, and what its numbers are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from nimprep.images.orientation import OrientationRule


@dataclass(frozen=True, kw_only=True)
class Raw:
    """Describe a file of bare numbers, row by row."""

    dtype: str
    width: int
    height: int
    channels: int = 1
    header_bytes: int = 0


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Say how a file is read, as far as it does not say so itself.

    Attributes
    ----------
    key : str, optional
        Of an array in a container, or of a channel of EXR; None = there is but one.
    axes : str, optional
        What the array's axes are, first to last: H rows, W columns, C channels, N frames; None =
        HW or HWC.
    raw : Raw, optional
        The file is bare numbers; None = it says what it holds.
    channel : "R", "G", "B", "A" or int, optional
        The one that counts; None = all.
    byte_order : {"little", "big", "swapped"}, optional
        Of bare numbers, None = little; "swapped" turns around the bytes of what any file holds.
    orientation : {"apply", "ignore", "refuse"}
        What becomes of an image file's EXIF orientation other than 1.
    """

    key: str | None = None
    axes: str | None = None
    raw: Raw | None = None
    channel: str | int | None = None
    byte_order: Literal["little", "big", "swapped"] | None = None
    orientation: OrientationRule = "apply"


PLAIN = Layout()
"""Of files that say all of themselves."""
