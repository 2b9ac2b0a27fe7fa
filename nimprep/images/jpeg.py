"""JPEG: its header, and whether all of it is there.

Source: ITU-T T.81 (1992): markers (B.1.1), frame and scan headers (B.2.2, B.2.3).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nimprep.images.header import ImageHeader, broken

SIGNATURE = b"\xff\xd8"

MAX_SCANS = 128
"""Encoders make about ten; each costs a pass over all pixels, and takes but a few bytes."""

_PROGRESSIVE = 0xC2
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
_READABLE = {0xC0: "baseline", 0xC1: "extended", _PROGRESSIVE: "progressive"}
_KINDS = {1: "grey", 3: "colour", 4: "CMYK"}
_SCAN, _END = 0xDA, 0xD9
_BARE = {0x00, 0x01, *range(0xD0, 0xD9)}
"""Second bytes after 0xFF that start no segment: a packed 0xFF, TEM, RST0-7, SOI."""

_MID_GREY = 128
_FILLER = bytes(range(1, 255)) * 4


@dataclass(frozen=True)
class JpegOutline:
    """Tell what a JPEG's markers say.

    Attributes
    ----------
    header : ImageHeader
    progressive : bool
    end : int
        Where the last scan's bytes end.
    """

    header: ImageHeader
    progressive: bool
    end: int


def jpeg_outline(data: bytes, path: Path) -> JpegOutline:
    """Walk a JPEG's markers to its end.

    A progressive JPEG that was cut and closed again is told by the scans it lacks, any other by
    `may_be_cut`. One that was cut within its last scan is taken: it lacks but the last bits of some
    coefficients.

    Raises
    ------
    DecodeError
        It is cut short, of a kind that OpenCV does not read, or lacks scans.
    """
    frame: tuple[ImageHeader, bytes, bool] | None = None
    missing: dict[tuple[int, int], int] = {}
    scans = end = 0
    for marker, start, stop in _segments(data, path):
        body = data[start + 4 : stop]
        if marker in _FRAMES:
            if frame is not None:
                raise broken(path, "JPEG", "two headers")
            frame = _frame(marker, body, path)
            missing = {(c, k): 1 for c in frame[1] for k in range(64)}
        elif marker == _SCAN:
            scans, end = scans + 1, _next_marker(data, stop)
            if scans > MAX_SCANS:
                raise broken(path, "JPEG", f"more than {MAX_SCANS} scans")
            _strike(missing, body, progressive=frame is not None and frame[2])
    if frame is None or scans == 0:
        raise broken(path, "JPEG", "no header or no pixels")
    if any(missing.values()):
        raise broken(path, "JPEG", f"{scans} scans, which are not all there should be; it was cut")
    return JpegOutline(frame[0], frame[2], end)


def _segments(data: bytes, path: Path) -> Iterator[tuple[int, int, int]]:
    """Yield each segment's marker, its place, and where what follows it begins; not the end's."""
    place = len(SIGNATURE)
    while True:
        place = _next_marker(data, place)
        if place + 1 < len(data) and data[place + 1] == _END:
            return
        length = int.from_bytes(data[place + 2 : place + 4], "big")
        stop = place + 2 + length
        if place + 4 > len(data) or length < 2 or stop > len(data):
            raise broken(path, "JPEG", f"it truncated after {len(data)} bytes")
        yield data[place + 1], place, stop
        place = stop


def _next_marker(data: bytes, place: int) -> int:
    """Return where the next marker that means something stands; len(data) = nowhere."""
    while True:
        place = data.find(b"\xff", place)
        if place < 0 or place + 1 >= len(data):
            return len(data)
        if data[place + 1] == 0xFF:
            place += 1
        elif data[place + 1] in _BARE:
            place += 2
        else:
            return place


def _frame(marker: int, body: bytes, path: Path) -> tuple[ImageHeader, bytes, bool]:
    """Return the header, the components' names, and whether it is progressive."""
    if marker not in _READABLE or len(body) < 6 or len(body) < 6 + 3 * body[5]:
        raise broken(path, "JPEG", f"one of a kind that is not read here (0x{marker:02X})")
    bits, height, width, count = struct.unpack(">BHHB", body[:6])
    header = ImageHeader(height, width, bits, _KINDS.get(count, f"{count}-channel"), count)
    if bits != 8 or count not in _KINDS:
        raise broken(path, "JPEG", f"a header of {header}")
    return header, body[6 : 6 + 3 * count : 3], marker == _PROGRESSIVE


def _strike(missing: dict[tuple[int, int], int], body: bytes, progressive: bool) -> None:
    """Note what a scan gives: a band of coefficients of some components, down to some bit."""
    count = body[0] if body else 0
    if len(body) < 4 + 2 * count:
        return
    first, last, bits = body[1 + 2 * count : 4 + 2 * count] if progressive else (0, 63, 0)
    for component in body[1 : 1 + 2 * count : 2]:
        for k in range(first, min(last, 63) + 1):
            missing[component, k] = bits & 15


def may_be_cut(image: npt.NDArray[np.uint8]) -> bool:
    """Tell whether a decoded image ends as one does whose last blocks were not there.

    They become mid-grey without any error. Few images do so by themselves: for those,
    `with_filler` decides.
    """
    return bool((image[-1, -1] == _MID_GREY).all())


def with_filler(data: bytes, outline: JpegOutline) -> bytes:
    """Return the JPEG with more packed bytes at its end.

    They become pixels where some are missing, and are passed over where all are there.
    """
    return data[: outline.end] + _FILLER + data[outline.end :]
